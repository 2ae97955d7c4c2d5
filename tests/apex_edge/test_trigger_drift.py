"""The drift alarm: counted by capture time, raised by a share, ended at half of it."""

import logging

import numpy as np
import pytest
from trigger_scene import difference, tracks

from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.drift import DriftMonitor, DriftRules
from apex_edge.triggers.linear import LinearTrigger

RULES = DriftRules(window_s=10.0, min_pairs=20, share=0.1)


def fed(monitor, frames):
    """Feed (t_s, n_pairs, n_outside) and return what the monitor said each time."""
    return [monitor.update(*frame) for frame in frames]


def test_few_pairs_say_nothing():
    assert not any(fed(DriftMonitor(RULES, "m"), [(float(t), 1, 1) for t in range(10)]))


def test_the_alarm_rises_above_the_share_and_ends_below_half_of_it():
    monitor = DriftMonitor(RULES, "m")
    assert fed(monitor, [(0.0, 20, 2), (1.0, 1, 1)]) == [False, True]
    # 3 of 55 is more than half of a tenth, 3 of 65 is less
    assert fed(monitor, [(2.0, 34, 0), (3.0, 10, 0)]) == [True, False]


def test_old_pairs_are_forgotten_by_capture_time():
    monitor = DriftMonitor(RULES, "m")
    fed(monitor, [(0.0, 10, 10), (9.0, 9, 0)])
    assert fed(monitor, [(10.5, 20, 0)]) == [False]


def test_an_alarm_stays_while_nothing_is_judged():
    monitor = DriftMonitor(RULES, "m")
    assert fed(monitor, [(0.0, 30, 30), (60.0, 0, 0), (61.0, 5, 0)]) == [True, True, True]


def test_a_clock_that_steps_back_starts_the_count_anew():
    monitor = DriftMonitor(RULES, "m")
    assert fed(monitor, [(100.0, 19, 19), (5.0, 19, 0), (6.0, 1, 0)]) == [False, False, False]


def test_each_change_is_one_line_in_the_log(caplog):
    monitor = DriftMonitor(RULES, "model.json")
    with caplog.at_level(logging.WARNING):
        fed(monitor, [(0.1 * t, 30, 30) for t in range(5)])
        fed(monitor, [(20.0 + 0.1 * t, 30, 0) for t in range(5)])
    assert len(caplog.records) == 2
    assert all("model.json" in record.getMessage() for record in caplog.records)


@pytest.fixture
def trigger():
    return LinearTrigger(TriggerConfig(drift_min_pairs=10))


def scene(frame, radius_m):
    now = tracks([[0.0, 0.0], [0.3, 0.0]], [[0.1, 0.0], [0.0, 0.0]], seq=frame, t_s=frame / 30.0)
    return difference(
        type(now)(**dict(now.__dict__, radius_m=np.full(2, radius_m), n_samples=np.full(2, 15)))
    )


def test_while_pairs_are_unlike_the_training_set_the_rule_judges_them_all(trigger):
    known = [trigger.score(scene(frame, 0.02), 5.0) for frame in range(30)]
    assert not any(scores.is_fallback.any() for scores in known)
    strange = [trigger.score(scene(30 + frame, 0.2), 5.0) for frame in range(30)]
    assert all(scores.is_fallback.all() for scores in strange)
    assert trigger.is_drifting
    after = trigger.score(scene(60, 0.02), 5.0)
    assert after.is_fallback.all()
    assert after.probability[0] > 0.0


def test_reset_ends_the_alarm(trigger):
    for frame in range(30):
        trigger.score(scene(frame, 0.2), 5.0)
    assert trigger.is_drifting
    trigger.reset()
    assert not trigger.is_drifting
    assert not trigger.score(scene(31, 0.02), 5.0).is_fallback.any()


def test_young_tracks_and_another_horizon_are_no_drift(trigger):
    for frame in range(30):
        now = scene(frame, 0.02)
        trigger.score(now, 4.0)
        now.graph.tracks.n_samples[:] = 3
        assert trigger.score(now, 5.0).is_fallback.all()
    assert not trigger.is_drifting
