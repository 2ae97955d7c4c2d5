import json

import numpy as np
import pytest

from apex_edge.triggers.approach import Pairs
from apex_edge.triggers.base import TriggerConfig
from offline_train.trigger import evaluate, observe, seeds
from offline_train.trigger.evaluate import Rated

CONFIG = TriggerConfig(persist_hits=1, persist_frames=1)


def observed(contact_s, kind, n_frames=40, frame_s=0.1):
    """Pairs of which every frame before contact is judged, passes the gate and is clearly seen."""
    contact_s = np.array(contact_s, dtype=float)
    n = len(contact_s)
    time = np.arange(n_frames) * frame_s
    is_judged = time < contact_s[:, None]
    pair, frame = np.nonzero(is_judged)
    r = len(pair)
    geometry = Pairs(
        offset_m=np.full((r, 2), 0.2),
        mover_vel_m_s=np.column_stack([0.1 + 0.01 * pair, np.zeros(r)]),
        target_vel_m_s=np.zeros((r, 2)),
        decel_m_s2=np.zeros(r),
        radius_m=np.full(r, 0.04),
        cov=np.zeros((r, 4, 4)),
    )
    plain = {
        "pair": pair,
        "frame": frame,
        "centre_moves": np.zeros(r, dtype=bool),
        "features": np.zeros((r, 12)),
        "wide": np.zeros((r, 0)),
        "rule_probability": np.zeros(r),
        "rule_hit": np.zeros(r, dtype=bool),
        "label": contact_s[pair] - time[frame] <= 5.0,
        "soft": np.full(r, np.nan),
        "scene": np.arange(n),
        "body": np.ones(n, dtype=int),
        "kind": np.array(kind),
        "contact_s": contact_s,
        "frame_s": np.full(n, frame_s),
        "horizon_s": np.full(n, 5.0),
        "is_judged": is_judged,
        "is_clear": is_judged,
    }
    names = {spec.name for spec in observe.fields(observe.Observed)} - {"geometry"}
    assert names <= set(plain), names - set(plain)
    return observe.Observed(geometry=geometry, **{name: plain[name] for name in names})


@pytest.fixture
def four():
    # two events at 3 s, two tracks that never touch, one of each kind
    return observed([3.0, 3.0, np.inf, np.inf], [0, 0, 1, 2])


def fired_from(seen, start_s):
    """A score of 1 from ``start_s (n,)`` on, else 0."""
    return (seen.frame * seen.frame_s[seen.pair] >= np.array(start_s)[seen.pair]).astype(float)


def test_an_event_counts_only_when_it_is_announced_by_the_lead(four):
    score = fired_from(four, [1.9, 2.2, np.inf, np.inf])
    found = evaluate.evaluate(
        four, {"ours": Rated(score, 0.5)}, evaluate.Testing(CONFIG, 1.0, ("a", "b"))
    )
    assert (found["n_events"], found["n_contacts"]) == (2, 2)
    ours = found["rules"]["ours"]
    assert ours["recall"] == 0.5
    leads = dict(zip(ours["leads"]["lead_s"], ours["leads"]["recall"]))
    assert (leads[0.2], leads[0.6], leads[1.0], leads[1.2]) == (1.0, 1.0, 0.5, 0.0)


def test_recall_never_rises_with_the_lead_while_the_same_events_count(four):
    score = fired_from(four, [0.9, 1.7, np.inf, np.inf])
    found = evaluate.evaluate(four, {"ours": Rated(score, 0.5)}, evaluate.Testing(CONFIG))
    recall = found["rules"]["ours"]["leads"]["recall_of_all"]
    assert all(late >= early for late, early in zip(recall, recall[1:]))


def test_false_alarms_are_counted_by_kind_and_by_frame(four):
    score = fired_from(four, [0.0, 0.0, 3.0, np.inf])
    testing = evaluate.Testing(CONFIG, 1.0, ("hit", "near", "far"))
    ours = evaluate.evaluate(four, {"ours": Rated(score, 0.5)}, testing)["rules"]["ours"]
    assert ours["by_kind"] == {"near": {"n": 1, "fired": 1}, "far": {"n": 1, "fired": 0}}
    assert ours["harmless_tracks"] == 0.5
    # 80 harmless frames, all of which pass the gate; the events are within the horizon throughout
    assert ours["negative_frames"] == ours["moving_negative_frames"] == pytest.approx(10 / 80)


