"""Lines through sightings by their real times, the history behind them, and the wide features."""

import numpy as np
import pytest
from trigger_scene import difference, tracks

from apex_edge.triggers.base import Trigger, Verdict
from apex_edge.triggers.feature_sets import FEATURE_SETS, model_features
from apex_edge.triggers.wide import WIDE_NAMES, WIDE_UNITS, wide_features
from apex_edge.triggers.windows import WINDOWS, History, fit_lines, line_pairs

HORIZON_S = 5.0
FRAME_S = 0.05


def column(features, name):
    return features[:, WIDE_NAMES.index(name)]


def test_a_line_agrees_with_least_squares_by_polyfit():
    rng = np.random.default_rng(1)
    t_s = np.sort(rng.uniform(0.0, 1.0, (6, 9)), axis=1)
    xy = rng.normal(size=(6, 9, 2))
    sd = rng.uniform(0.001, 0.01, 6)
    found = fit_lines(t_s, xy, sd)
    for row in range(6):
        since = t_s[row] - t_s[row, -1]
        design = np.column_stack([np.ones(9), since])
        unit = np.linalg.inv(design.T @ design) * sd[row] ** 2
        for axis in range(2):
            slope, level = np.polyfit(since, xy[row, :, axis], 1)
            assert found.position[row, axis] == pytest.approx(level, abs=1e-9)
            assert found.velocity[row, axis] == pytest.approx(slope, abs=1e-9)
            assert np.allclose(found.cov[row][axis::2, axis::2], unit, rtol=1e-9)
        assert np.all(found.cov[row][::2, 1::2] == 0.0)


def test_the_stated_covariance_is_that_of_many_noisy_fits():
    rng = np.random.default_rng(2)
    t_s = np.tile(np.arange(11) * FRAME_S, (20000, 1))
    xy = rng.normal(size=(20000, 11, 1)) * 0.003
    found = fit_lines(t_s, xy, np.full(20000, 0.003))
    both = np.column_stack([found.position, found.velocity])
    assert np.allclose(np.cov(both.T), found.cov[0], rtol=0.05)


def test_a_gap_in_the_sightings_changes_nothing_but_the_certainty():
    t_s = np.array([[0.0, 0.05, 0.1, 0.4, 0.45], [0.0, 0.05, 0.1, 0.15, 0.2]])
    found = fit_lines(t_s, t_s[..., None] * [0.1, -0.2], np.full(2, 0.003))
    assert np.allclose(found.velocity, [[0.1, -0.2]] * 2)
    assert found.cov[0, 2, 2] < found.cov[1, 2, 2]


def test_a_young_track_uses_what_it_has_but_two_sightings_are_too_few():
    t_s = np.array([[np.nan, np.nan, 0.0, 0.1, 0.2], [np.nan, np.nan, np.nan, 0.1, 0.2]])
    found = fit_lines(t_s, t_s[..., None] * [0.1, 0.0], np.full(2, 0.003))
    assert found.velocity[0, 0] == pytest.approx(0.1)
    assert np.isnan(found.velocity[1]).all()
    assert np.isnan(found.cov[1, 2, 2])


def test_a_line_read_later_moves_on_and_is_less_sure():
    t_s, sd = np.array([[0.0, 0.1, 0.2]]), np.array([0.003])
    xy = t_s[..., None] * [0.1, 0.0]
    now, later = fit_lines(t_s, xy, sd), fit_lines(t_s, xy, sd, np.array([1.2]))
    assert later.position[0, 0] == pytest.approx(0.12)
    assert later.cov[0, 0, 0] > now.cov[0, 0, 0]


def frame(number, names_at, seen=True):
    """Return tracks (id, x) moving at 0.1 m/s along x since frame 0."""
    pos = [[x + 0.1 * FRAME_S * number, 0.0] for _, x in names_at]
    found = tracks(
        pos, seq=number, t_s=number * FRAME_S, track_id=np.array([i for i, _ in names_at])
    )
    if not seen:
        found.seen_m[:] = np.nan
        found.seen_sd_m[:] = np.nan
    return found


def test_the_history_follows_identities_through_reordering_and_loss():
    history = History()
    for number in range(8):
        history.update(frame(number, [(1, 0.0), (2, 0.5)]))
    history.update(frame(8, [(3, 0.9), (2, 0.5)]))
    assert history.counts().tolist() == [1, 9]
    for lines in history.lines(8 * FRAME_S):
        assert np.isnan(lines.velocity[0]).all()
        assert lines.velocity[1] == pytest.approx([0.1, 0.0], abs=1e-9)
        assert lines.position[1] == pytest.approx([0.54, 0.0])


def test_what_is_out_of_sight_is_read_where_its_line_has_got_to():
    history = History()
    for number in range(6):
        history.update(frame(number, [(1, 0.0)]))
    history.update(frame(6, [(1, 0.0)], seen=False))
    assert history.counts().tolist() == [6]
    assert history.lines(6 * FRAME_S)[0].position[0, 0] == pytest.approx(0.03)


