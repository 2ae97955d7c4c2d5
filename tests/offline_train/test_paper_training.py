import argparse
import dataclasses
import json

import numpy as np
import pytest

from apex_edge.errors import ApexError, WeightsError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.graph_net import ARCHITECTURES
from offline_train import verb
from offline_train.graph_models import files, paper
from offline_train.scenes import star


@pytest.fixture(scope="module")
def stars():
    return star.paper_stars("test", 1, 1000)


def run(*arguments):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return verb.run(parser.parse_args(["fit", *map(str, arguments)]))


def test_the_released_evaluation_fires_unless_the_inner_sigmoid_has_vanished():
    logit = np.array([-200.0, -50.0, -20.0, -14.0, -1.0, 0.0, 5.0, 200.0])
    expected = [False, False, False, True, True, True, True, True]
    assert paper.fires_as_released(logit).tolist() == expected


def test_rates_count_and_say_nothing_where_nothing_counts():
    labels = np.array([1.0, 1.0, 0.0, 0.0])
    found = paper.rates(np.array([True, False, True, False]), labels)
    assert found == {"accuracy": 0.5, "recall": 0.5, "precision": 0.5}
    assert paper.rates(np.zeros(4, dtype=bool), labels)["precision"] is None
    assert paper.rates(np.ones(2, dtype=bool), np.zeros(2))["recall"] is None


def test_each_quirk_changes_what_it_names(stars):
    few = stars.take(slice(0, 40))
    text = paper.paper_graphs(few, paper.NO_QUIRKS)
    assert np.array_equal(text.labels, (few.risk_fixed > 0.75).ravel())
    label = paper.paper_graphs(few, paper.Quirks(is_designed_label=True))
    assert np.array_equal(label.labels, few.designed.ravel())
    assert np.array_equal(label.edge_features, text.edge_features)
    raw = paper.paper_graphs(few, paper.Quirks(is_raw_displacement=True))
    assert np.array_equal(raw.labels, text.labels)
    assert np.allclose(raw.edge_features[:, 2], 0.01 * text.edge_features[:, 2])


def test_as_released_recall_is_bought_with_accuracy(stars):
    graphs = paper.paper_graphs(stars, paper.REPO_QUIRKS)
    logit = files.read(files.shipped("diffgraphormer", True))[0].logit(graphs)
    released = paper.rates(paper.fires_as_released(logit), graphs.labels)
    once = paper.rates(logit > 0.0, graphs.labels)
    assert released["recall"] >= 0.9
    assert 0.6 <= released["accuracy"] <= 0.8
    assert once["accuracy"] > released["accuracy"] + 0.15


@pytest.mark.parametrize("architecture", ARCHITECTURES)
@pytest.mark.parametrize("has_quirks", [False, True])
def test_the_shipped_models_are_what_their_names_say(architecture, has_quirks, stars):
    fit, fields = files.read(files.shipped(architecture, has_quirks))
    assert fit.spec.architecture == architecture
    made = fields["provenance"]
    assert set(made["quirks"].values()) == {has_quirks}
    assert made["n_epochs"] == 100
    quirks = paper.REPO_QUIRKS if has_quirks else paper.NO_QUIRKS
    held = paper.paper_graphs(star.paper_stars("train", made["seed"], 500), quirks)
    held = held.take(np.arange(400, 500))
    found = paper.rates(fit.logit(held) > 0.0, held.labels)
    assert found == pytest.approx(fields["metrics"]["correct"])
    assert found["accuracy"] > 0.94


def test_no_device_takes_a_model_of_the_papers_stars():
    with pytest.raises(WeightsError):
        weights.load(files.shipped("diffgat", False))


def test_training_is_repeatable_to_the_byte_and_quirks_come_one_by_one(tmp_path, capsys):
    pytest.importorskip("torch_geometric")
    common = ("--paper", "--model", "diffgcn", "--seed", 3, "--epochs", 1, "--json")
    for name in ("a.npz", "b.npz"):
        assert run(*common, "--repo-quirks", "--out", tmp_path / name) == 0
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    capsys.readouterr()
    assert run(*common, "--quirk", "designed-label", "--out", tmp_path / "c.json") == 0
    printed = json.loads(capsys.readouterr().out)
    fields = model_file.read(tmp_path / "c.json")
    assert printed == fields["metrics"]
    expected = dataclasses.asdict(paper.Quirks(is_designed_label=True))
    assert fields["provenance"]["quirks"] == expected
    assert fields["threshold"] is None


def test_a_damaged_or_foreign_file_is_refused(tmp_path):
    fields = model_file.read(files.shipped("diffgcn", False))
    for key, value in (("feature_set", "other"), ("edge_scaler", {"lo": []}), ("graph", {})):
        model_file.write({**fields, key: value}, tmp_path / "bad.json")
        with pytest.raises(WeightsError, match="bad.json"):
            files.read(tmp_path / "bad.json")


@pytest.mark.parametrize(
    ("option", "value"),
    [("--seed", -1), ("--epochs", 0), ("--out", "no/such/x.npz"), ("--out", "x.pt")],
)
def test_options_out_of_range_are_refused_before_the_work(option, value):
    options = {"--model": "diffgcn", "--seed": 1, "--out": "x.npz", option: value}
    with pytest.raises(ApexError, match=option):
        run("--paper", *[part for pair in options.items() for part in pair])


def test_the_paper_has_three_models_and_no_other():
    with pytest.raises(ApexError, match="diffgraphormer, diffgat, diffgcn"):
        run("--paper", "--model", "linear12", "--seed", 1, "--out", "x.npz")
