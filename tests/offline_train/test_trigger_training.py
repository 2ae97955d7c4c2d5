import argparse
import json

import numpy as np
import pytest

from apex_edge.errors import ApexError
from apex_edge.triggers import weights
from apex_edge.triggers.base import TriggerConfig
from offline_train import extras, verb
from offline_train.scenes import tabletop_pairs
from offline_train.scenes.truth import first_contact
from offline_train.trigger import calibrate, estimate, fit, observe, pipeline


@pytest.fixture(scope="module")
def scenes():
    return tabletop_pairs.draw_scenes(np.random.default_rng(5), 500)


@pytest.fixture(scope="module")
def seen(scenes):
    rng, watching = np.random.default_rng(6), observe.Watching()
    sensing = observe.draw_sensing(rng, 500, watching)
    truth = tabletop_pairs.follow(scenes, sensing.frame_s, watching.n_frames)
    return observe.look(rng, truth, sensing, watching, TriggerConfig())


def apex(*arguments):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return verb.run(parser.parse_args(list(map(str, arguments))))


def run(*arguments):
    return apex("trigger", *arguments)


def sensing(n, window, is_adaptive=False, sd=0.002):
    ones = np.ones(n)
    return estimate.Sensing(
        frame_s=ones / 25.0,
        sd_m=sd * ones,
        told_sd_m=sd * ones,
        window=np.full(n, window),
        is_adaptive=np.full(n, is_adaptive),
    )


@pytest.mark.parametrize("window", [5, 12, 20])
def test_the_published_covariance_is_that_of_the_fit(window):
    n = 4000
    rows = (np.arange(n), np.full(n, window - 1))
    seen = np.random.RandomState(0).normal(size=(n, window, 2)) * 0.002
    how = sensing(n, window)
    found = estimate.fit(seen, how)
    cov = estimate.covariance(found, how, rows)
    pos, vel = found.position[rows][:, 0], found.velocity[rows][:, 0]
    assert cov[0, 0, 0] == pytest.approx(pos.var(), rel=0.08)
    assert cov[0, 3, 3] == pytest.approx(vel.var(), rel=0.08)
    assert cov[0, 0, 3] == pytest.approx(np.mean(pos * vel), rel=0.12)


@pytest.mark.parametrize("is_adaptive", [False, True])
def test_a_fit_without_noise_finds_the_motion(is_adaptive):
    time = np.arange(30) / 25.0
    path = np.stack([0.1 + 0.2 * time - 0.05 * time**2, 0.3 - 0.1 * time], axis=1)[None]
    found = estimate.fit(path, sensing(1, 12, is_adaptive, sd=1e-5))
    assert found.is_bent[0, -1] == is_adaptive
    if is_adaptive:
        assert np.allclose(found.position[0, -1], path[0, -1])
        assert np.allclose(found.velocity[0, -1], [0.2 - 0.1 * time[-1], -0.1])
        assert np.allclose(found.acc[0, -1], [-0.1, 0.0], atol=1e-9)
    assert np.allclose(found.velocity[0, -1], [0.2 - 0.1 * time[-1], -0.1], atol=0.03)


def test_the_label_is_true_contact_and_nothing_the_device_believes(seen, scenes):
    contact = first_contact(lambda t_s: tabletop_pairs.place(scenes, t_s), scenes.radius_m, 12.5)
    left = contact[seen.pair] - seen.frame * seen.frame_s[seen.pair]
    assert np.array_equal(seen.label, left <= 5.0)
    assert 0.2 < seen.label.mean() < 0.8
    # at the moment of contact the bodies touch, a moment before they do not
    hit = np.flatnonzero(np.isfinite(contact) & (contact > 0.05))
    for when, is_in in ((contact[hit], True), (contact[hit] - 0.02, False)):
        mover, target = tabletop_pairs.place(scenes.take(hit), when[:, None])
        gap = np.linalg.norm(mover - target, axis=2)[:, 0]
        assert np.array_equal(gap <= scenes.radius_m[hit] + 1e-12, np.full(len(hit), is_in))


