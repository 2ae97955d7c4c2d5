import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from trigger_scene import difference, tracks, watch

from apex_edge import plugins
from apex_edge.errors import ConfigError
from apex_edge.triggers.analytic import AnalyticTrigger
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.vote import Persistence

BOTH = pytest.mark.parametrize("name", ["analytic", "linear"])
DT_S = 1.0 / 30.0


def make(name, **settings):
    return plugins.load("triggers", name)(TriggerConfig(**settings))


def approaching(**changes):
    return tracks([[0, 0], [0.25, 0]], [[0, 0], [-0.1, 0]], **changes)


def score(trigger, now, times=1):
    for _ in range(times):
        found = trigger.score(difference(now), 5.0)
    return found


@BOTH
@pytest.mark.parametrize(("sd", "window"), [(0.003, 5), (0.001, 10), (0.002, 20)])
def test_a_still_noisy_table_never_fires(name, sd, window):
    still = np.array([[0.12, 0.0], [0.2, 0.05], [0.15, -0.1], [0.16, 0.0]])
    true = np.repeat(still[None], 1000 + window, axis=0)
    trigger, n_frames, n_fired = make(name), 0, 0
    for diff in watch(true, sd, DT_S, window, np.random.RandomState(window)):
        n_frames += 1
        n_fired += int(trigger.score(diff, 5.0).is_fired.sum())
    assert n_frames == 1000
    assert n_fired == 0


@BOTH
def test_a_head_on_approach_fires_within_four_frames_of_its_speed_being_known(name):
    window, n = 8, 30
    true = np.zeros((n, 2, 2))
    true[:, 1, 0] = 0.3 - 0.1 * DT_S * np.arange(n)
    trigger = make(name)
    watched = watch(true, 0.0007, DT_S, window, np.random.RandomState(1))
    fired = [bool(trigger.score(diff, 5.0).is_fired[0]) for diff in watched]
    assert any(fired[:4])
    assert all(fired[4:])


@BOTH
def test_the_faster_one_is_the_mover_whatever_the_order(name):
    for order in ([0, 1], [1, 0]):
        now = tracks(
            np.array([[0, 0], [0.25, 0]])[order],
            np.array([[0.02, 0], [-0.1, 0]])[order],
            track_id=np.array([5, 8])[order],
        )
        found = score(make(name), now)
        assert (found.mover_id[0], found.target_id[0]) == (8, 5)


@BOTH
def test_jitter_does_not_take_the_movers_part(name):
    # the resting one shows the larger speed, but within its noise
    now = tracks([[0, 0], [0.25, 0]], [[0.06, 0.06], [-0.05, 0]])
    cov = now.cov.copy()
    cov[0, 3:, 3:] = np.eye(3) * 0.04**2
    found = score(make(name), replace(now, cov=cov))
    assert found.mover_id[0] == 2


@BOTH
def test_an_approach_is_scored_with_its_geometry(name):
    found = score(make(name), approaching(), times=3)
    assert found.is_fired[0]
    assert found.ttc_s[0] == pytest.approx(2.2)
    assert found.tca_s[0] == pytest.approx(2.5)
    assert found.dca_m[0] == pytest.approx(0.0, abs=1e-9)
    assert 1.5 < found.ttc_early_s[0] < 2.2
    # both positions and both velocities, over 2.5 s
    assert found.sigma_m[0] == pytest.approx(np.sqrt(2 * (0.001**2 + (2.5 * 0.004) ** 2)))
    assert found.probability[0] > 0.5
    assert (found.seq, found.t_s) == (1, 1.0)


@BOTH
def test_what_moves_away_passes_far_off_or_never_arrives_does_not_fire(name):
    for velocity in ([0.1, 0.0], [0.0, 0.1], [-0.03, 0.0]):
        found = score(make(name), tracks([[0, 0], [0.25, 0]], [[0, 0], velocity]), times=6)
        assert not found.is_fired[0], velocity
        assert found.probability[0] < 0.25


@BOTH
def test_a_ball_seen_to_roll_out_in_time_does_not_fire(name):
    acc = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    stopping = tracks([[0, 0], [0.3, 0]], [[0, 0], [-0.15, 0]], acc_m_s2=acc, sd_m_s=0.002)
    assert not score(make(name), stopping, times=5).is_fired[0]
    rolling = tracks([[0, 0], [0.3, 0]], [[0, 0], [-0.15, 0]], sd_m_s=0.002)
    assert score(make(name), rolling, times=5).is_fired[0]


