import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest

from apex_edge import cli
from apex_edge.errors import WeightsError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.feature_sets import FEATURE_SETS
from apex_edge.triggers.graph_net import layer_shapes
from apex_edge.triggers.models import Columns
from offline_train.benchmarks.trigger import damages, files
from offline_train.trigger import export, golden
from offline_train.trigger.calibrate import Promise, Threshold

SHIPPED = model_file.read(weights.SHIPPED)


@pytest.fixture
def graph_path(tmp_path):
    model_file.write(damages.made_graph(SHIPPED, 1), tmp_path / "graph.npz")
    return tmp_path / "graph.npz"


def test_verify_says_what_the_shipped_file_promises(capsys):
    assert cli.main(["train", "verify", str(weights.SHIPPED)]) == 0
    text = capsys.readouterr().out
    promise = SHIPPED["threshold"]
    for word in ("linear", "fused12", "0.990", "95%", f"{promise['n_pos']} events", "closing"):
        assert word in text
    assert SHIPPED["sha256"] in text


def test_verify_prints_json_and_leaves_the_layers_out(graph_path, capsys):
    assert cli.main(["train", "verify", str(graph_path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["kind"] == "graph"
    assert found["threshold"] == SHIPPED["threshold"]
    assert found["graph"]["hidden"] == 16
    assert "layers" not in found["graph"]
    assert cli.main(["train", "verify", str(graph_path)]) == 0
    assert "diffgraphormer" in capsys.readouterr().out


def test_verify_refuses_with_the_typed_error_and_exit_code_2(tmp_path, capsys):
    path = tmp_path / "m.json"
    path.write_bytes(damages.damaged(SHIPPED, damages.changed(["threshold"], None), ".json"))
    assert cli.main(["train", "verify", str(path)]) == 2
    assert "apex train calibrate" in capsys.readouterr().err


def test_verify_needs_no_training_stack(graph_path):
    blocked = """if True:
        import sys
        for name in ("sklearn", "scipy", "torch", "mujoco", "joblib"):
            sys.modules[name] = None
        from apex_edge import cli
        sys.exit(cli.main(["train", "verify", sys.argv[1]]))
    """
    command = [sys.executable, "-c", blocked, str(graph_path)]
    assert subprocess.run(command, stdout=subprocess.DEVNULL).returncode == 0


def test_golden_vectors_hold_single_pairs_a_star_and_two_stars_at_once():
    found = golden.with_golden(SHIPPED, SHIPPED["horizon_s"])["golden"]
    sizes = [(len(case["mover"]), len(set(case["mover"]))) for case in found]
    assert sizes == [(1, 1), (3, 1), (3, 2), (1, 1)]
    for case, shipped in zip(found, SHIPPED["golden"]):
        assert case["offset_m"] == shipped["offset_m"]
        assert case["logit"] == pytest.approx(shipped["logit"], abs=1e-9)


@pytest.mark.parametrize("architecture", ["diffgraphormer", "diffgat", "diffgcn"])
def test_a_graph_net_goes_through_the_export_to_the_device(architecture, tmp_path):
    pytest.importorskip("sklearn")
    made = weights.check(damages.made_graph(SHIPPED, 4), "made")
    spec = dataclasses.replace(
        made.net.spec,
        architecture=architecture,
        edge_mode="full" if architecture == "diffgraphormer" else "none",
        edge_names=made.net.spec.edge_names if architecture == "diffgraphormer" else (),
        node_names=("radius", "vx", "is_mover"),
    )
    rng = np.random.default_rng(0)
    layers = {name: rng.normal(size=shape) for name, shape in layer_shapes(spec).items()}
    nodes = Columns(np.full(3, -1.0), np.ones(3), np.zeros(3), np.full(3, 0.1))
    low, high = made.columns.lo - 1.0, made.columns.hi + 1.0
    keys = export.graph_keys(spec, layers, nodes)
    trained = export.Trained(keys, made.feature_set, made.columns, low, high)
    notes = {"radius_m": [0.01, 0.1], "seed": 0, "metrics": {}, "provenance": {}}
    common = (Promise(), TriggerConfig(), notes)
    certified = export.document(trained, Threshold(0.25, 1, 299, 400), *common)
    export.write(certified, tmp_path / "graph.npz")
    model = weights.load_graph(tmp_path / "graph.npz")
    assert model.threshold == 0.25
    for name, array in layers.items():
        assert np.array_equal(model.net.layers[name], array)
    export.write(export.document(trained, None, *common), tmp_path / "fresh.npz")
    with pytest.raises(weights.WeightsError, match="calibrate"):
        weights.load(tmp_path / "fresh.npz")


def test_an_export_the_device_would_refuse_is_not_written(tmp_path):
    with pytest.raises(weights.WeightsError, match="golden"):
        export.write(dict(SHIPPED, bias=SHIPPED["bias"] + 1.0), tmp_path / "m.json")
    assert not list(tmp_path.iterdir())


def test_the_bench_finds_nothing_amiss(monkeypatch):
    monkeypatch.setattr(files, "N_MUTATIONS", 5)
    lines = files.measure(2)
    assert [line.is_ok for line in lines] == [True] * 7
    assert sum(line.figures["value"] for line in lines[2:4] + lines[5:]) == 0.0


def test_the_bench_counts_every_outcome_apart(monkeypatch, tmp_path):
    found, path = files.Tally(), tmp_path / "m.json"
    other = damages.damaged(SHIPPED, damages.changed(["metrics"], {}), ".json")
    found.take(path, b"{}", SHIPPED)
    found.take(path, model_file.as_json(SHIPPED), SHIPPED)
    found.take(path, other, SHIPPED)
    monkeypatch.setattr(files.weights, "load", lambda path: 1 / 0)
    found.take(path, b"{}", SHIPPED)
    counts = (found.n_files, found.n_refused, found.n_harmless, found.n_accepted, found.n_other)
    assert counts == (4, 1, 1, 1, 1)
    assert [line.is_ok for line in found.lines("odd")] == [False] * 3


def test_golden_vectors_of_a_set_with_windows_replay_what_each_window_saw():
    wide = FEATURE_SETS["wide"]
    model = dataclasses.replace(
        weights.load_linear(weights.SHIPPED),
        feature_set=wide,
        columns=Columns(*(np.full(len(wide.names), v) for v in (-60.0, 60.0, 0.0, 1.0))),
        weight=np.ones(len(wide.names)),
    )
    case = dict(golden._raw((1, 2), golden._WINDOW), horizon_s=5.0)
    with pytest.raises(WeightsError, match="windows"):
        weights.replay(model, case)
    case["windows"] = [golden._raw((1, 2), (w,) * 6, 1.0 / w) for w in wide.windows]
    found = weights.replay(model, case)
    assert found["features"].shape == (2, len(wide.names))
    assert np.isfinite(found["logit"]).all()