def test_a_hand_stands_still_before_and_after_its_move_and_covers_its_length(scenes):
    hands = scenes.take(scenes.kind == tabletop_pairs.HAND)
    n = len(hands.kind)
    far = hands.t_start_s + hands.length_m / hands.speed_m_s
    start, end = (tabletop_pairs.place(hands, t[:, None])[0][:, 0] for t in (np.zeros(n), far))
    late = tabletop_pairs.place(hands, (far + 3.0)[:, None])[0][:, 0]
    assert np.allclose(start, hands.start_m)
    assert np.allclose(np.linalg.norm(end - start, axis=1), hands.length_m)
    assert np.allclose(end, late)


def test_scenes_in_which_nothing_moves_pass_the_gate_by_chance_alone(seen, scenes):
    is_still = seen.kind == tabletop_pairs.STILL
    is_still &= ~scenes.target_vel_m_s.any(axis=1)
    assert is_still.sum() > 20
    judged = np.isin(seen.pair, np.flatnonzero(is_still)).sum()
    assert judged <= 0.001 * seen.is_judged[is_still].sum()


def test_the_certified_rank_keeps_its_promise():
    # published values: n needed for 0, 1 and 2 misses at 95 %
    for alpha, needed in ((0.01, (299, 473, 628)), (0.05, (59, 93, 124)), (0.1, (29, 46, 61))):
        for misses, n in enumerate(needed):
            assert calibrate.certified_rank(n, alpha, 0.95) == misses + 1
            assert calibrate.certified_rank(n - 1, alpha, 0.95) == misses
    assert calibrate.certified_rank(0, 0.1, 0.95) == 0


def test_the_threshold_misses_too_much_in_at_most_one_of_twenty_draws():
    scores = np.random.RandomState(0).normal(size=(2000, 200))
    rank = calibrate.certified_rank(200, 0.05, 0.95)
    chosen = np.sort(scores, axis=1)[:, rank - 1]
    cut = -1.6448536  # 5 % quantile of the normal
    assert np.mean(chosen > cut) < 0.06


def test_too_few_events_are_refused_and_told_what_they_could_prove(seen):
    logit = seen.features[:, 6]
    promise = calibrate.Promise(alpha=0.01)
    with pytest.raises(
        calibrate.TooFewEventsError, match="cannot certify a recall of 0.990.*at best 0.[6-9]"
    ):
        calibrate.calibrate(seen, logit, TriggerConfig(), promise)
    n = len(calibrate.event_scores(seen, logit, TriggerConfig(), 1.0))
    assert 0 < n < 299


def test_the_vote_of_the_trainer_is_that_of_the_device(seen):
    from apex_edge.triggers.vote import Persistence

    config, cut = TriggerConfig(), 0.0
    logit = seen.features[:, 6]
    fires = calibrate.voted(seen, logit, config) >= cut
    for pair in np.unique(seen.pair)[:40]:
        vote = Persistence(config.persist_hits, config.persist_frames)
        mine = seen.pair == pair
        hit = np.zeros(fires.shape[1], dtype=bool)
        hit[seen.frame[mine]] = logit[mine] >= cut
        judged = np.zeros(fires.shape[1], dtype=bool)
        judged[seen.frame[mine]] = True
        device = [vote.update(np.array([[1, 2]]), hit[f : f + 1])[0] for f in range(len(hit))]
        assert np.array_equal(fires[pair], np.array(device) & judged)


def test_thinning_keeps_few_rows_of_each_pair():
    pair = np.repeat(np.arange(5), [1, 30, 4, 100, 12])
    rows = fit.thin(pair, 12, seed=0)
    assert np.bincount(pair[rows]).tolist() == [1, 12, 4, 12, 12]
    assert np.all(np.diff(rows) > 0)


def test_the_exported_model_says_what_scikit_learn_says(seen):
    linear_model = pytest.importorskip("sklearn.linear_model")
    model = fit.fit(seen, seed=0)
    rows = fit.thin(seen.pair, fit.ROWS_PER_PAIR, 0)
    inner = linear_model.LogisticRegression(max_iter=5000, tol=1e-8)
    inner.fit(model.standardise(seen.features[rows]), seen.label[rows])
    expected = inner.predict_proba(model.standardise(seen.features))[:, 1]
    found = 1.0 / (1.0 + np.exp(-model.logit(seen.features)))
    assert np.max(np.abs(found - expected)) < 1e-9