def test_the_history_keeps_no_more_than_the_longest_window_and_forgets_on_reset():
    history = History()
    for number in range(40):
        history.update(frame(number, [(1, 0.0)]))
    assert history.counts().tolist() == [max(WINDOWS)]
    history.reset()
    history.update(frame(41, [(1, 0.0)]))
    assert history.counts().tolist() == [1]


def seen_pairs(travel_m):
    """Return pairs by window of a mover at ``travel_m (20,)`` along x and a target at 0.4 m."""
    t_s = np.tile(np.arange(20) * FRAME_S, (2, 1))
    xy = np.zeros((2, 20, 2))
    xy[0, :, 0], xy[1, :, 0] = travel_m, 0.4
    return [
        line_pairs(
            fit_lines(t_s[:, -w:], xy[:, -w:], np.full(2, 1e-4)),
            np.array([[0, 1]]),
            np.array([0.04]),
        )
        for w in WINDOWS
    ]


def test_a_steady_mover_shows_no_change_and_a_slowing_one_does():
    t_s = np.arange(20) * FRAME_S
    steady = wide_features(seen_pairs(0.1 * t_s), HORIZON_S)
    slowing = wide_features(seen_pairs(0.2 * t_s - 0.05 * t_s * t_s), HORIZON_S)
    assert abs(column(steady, "turn_along_5_20")[0]) < 1e-6
    assert abs(column(steady, "gain_5_20")[0]) < 1e-6
    assert column(slowing, "turn_along_5_20")[0] < -1.0
    assert column(slowing, "gain_5_20")[0] < -0.2
    assert column(slowing, "turn_along_sd_5_20")[0] < -3.0


def test_the_estimated_deceleration_tells_who_stops_before_contact():
    # at 0.1 m/s^2 from 0.105 m/s now it rests after 0.055 m, more than 0.1 m before contact
    t_s = np.arange(20) * FRAME_S
    found = wide_features(seen_pairs(0.2 * t_s - 0.05 * t_s * t_s), HORIZON_S)
    assert column(found, "dca_5")[0] < 1.0 < column(found, "dca_slowing")[0]
    assert column(found, "room")[0] > 0.0
    unit = HORIZON_S * HORIZON_S / 0.04 / 10.0
    assert column(found, "decel")[0] == pytest.approx(0.1 * unit, rel=1e-6)


def test_wide_features_are_finite_bounded_and_named_once():
    rng = np.random.default_rng(3)
    n = 400
    t_s = np.tile(np.arange(20) * FRAME_S, (2 * n, 1))
    speed = rng.normal(size=(2 * n, 1, 2)) * 0.3 * (rng.random((2 * n, 1, 1)) < 0.7)
    xy = rng.normal(size=(2 * n, 1, 2)) * 0.2 + speed * t_s[..., None]
    xy += rng.normal(size=xy.shape) * 0.002 * (rng.random((2 * n, 1, 1)) < 0.8)
    edges = np.arange(2 * n).reshape(-1, 2)
    windows = [
        line_pairs(
            fit_lines(t_s[:, -w:], xy[:, -w:], np.full(2 * n, 0.002)), edges, np.full(n, 0.04)
        )
        for w in WINDOWS
    ]
    found = wide_features(windows, HORIZON_S)
    assert found.shape == (n, len(WIDE_NAMES)) == (n, len(WIDE_UNITS))
    assert len(set(WIDE_NAMES)) == len(WIDE_NAMES)
    assert np.isfinite(found).all()
    assert np.abs(found).max() <= 60.0


class Watcher(Trigger):
    """Keeps the evidence it is asked about."""

    def judge(self, evidence):
        self.last = evidence
        n = len(evidence.n_samples)
        return Verdict(np.zeros(n), np.zeros(n, dtype=bool), np.zeros(n, dtype=bool))


def watched(trigger, n_frames):
    for number in range(n_frames):
        now = tracks(
            [[0.1 * FRAME_S * number, 0.0], [0.4, 0.0]],
            [[0.1, 0.0], [0.0, 0.0]],
            seq=number,
            t_s=number * FRAME_S,
        )
        trigger.score(difference(now), HORIZON_S)
    return trigger.last


def test_a_trigger_that_asks_for_windows_is_given_them():
    seen = watched(Watcher(windows=WINDOWS), 20)
    assert len(seen.windows) == len(WINDOWS)
    assert [p.mover_vel_m_s[0, 0] for p in seen.windows] == pytest.approx([0.1] * 3)
    assert seen.n_samples.tolist() == [15]
    features = model_features("wide", seen)
    assert np.isfinite(features).all()
    assert watched(Watcher(), 2).windows == ()


def test_after_a_reset_a_track_counts_as_young_as_its_history():
    trigger = Watcher(windows=WINDOWS)
    watched(trigger, 20)
    trigger.reset()
    assert watched(trigger, 4).n_samples.tolist() == [4]


def test_each_feature_set_has_a_name_and_a_unit_for_every_column():
    evidence = watched(Watcher(windows=WINDOWS), 20)
    for name, found in FEATURE_SETS.items():
        assert found.name == name
        assert model_features(name, evidence).shape == (1, len(found.names))
        assert len(found.names) == len(found.units)
