import builtins
import sys

import numpy as np
import pytest

from offline_train.extras import MissingExtraError
from offline_train.scenes import mujoco_table, mujoco_world
from offline_train.scenes.mujoco_world import DRIVEN, FLICKED, PUSHED, STEP_S, Body, run
from offline_train.scenes.truth import LOOK_AHEAD_S, scenario
from offline_train.trigger import seeds

pytest.importorskip("mujoco")
FAR = Body(False, FLICKED, 5.0, 5.0, 0.0, 0.015, 0.3)
RED = Body(False, FLICKED, 0.0, 0.0, 0.0, 0.015, 0.3)


def alone(body, until_s):
    return run([FAR, body], until_s)


def speeds(done, number=1):
    return np.linalg.norm(done.vel_m_s[number, :, :2], axis=1)


@pytest.mark.parametrize(("speed", "slow"), [(0.05, 0.01), (0.1, 0.02), (0.4, 0.05)])
def test_a_ball_slows_down_as_its_rolling_friction_says(speed, slow):
    found = speeds(alone(Body(True, FLICKED, 0.0, 0.0, 0.4, 0.015, slow, speed), 3.0))
    first, last = int(0.2 / STEP_S), int(2.7 / STEP_S)
    assert (found[first] - found[last]) / 2.5 == pytest.approx(slow, rel=0.03)


@pytest.mark.parametrize("mu", [0.05, 0.2, 0.35])
def test_a_block_slides_as_far_as_its_friction_lets_it(mu):
    done = alone(Body(False, FLICKED, 0.0, 0.0, -0.7, 0.015, mu, 0.6), 2.0)
    way = np.linalg.norm(done.pos_m[1, -1, :2])
    assert way == pytest.approx(0.6**2 / (2.0 * mu * 9.81), rel=0.03)
    assert speeds(done)[-1] < 1e-3


@pytest.mark.parametrize("is_ball", [True, False])
def test_a_flick_gives_the_speed_it_was_asked_for(is_ball):
    body = Body(is_ball, FLICKED, 0.0, 0.0, 1.0, 0.015, 0.05, 0.3, 0.5)
    done = alone(body, 1.5)
    assert speeds(done)[: int(0.49 / STEP_S)].max() < 1e-3
    assert speeds(done).max() == pytest.approx(0.3, rel=0.03)


def test_a_straight_ball_touches_when_the_closed_form_says():
    speed, slow, gap = 0.2, 0.02, 0.3 - 0.015 - 0.015
    done = run([RED, Body(True, FLICKED, -0.3, 0.0, 0.0, 0.015, slow, speed)], 3.0)
    expected = (speed - np.sqrt(speed**2 - 2.0 * slow * gap)) / slow
    assert done.contact_s[0] == pytest.approx(expected, abs=2.0 * STEP_S)
    at = int(round(done.contact_s[0] / STEP_S))
    assert done.pos_m[1, at, 0] == pytest.approx(-0.03, abs=0.001)


def test_a_hand_runs_its_plan_and_stops_where_it_meant_to():
    hand = Body(False, DRIVEN, -0.3, 0.0, 0.0, 0.015, 0.3, 0.1, 0.5, 0.2)
    done = run([RED, hand], 4.0)
    assert done.contact_s[0] == np.inf
    assert done.pos_m[1, -1, 0] == pytest.approx(-0.1, abs=1e-3)
    middle = int((0.5 + 1.0) / STEP_S)
    assert speeds(done)[middle] == pytest.approx(1.875 * 0.1, rel=0.02)


def test_a_finger_pushes_its_block_to_the_end_and_touches_nothing_else():
    pushed = Body(False, PUSHED, -0.3, 0.0, 0.0, 0.015, 0.3, 0.1, 0.2, 0.2)
    done = run([Body(False, FLICKED, -0.3 - 0.04, 0.0, 0.0, 0.015, 0.3), pushed], 4.0)
    assert done.pos_m[1, -1, 0] == pytest.approx(-0.1, abs=0.006)
    # the finger starts inside the other block and leaves it where it is
    assert np.allclose(done.pos_m[0, -1], done.pos_m[0, 0], atol=1e-3)


