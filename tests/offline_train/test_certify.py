import json

import numpy as np
import pytest

from apex_edge.cli import main
from apex_edge.errors import WeightsError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.base import TriggerConfig
from offline_train.benchmarks.trigger import certificate, damages
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import calibrate, certify, data, scoring, seeds
from offline_train.trigger.observe import Watching, observe

SHIPPED = model_file.read(weights.SHIPPED)
PROMISE = calibrate.Promise(alpha=0.1)


@pytest.fixture(scope="module")
def seen():
    rng = seeds.rng("calibration", 60)
    return observe(rng, tabletop_pairs.NAME, 1500, Watching(), TriggerConfig(), only_contacts=True)


def test_a_linear_document_scores_as_its_weights_do(seen):
    model = weights.check(SHIPPED, "shipped")
    expected = model.logit(seen.features)
    assert np.allclose(scoring.scorer(SHIPPED)(seen), expected, rtol=1e-12, atol=1e-12)


def test_a_graph_document_scores_each_frame_as_the_device_does(seen):
    fields = damages.made_graph(SHIPPED, 3)
    model = weights.check(fields, "graph")
    few = seen.take(np.arange(400))
    found = scoring.scorer(fields)(few)
    for group in np.unique(few.group)[::17]:
        rows = np.flatnonzero(few.group == group)
        part = few.take(rows)
        expected = model.logit(part.features, part.geometry, part.bodies[:, 0])
        assert np.allclose(found[rows], expected, rtol=1e-9, atol=1e-9)


def test_outside_the_domain_the_score_is_the_verdict_of_the_rule(seen):
    fields = dict(SHIPPED, domain=dict(SHIPPED["domain"], radius_m=[0.03, 0.04]))
    found = scoring.device_scorer(fields)(seen)
    radius = seen.geometry.radius_m
    outside = (radius < 0.03) | (radius > 0.04)
    assert outside.any() and not outside.all()
    said = np.where(seen.rule_hit, scoring.RULE_SURE, -scoring.RULE_SURE)
    assert np.array_equal(found[outside], said[outside])
    assert np.all(np.abs(found[~outside]) < 1e3)


@pytest.mark.parametrize("kind", ["linear", "graph"])
def test_certifying_gives_the_threshold_of_the_events_and_signs_anew(seen, kind, tmp_path):
    fields = SHIPPED if kind == "linear" else damages.made_graph(SHIPPED, 3)
    fields = dict(fields, threshold=None)
    origin = {"kind": "test"}
    made = certify.certify(fields, seen, PROMISE, origin)
    score = scoring.device_scorer(fields)(seen)
    expected = calibrate.calibrate(seen, score, TriggerConfig(), PROMISE)
    assert made["threshold"]["logit"] == expected.logit
    assert made["provenance"]["certified_on"] == origin
    assert made["metrics"] == fields["metrics"]
    path = tmp_path / "made.json"
    model_file.write(made, path)
    assert model_file.read(path)["sha256"] == made["sha256"]
    assert weights.load(path).threshold == expected.logit


def test_rows_of_another_horizon_are_refused(seen):
    with pytest.raises(WeightsError, match="looks 3 s ahead"):
        scoring.scorer(dict(SHIPPED, horizon_s=3.0))(seen)


def test_events_that_nothing_ever_scores_are_not_called_outside_the_domain(seen):
    fields = dict(SHIPPED, domain=dict(SHIPPED["domain"], radius_m=[9.0, 9.5]))
    events = np.flatnonzero(calibrate.is_eligible(seen, PROMISE.lead_s))
    some = seen.take(~np.isin(seen.pair, events[:3]))
    with pytest.raises(calibrate.TooFewEventsError, match=f"^{len(events) - 3} of {len(events)} "):
        certify.certify(fields, some, calibrate.Promise(alpha=0.5), {})


def test_the_events_needed_are_the_published_numbers():
    for alpha, needed in ((0.01, 299), (0.02, 149), (0.05, 59), (0.1, 29)):
        assert certify.events_needed(calibrate.Promise(alpha=alpha)) == needed


def command(model, folder, out, *more):
    return main(["train", "calibrate", "--model", model, "--data", folder, "--out", out, *more])


def test_calibrate_certifies_from_a_data_folder_and_refuses_training_data(tmp_path, capsys):
    folders = {}
    for purpose in ("train", "calibration"):
        folders[purpose] = str(tmp_path / purpose)
        about = data.describe(tabletop_pairs.NAME, purpose, 3, 900, only_contacts=True)
        data.write(about, folders[purpose], is_quiet=True)
    model, out = str(weights.SHIPPED), tmp_path / "out.npz"
    capsys.readouterr()
    assert command(model, folders["calibration"], str(out), "--alpha", "0.1", "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    made = model_file.read(out)
    assert made["threshold"]["logit"] == shown["logit"] and shown["n_pos"] >= 29
    assert made["provenance"]["certified_on"]["scenario"] == tabletop_pairs.NAME
    assert made["provenance"]["earlier_sha256"] == SHIPPED["sha256"]
    refused = tmp_path / "refused.json"
    assert command(model, folders["train"], str(refused)) != 0
    assert command(model, folders["calibration"], str(refused)) != 0
    assert "299 are needed" in capsys.readouterr().err
    assert command(model, folders["calibration"], str(refused), "--alpha", "1.5") != 0
    assert not refused.exists()


def test_the_sampling_error_is_that_of_the_binomial():
    draws = np.random.default_rng(0).binomial(800, 0.01, 200000) / 800
    limit = certificate.binomial_slack(0.01, 800)
    assert np.mean(draws > limit) <= 0.051
    assert np.mean(draws > limit - 1.5 / 800) > 0.05
