import argparse
import json
import re

import pytest

from apex_edge.errors import InputError, WeightsError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.linear import LinearTrigger
from offline_train import verb
from offline_train.reports import sources
from offline_train.scenes import committed
from offline_train.trigger import data
from offline_train.trigger.evaluate import BASELINES

pytest.importorskip("matplotlib")
pytest.importorskip("sklearn")


def run(*arguments):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return verb.run(parser.parse_args([str(part) for part in arguments]))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("data")
    for purpose in ("test", "calibration"):
        data.write(data.describe(committed.NAME, purpose, 3, 60), root / purpose, is_quiet=True)
    return root


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "ours.json"
    path.write_bytes(weights.SHIPPED.read_bytes())
    return path


def changed(path, **keys):
    fields = {**model_file.read(path), **keys}
    model_file.write(fields, path)
    return path


def test_evaluate_prints_the_baselines_and_writes_a_report(folders, model, tmp_path, capsys):
    report = tmp_path / "report"
    assert run("evaluate", "--model", model, "--data", folders / "test", "--report", report) == 0
    said = capsys.readouterr().out
    for name in ("ours", *BASELINES):
        assert f"\n{name} " in said
    assert "us a pair" in said and "13 parameters" in said
    names = sorted(path.name for path in report.iterdir())
    assert names == [
        "committed-leads.svg",
        "committed-pr.svg",
        "committed-reliability.svg",
        "committed-roc.svg",
        "evaluation.json",
        "evaluation.md",
    ]
    text = (report / "evaluation.md").read_text(encoding="utf-8")
    assert "scenario committed, version 1, purpose test, seed 3, n scenes 60" in text


def test_evaluate_as_json_compares_models_on_several_sets(folders, model, tmp_path, capsys):
    other = tmp_path / "other.npz"
    model_file.write(model_file.read(model), other)
    test = folders / "test"
    assert run("evaluate", "--json", "--model", model, other, "--data", test, test) == 0
    found = json.loads(capsys.readouterr().out)
    assert list(found["sets"]) == ["committed", "committed-2"]
    rules = found["sets"]["committed"]["rules"]
    assert list(rules) == ["ours", "other", *BASELINES]
    # the .npz holds the very same model
    assert rules["ours"] == rules["other"]
    assert found["models"]["ours"]["sha256"] == found["models"]["other"]["sha256"]


def test_a_model_that_is_not_certified_can_be_evaluated_but_not_exported(
    folders, model, tmp_path, capsys
):
    changed(model, threshold=None)
    assert run("evaluate", "--json", "--model", model, "--data", folders / "test") == 0
    ours = json.loads(capsys.readouterr().out)["sets"]["committed"]["rules"]["ours"]
    assert ours["recall"] >= 0.95
    out = tmp_path / "out.json"
    with pytest.raises(InputError, match="apex train calibrate"):
        run("export", "--model", model, "--data", folders / "test", "--out", out)
    assert not out.exists()


def test_two_models_of_one_name_are_refused(folders, model, tmp_path):
    twin = tmp_path / "twin"
    twin.mkdir()
    (twin / model.name).write_bytes(model.read_bytes())
    with pytest.raises(InputError, match="another model is called 'ours'"):
        run("evaluate", "--model", model, twin / model.name, "--data", folders / "test")


@pytest.mark.parametrize("step", ["evaluate", "export"])
def test_scenes_drawn_to_certify_on_are_refused(step, folders, model, tmp_path):
    out = ["--out", tmp_path / "o.json"] if step == "export" else []
    with pytest.raises(data.DataError, match="drawn for calibration, expected test"):
        run(step, "--model", model, "--data", folders / "calibration", *out)
    assert not (tmp_path / "o.json").exists()


def test_an_exported_file_runs_on_the_device_and_carries_its_figures(
    folders, model, tmp_path, capsys
):
    out, card = tmp_path / "final.npz", tmp_path / "card"
    test = folders / "test"
    assert run("export", "--model", model, "--data", test, "--out", out, "--card", card) == 0
    trigger = LinearTrigger(weights_path=out)
    assert trigger.weights.threshold == weights.load(model).threshold
    fields = model_file.read(out)
    kept = fields["metrics"]["committed"]
    assert set(kept["rules"]) == {"final", *BASELINES}
    assert kept["origin"]["seed"] == 3 and kept["rules"]["final"]["recall"] >= 0.9
    assert fields["sha256"] in capsys.readouterr().out
    text = (card / "final.md").read_text(encoding="utf-8")
    assert fields["sha256"] in text
    assert len(list(card.glob("final-committed-*.svg"))) == 4
    assert not list(tmp_path.glob("*.part"))
    # again, as readable text: the same content
    assert run("export", "--model", model, "--data", test, "--out", tmp_path / "final.json") == 0
    assert model_file.read(tmp_path / "final.json") == fields


def test_nothing_is_written_that_the_device_would_refuse(folders, model, tmp_path):
    changed(model, bias="a lot")
    out = tmp_path / "final.json"
    with pytest.raises(WeightsError, match="bias"):
        run("export", "--model", model, "--data", folders / "test", "--out", out)
    assert not out.exists()


def test_a_damaged_model_is_refused(folders, model):
    text = model.read_text(encoding="utf-8")
    model.write_text(re.sub(r'"bias": -?\d', '"bias": 7', text), encoding="utf-8")
    with pytest.raises(WeightsError, match="changed after export"):
        run("evaluate", "--model", model, "--data", folders / "test")


def test_the_folder_of_the_file_must_exist_before_the_work(folders, model, tmp_path):
    with pytest.raises(InputError, match="folder does not exist"):
        run("export", "--model", model, "--data", folders, "--out", tmp_path / "no" / "x.json")


def test_the_ceiling_sees_all_that_a_model_may_see(folders):
    (found,) = sources.sets([folders / "test"])
    inputs = sources.ceiling_inputs(found.seen)
    assert inputs.shape[0] == len(found.seen.pair)
    assert inputs.shape[1] >= found.seen.features.shape[1]
    assert found.kinds == tuple(committed.KINDS)