def test_the_device_gives_the_probability_of_the_file(tmp_path):
    pytest.importorskip("sklearn")
    from apex_edge.triggers.linear import LinearTrigger

    model = weights.load(weights.SHIPPED)
    fields = json.loads(weights.SHIPPED.read_text(encoding="utf-8"))
    features = np.concatenate([case["features"] for case in fields["golden"]])
    inner = pytest.importorskip("sklearn.linear_model").LogisticRegression()
    inner.classes_ = np.array([False, True])
    inner.coef_, inner.intercept_ = model.weight[None], np.array([model.bias])
    columns = model.columns
    clipped = np.clip(features, columns.lo, columns.hi)
    expected = inner.predict_proba((clipped - columns.mean) / columns.scale)[:, 1]
    found = 0.5 * (1.0 + np.tanh(0.5 * LinearTrigger().weights.logit(features)))
    assert np.max(np.abs(found - expected)) < 1e-12


def test_training_is_repeatable_to_the_byte_and_beats_speed_alone(tmp_path, capsys):
    pytest.importorskip("sklearn")
    texts = []
    for name in ("a.json", "b.json"):
        out = tmp_path / name
        assert run("--out", out, "--seed", 7, "--scale", 0.12, "--alpha", 0.1, "--json") == 0
        texts.append(out.read_bytes())
        rules = json.loads(capsys.readouterr().out)["tabletop-pairs"]["rules"]
    assert texts[0] == texts[1]
    assert rules["linear12"]["pr_auc"] > rules["speed only"]["pr_auc"] + 0.1
    assert rules["linear12"]["negative_frames"] < rules["speed only"]["negative_frames"]
    assert rules["linear12"]["recall"] >= 0.85
    assert weights.load(tmp_path / "a.json").certificate["alpha"] == 0.1
    assert not list(tmp_path.glob("*.part"))


def test_the_single_steps_make_the_model_that_one_command_makes(tmp_path):
    pytest.importorskip("sklearn")
    at = {name: str(tmp_path / name) for name in ("train", "held", "f.json", "c.json", "t.json")}
    drawn = ["generate", "--scenario", "tabletop-pairs", "--seed", "3", "--json"]
    apex(*drawn, "--scenes", "720", "--purpose", "train", "--out", at["train"])
    held = ["--scenes", "1920", "--purpose", "calibration", "--only-contacts"]
    apex(*drawn, *held, "--out", at["held"])
    apex("fit", "--model", "linear12", "--data", at["train"], "--seed", "3", "--out", at["f.json"])
    apex("calibrate", "--model", at["f.json"], "--data", at["held"], "--alpha", "0.1",
         "--out", at["c.json"])  # fmt: skip
    apex("trigger", "--seed", "3", "--scale", "0.12", "--alpha", "0.1", "--out", at["t.json"])
    steps, one = (json.loads((tmp_path / n).read_text()) for n in ("c.json", "t.json"))
    for key in ("metrics", "sha256"):
        del steps[key], one[key]
    assert steps == one


def test_too_few_scenes_leave_no_file(tmp_path):
    pytest.importorskip("sklearn")
    with pytest.raises(calibrate.TooFewEventsError):
        run("--out", tmp_path / "w.json", "--seed", 1, "--scale", 0.02)
    assert not list(tmp_path.iterdir())


def test_without_scikit_learn_it_says_what_to_install(monkeypatch, tmp_path):
    def missing(name):
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(extras.importlib, "import_module", missing)
    with pytest.raises(extras.MissingExtraError, match=r"pip install 'apex-edge\[train\]'"):
        pipeline.train("linear12", 1, pipeline.Sizes(), calibrate.Promise())


@pytest.mark.parametrize(
    ("option", "value"), [("--seed", -1), ("--alpha", 0), ("--alpha", 1.5), ("--scale", 0)]
)
def test_options_out_of_range_are_refused(option, value, tmp_path):
    options = {"--out": tmp_path / "w.json", "--seed": 1}
    options[option] = value
    with pytest.raises(ApexError, match=option):
        run(*[part for pair in options.items() for part in pair])


def test_a_folder_that_does_not_exist_is_refused_before_the_work(tmp_path):
    with pytest.raises(ApexError, match="folder"):
        run("--out", tmp_path / "no" / "w.json", "--seed", 1)
