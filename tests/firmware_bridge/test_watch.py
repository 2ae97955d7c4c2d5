"""Who is called silent, and when."""

import numpy as np
import pytest

from firmware_bridge.kinematics import ArmModel
from firmware_bridge.servos import Measured
from firmware_bridge.watch import Watch

IDS = (1, 2, 3)


@pytest.fixture
def watch():
    policy = ArmModel.load("so-101").policy
    return Watch(policy, {i: f"joint {i}" for i in IDS}, IDS)


def seen(*missing):
    q_rad = np.array([np.nan if i in missing else 0.0 for i in IDS])
    return Measured(0.0, q_rad, np.full(3, np.nan), np.isfinite(q_rad), missing, {})


def told(watch, at_s, *missing):
    return [trouble.servo_id for trouble in watch.silent(at_s, seen(*missing))]


def test_one_silent_servo_is_told_once_after_three_reads(watch):
    assert [told(watch, 0.02 * n, 2) for n in range(5)] == [[], [], [2], [], []]


def test_a_servo_that_came_back_is_told_again(watch):
    for n in range(3):
        told(watch, 0.02 * n, 2)
    assert told(watch, 0.06) == []
    assert [told(watch, 0.1 + 0.02 * n, 2) for n in range(3)] == [[], [], [2]]


def test_a_line_that_stutters_for_a_moment_is_no_fault_of_every_servo(watch):
    assert [told(watch, 0.04 * n, *IDS) for n in range(5)] == [[]] * 5
    assert told(watch, 0.2) == []


def test_a_line_that_stays_silent_is_told_of_every_servo(watch):
    found = [told(watch, 0.1 * n, *IDS) for n in range(4)]
    assert found == [[], [], [], [1, 2, 3]]