def test_the_vote_is_part_of_what_is_measured(four):
    score = fired_from(four, [1.9, 1.9, np.inf, np.inf])
    slow = TriggerConfig(persist_hits=3, persist_frames=5)
    rule = {"ours": Rated(score, 0.5)}
    assert evaluate.evaluate(four, rule, evaluate.Testing(CONFIG))["rules"]["ours"]["recall"] == 1.0
    assert evaluate.evaluate(four, rule, evaluate.Testing(slow))["rules"]["ours"]["recall"] == 0.0


def test_rules_without_a_threshold_announce_as_many_events_as_the_reference():
    seen = observed([3.0] * 10 + [np.inf] * 5, [0] * 15)
    rank = seen.pair.astype(float)
    rated = {"ours": Rated(rank, 3.0), "other": Rated(-rank)}
    rules = evaluate.evaluate(seen, rated, evaluate.Testing(CONFIG, reference="ours"))["rules"]
    assert rules["ours"]["recall"] == rules["other"]["recall"] == pytest.approx(0.7)
    assert rules["other"]["threshold"] == -6.0
    alone = evaluate.evaluate(seen, {"other": rated["other"]}, evaluate.Testing(CONFIG, recall=0.9))
    assert alone["rules"]["other"]["recall"] == pytest.approx(0.9)


def test_events_that_no_threshold_can_announce_do_not_make_everything_fire():
    seen = observed([3.0, 3.0, np.inf], [0, 0, 0])
    keep = seen.pair != 1
    table = seen.to_arrays()
    for name in table:
        if len(table[name]) == len(keep):
            table[name] = table[name][keep]
    gone = observe.Observed.from_arrays(table)
    rated = {"ours": Rated(gone.speed_m_s)}
    found = evaluate.evaluate(gone, rated, evaluate.Testing(CONFIG, recall=1.0))["rules"]["ours"]
    assert found["recall"] == 0.5
    assert found["threshold"] is None


def test_a_set_without_events_or_frames_is_reported_and_not_invented():
    seen = observed([np.inf, np.inf], [0, 0])
    found = evaluate.evaluate(seen, {"ours": Rated(seen.speed_m_s, 0.0)}, evaluate.Testing(CONFIG))
    ours = found["rules"]["ours"]
    assert found["eligible_share"] is None and ours["recall"] is None and ours["pr_auc"] is None
    assert ours["negative_frames"] == 1.0
    json.dumps(found, allow_nan=False)


def test_the_ceiling_never_scores_a_scene_it_has_learnt_from(monkeypatch):
    seen = observe.observe(
        seeds.rng("test", 3), "tabletop-pairs", 150, observe.Watching(), TriggerConfig()
    )
    asked = []

    def trees(train, label, test, seed):
        asked.append((set(train[:, 0]), set(test[:, 0])))
        return np.full(len(test), float(len(asked)))

    monkeypatch.setattr(evaluate.baselines, "gradient_boosting", trees)
    scene = seen.scene[seen.pair].astype(float)[:, None]
    beside = evaluate.beside(seen, scene, seed=0)
    assert list(beside) == list(evaluate.BASELINES)
    assert len(asked) == 3 and all(not learnt & scored for learnt, scored in asked)
    assert set().union(*(scored for _, scored in asked)) == set(scene[:, 0])
    assert np.all(beside[evaluate.BOOSTING].score > 0)


def test_the_summary_leaves_only_the_curves_out(four):
    found = evaluate.evaluate(four, {"ours": Rated(four.speed_m_s, 0.0)}, evaluate.Testing(CONFIG))
    short = evaluate.summary(found)
    assert "leads" in found["rules"]["ours"] and "leads" not in short["rules"]["ours"]
    assert short["rules"]["ours"]["recall"] == found["rules"]["ours"]["recall"]
