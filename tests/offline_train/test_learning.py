import argparse
import json

import numpy as np
import pytest

pytest.importorskip("sklearn")

from apex_edge.errors import ApexError, PluginError, WeightsError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.base import TriggerConfig
from offline_train import verb
from offline_train.trigger import data, learn
from offline_train.trigger.fit import ROWS_PER_PAIR
from offline_train.trigger.observe import Watching, observe
from offline_train.trigger.seeds import rng


@pytest.fixture(scope="module")
def seen():
    watching = Watching(n_frames=30, is_gated=False)
    return observe(rng("train", 3), "tabletop-cv", 80, watching, TriggerConfig())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "train"
    data.write(data.describe("tabletop-pairs", "train", 4, 150), path, is_quiet=True)
    return path


def run(step, *arguments):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return verb.run(parser.parse_args([step, *map(str, arguments)]))


def test_graphs_hold_whole_frames_and_know_which_row_an_edge_is(seen):
    rows = learn.whole_frames(seen, 0)
    assert 0 < len(rows) < len(seen.pair)
    kept = np.unique(seen.group[rows])
    assert np.array_equal(rows, np.flatnonzero(np.isin(seen.group, kept)))
    scene_of_frame = kept // seen.is_judged.shape[1]
    assert np.bincount(scene_of_frame).max() <= ROWS_PER_PAIR
    graphs, edge_row = learn.watched_graphs(seen, seen.label.astype(float), rows)
    assert sorted(edge_row) == rows.tolist()
    assert np.array_equal(graphs.edge_features, seen.features[edge_row])
    assert np.array_equal(graphs.labels, seen.label[edge_row])
    radius = graphs.nodes[graphs.edges[1], graphs.node_names.index("radius")]
    assert np.array_equal(radius, seen.geometry.radius_m[edge_row])
    is_centre = graphs.nodes[:, graphs.node_names.index("is_mover")] == 1.0
    assert np.array_equal(np.flatnonzero(is_centre), graphs.node_start[:-1])
    owner = np.searchsorted(graphs.node_start, graphs.edges, side="right") - 1
    assert np.array_equal(owner[0], owner[1])
    assert np.diff(graphs.edge_start).max() > 1


@pytest.mark.parametrize("name", ["diffgraphormer", "diffgat"])
def test_the_device_scores_frame_by_frame_what_the_trainer_scores_at_once(seen, name):
    pytest.importorskip("torch_geometric")
    trained = learn.fit(seen, learn.targets(seen, "truth"), name, seed=1, n_epochs=1)
    description = data.describe("tabletop-cv", "train", 3, 80)
    fields = learn.document(trained, seen, description, {"label": "truth"})
    model = weights.check(fields, "test")
    said = learn.said_by(model, seen)
    movers = seen.bodies[:, 0]
    busy = np.flatnonzero(np.bincount(seen.group) > 2)[:10]
    assert len(busy) == 10
    for group in busy:
        rows = np.flatnonzero(seen.group == group)
        logit = model.logit(seen.features[rows], seen.geometry.take(rows), movers[rows])
        assert model.probability(logit) == pytest.approx(said[rows], abs=1e-12)


def test_a_document_says_how_many_roll_outs_made_its_soft_labels(seen):
    trained = learn.fit(seen, learn.targets(seen, "truth"), learn.LINEAR, seed=1)
    told = []
    for n_rollouts in (0, 8):
        about = data.describe("tabletop-cv", "train", 3, 80, Watching(n_rollouts=n_rollouts))
        made = learn.document(trained, seen, about, {"label": "soft"})
        told.append(made["provenance"]["data"].get("n_rollouts"))
    assert told == [None, 8]


def test_labels_that_the_scenes_do_not_have_are_refused(seen):
    with pytest.raises(ApexError, match="never 0.75"):
        learn.targets(seen, "paper-risk")
    with pytest.raises(ApexError, match="perturbed roll-outs"):
        learn.targets(seen, "soft")
    with pytest.raises(ApexError, match="paper's stars"):
        learn.targets(seen, "designed")


def test_models_that_make_no_file_are_refused(seen):
    target = learn.targets(seen, "truth")
    with pytest.raises(ApexError, match="apex train evaluate"):
        learn.fit(seen, target, "gbm-ceiling", 1)
    pytest.importorskip("torch_geometric")
    with pytest.raises(PluginError, match="diffgraphormer"):
        learn.fit(seen, target, "no-such-model", 1)


def test_a_linear_fit_is_repeatable_to_the_byte_and_awaits_its_certificate(folder, tmp_path):
    for name in ("a.json", "b.json"):
        assert (
            run(
                "fit",
                "--data",
                folder,
                "--model",
                "linear12",
                "--seed",
                1,
                "--out",
                tmp_path / name,
            )
            == 0
        )
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()
    with pytest.raises(WeightsError, match="apex train calibrate"):
        weights.load(tmp_path / "a.json")
    made = model_file.read(tmp_path / "a.json")["provenance"]
    assert (made["generator"], made["label"]) == ("tabletop-pairs", "truth")


def test_a_graph_teaches_a_linear_model_and_is_named_in_its_file(folder, tmp_path, capsys):
    pytest.importorskip("torch_geometric")
    teacher, student = tmp_path / "graph.npz", tmp_path / "student.json"
    common = ("--data", folder, "--seed", 1, "--json", "--out")
    run("fit", "--model", "diffgraphormer", "--epochs", 5, *common, teacher)
    capsys.readouterr()
    assert run("distill", "--teacher", teacher, "--mix-truth", 0.5, *common, student) == 0
    assert json.loads(capsys.readouterr().out)["roc_auc"] > 0.75
    made = model_file.read(student)["provenance"]
    assert made["teacher_sha256"] == model_file.read(teacher)["sha256"]
    assert (made["label"], made["mix_truth"]) == ("truth", 0.5)


def test_without_truth_the_student_ranks_as_its_teacher_does(folder, tmp_path):
    teacher, student = tmp_path / "teacher.json", tmp_path / "student.json"
    common = ("--data", folder, "--seed", 1, "--out")
    run("fit", "--model", "linear12", *common, teacher)
    run("distill", "--teacher", teacher, *common, student)
    seen, _ = data.read(folder, "train")
    first, second = (
        weights.check(model_file.read(path), str(path)).logit(seen.features)
        for path in (teacher, student)
    )
    assert np.corrcoef(first, second)[0, 1] > 0.98


def test_data_drawn_for_another_purpose_is_not_learnt_from(tmp_path):
    data.write(data.describe("tabletop-pairs", "test", 1, 20), tmp_path / "d", is_quiet=True)
    with pytest.raises(data.DataError, match="drawn for test, expected train"):
        run("fit", "--data", tmp_path / "d", "--model", "linear12", "--seed", 1, "--out", "x.json")


@pytest.mark.parametrize("share", [-0.1, 1.5])
def test_a_share_of_truth_out_of_range_is_refused(share, folder):
    with pytest.raises(ApexError, match="--mix-truth"):
        run(
            "distill",
            "--teacher",
            "t.json",
            "--data",
            folder,
            "--mix-truth",
            share,
            "--seed",
            1,
            "--out",
            "x.json",
        )


def test_quirks_go_with_the_papers_stars_only(folder):
    with pytest.raises(ApexError, match="--paper"):
        run(
            "fit",
            "--data",
            folder,
            "--repo-quirks",
            "--model",
            "linear12",
            "--seed",
            1,
            "--out",
            "x.json",
        )