@pytest.fixture(scope="module")
def tables():
    rng = seeds.rng("test", 11)
    drawn = [mujoco_table.draw_bodies(rng)[0] for _ in range(12)]
    return [(bodies, run(bodies, 6.0)) for bodies in drawn]


def test_nothing_falls_through_the_table_or_flies_off(tables):
    for bodies, done in tables:
        half = np.array([body.half_m for body in bodies])[:, None]
        assert np.all(done.pos_m[:, :, 2] > 0.97 * half - 0.0005)
        assert np.all(done.pos_m[:, :, 2] < half + 0.05)


def test_free_bodies_never_gain_energy():
    masses = {True: 0.02 * 1.4, False: 0.03}
    balls = [Body(True, FLICKED, x, 0.02 * x, np.pi, 0.015, 0.02, 0.3) for x in (0.1, 0.2)]
    bodies = [RED, *balls, Body(False, FLICKED, 0.0, 0.25, -np.pi / 2, 0.015, 0.1, 0.8)]
    done = run(bodies, 4.0)
    energy = sum(0.5 * masses[b.is_ball] * speeds(done, i) ** 2 for i, b in enumerate(bodies))
    assert np.isfinite(done.contact_s).any()
    assert energy[-1] < 0.01 * energy[0]
    # spinning balls hide a little energy that comes back when they grip again
    assert np.all(np.diff(energy) < 0.02 * energy[0])
    assert energy.max() < 1.01 * energy[0]


def test_the_first_touch_is_where_the_outlines_meet(tables):
    n_seen = 0
    for bodies, done in tables:
        for number in np.flatnonzero(np.isfinite(done.contact_s)):
            at = int(round(done.contact_s[number] / STEP_S))
            gap = np.linalg.norm(done.pos_m[0, at, :2] - done.pos_m[number + 1, at, :2])
            halves = [bodies[0].half_m, bodies[number + 1].half_m]
            assert sum(halves) - 0.004 < gap < np.sqrt(2.0) * sum(halves) + 0.004
            n_seen += 1
    assert n_seen > 3


def test_a_scene_has_the_paths_at_the_frame_times_and_repeats_byte_for_byte():
    frame_s = np.array([0.04, 0.05, 0.035])
    one, again = (scenario("mujoco").draw(seeds.rng("test", 2), frame_s, 60) for _ in range(2))
    for name in ("centre_m", "other_m", "contact_s", "radius_m", "kind"):
        assert getattr(one, name).tobytes() == getattr(again, name).tobytes()
    assert one.other_m.shape == (3, mujoco_table.N_OTHERS, 60, 2)
    found = np.isfinite(one.contact_s)
    assert np.all(one.contact_s[found] <= 59 * 0.05 + LOOK_AHEAD_S + STEP_S)
    other = scenario("mujoco").draw(seeds.rng("test", 3), frame_s, 60)
    assert not np.array_equal(one.other_m, other.other_m)


def test_passive_bodies_do_reach_something():
    truth = mujoco_table.draw(seeds.rng("test", 4), np.full(30, 0.05), 40)
    for kind in (mujoco_table.BALL, mujoco_table.BLOCK, mujoco_table.HAND):
        assert 0.05 < np.isfinite(truth.contact_s[truth.kind == kind]).mean() < 0.6
    assert not np.isfinite(truth.contact_s[truth.kind == mujoco_table.STILL]).all()


def test_without_mujoco_the_error_says_what_to_install(monkeypatch):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("mujoco"):
            raise ImportError("none here")
        return real(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "mujoco", raising=False)
    monkeypatch.setattr(builtins, "__import__", refuse)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"apex-edge\[offline\]"):
        mujoco_world.run([RED], 0.1)