@BOTH
def test_an_unknown_motion_stays_silent_and_finite(name):
    for changes in (
        {"vel_m_s": np.full((2, 3), np.nan)},
        {"cov": np.full((2, 6, 6), np.nan)},
    ):
        found = score(make(name), replace(approaching(), **changes), times=5)
        assert not found.is_fired[0]
        assert found.probability[0] == 0.0
        assert found.ttc_early_s[0] == np.inf
        assert np.isfinite(found.dca_m[0])


@BOTH
def test_an_unknown_size_does_not_hide_a_contact(name):
    found = score(make(name), approaching(radius_m=np.array([np.nan, 0.015])), times=3)
    assert found.is_fired[0]


@BOTH
def test_firing_takes_three_hits_of_the_last_five_frames_and_reset_forgets(name):
    trigger, away = make(name), tracks([[0, 0], [0.25, 0]], [[0, 0], [0.1, 0]])
    fired = [score(trigger, now).is_fired[0] for now in [approaching()] * 3]
    assert fired == [False, False, True]
    # two misses do not undo three hits, but what moves away is never called a hazard
    assert not score(trigger, away).is_fired[0]
    assert not score(trigger, away).is_fired[0]
    assert score(trigger, approaching()).is_fired[0]
    trigger.reset()
    assert not score(trigger, approaching()).is_fired[0]


def test_the_vote_counts_n_of_m_per_pair_and_forgets_pairs_that_left():
    vote = Persistence(2, 3)
    pair, other = np.array([[1, 2]]), np.array([[2, 3]])
    yes, no = np.array([True]), np.array([False])
    assert not vote.update(pair, yes)[0]
    assert not vote.update(pair, no)[0]
    assert vote.update(pair[:, ::-1], yes)[0]
    assert vote.update(pair, yes)[0]
    assert not vote.update(other, yes)[0]
    assert not vote.update(pair, yes)[0]


def test_the_vote_on_a_crowd_is_the_vote_on_each_pair_alone():
    rng = np.random.default_rng(0)
    pairs = np.array([(i, j) for i in range(20) for j in range(i)]) + (1 << 31) - 10
    crowd, alone = Persistence(2, 4), [Persistence(2, 4) for _ in pairs]
    n_fired = 0
    for _ in range(12):
        hits = rng.random(len(pairs)) < 0.2
        turned = np.where(rng.random(len(pairs))[:, None] < 0.5, pairs, pairs[:, ::-1])
        fired = crowd.update(turned, hits)
        each = [vote.update(turned[k : k + 1], hits[k : k + 1])[0] for k, vote in enumerate(alone)]
        assert fired.tolist() == each
        n_fired += int(fired.sum())
    assert 0 < n_fired < 12 * len(pairs)


def test_more_noise_makes_the_analytic_rule_more_and_not_less_ready_to_fire():
    passing = [[0, 0], [0.25, 0.05]], [[0, 0], [-0.1, 0]]
    fired = [
        bool(score(AnalyticTrigger(), tracks(*passing, sd_m_s=sd), times=3).is_fired[0])
        for sd in (0.001, 0.01)
    ]
    assert fired == [False, True]


def test_settings_are_strict():
    from apex_edge.config import structure

    assert structure(TriggerConfig, {"k_sigma": 2}, "x").k_sigma == 2.0
    with pytest.raises(ConfigError, match="k_sigma"):
        structure(TriggerConfig, {"k_sgma": 2.0}, "x")
    with pytest.raises(ConfigError, match="outside"):
        structure(TriggerConfig, {"k_sigma": -1.0}, "x")


def test_importing_the_triggers_pulls_in_no_training_stack():
    code = (
        "import sys, apex_edge.triggers.linear, apex_edge.triggers.analytic, apex_edge.graph\n"
        "apex_edge.triggers.linear.LinearTrigger()\n"
        "bad = {'sklearn', 'scipy', 'offline_train', 'torch', 'mujoco'} & set(sys.modules)\n"
        "assert not bad, bad\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=100)
