"""The benches of kinematics and guard hold what they promise, in their short form."""

import numpy as np
import pytest

from firmware_bridge.kinematics import ArmModel
from offline_train.benchmarks.firmware import guard_cases, kinematics
from offline_train.benchmarks.lines import are_all_ok


def test_every_arm_comes_back_to_the_point_it_was_asked_for():
    rng = np.random.default_rng(4)
    for name in ("armpi-mini", "so-101", "xarm-1s"):
        assert are_all_ok(kinematics._round_trip(ArmModel.load(name), 400, rng))


def test_plain_python_finds_the_joints_that_the_bench_compares_with():
    arm = ArmModel.load("armpi-mini")
    tips = np.random.default_rng(1).uniform([0.0, -0.2, 0.0], [0.2, 0.2, 0.25], (40, 3))
    found, is_reachable = arm.inverse(tips)
    plain = [kinematics.plain_inverse(arm, tip) for tip in tips.tolist()]
    assert [each is not None for each in plain] == is_reachable.tolist()
    assert np.allclose([each for each in plain if each is not None], found[is_reachable])


def test_guard_and_oracle_agree_in_the_short_form():
    lines = guard_cases.measure(0.001, 6)
    assert are_all_ok(lines)
    assert len([line for line in lines if "broken limits" in line.what]) == len(guard_cases.ARMS)


@pytest.mark.parametrize("name", ["so-101", "armpi", "learm"])
def test_the_oracles_own_transforms_agree_with_the_arm(name):
    arm = ArmModel.load(name)
    q = np.random.default_rng(0).uniform(*arm.limits_rad.T, (200, arm.n_joints))
    assert np.abs(guard_cases.link_points(arm, q) - arm.forward(q)).max() < 1e-12


def test_a_seed_gives_the_same_targets_again():
    arm = ArmModel.load("armpi")
    one, two = np.random.default_rng(8), np.random.default_rng(8)
    for _ in range(100):
        first, second = guard_cases.hostile(one, arm), guard_cases.hostile(two, arm)
        assert (first.kind, first.deadline_s) == (second.kind, second.deadline_s)
        assert str(first.joints_rad) == str(second.joints_rad)
