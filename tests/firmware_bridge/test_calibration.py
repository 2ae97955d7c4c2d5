"""An arm's file that names its servo calibration is held against it before anything is armed."""

import re
import time
from dataclasses import replace

import pytest
from live_arm import LiveArm

from apex_edge import documents
from firmware_bridge.arm_file import known_arms
from firmware_bridge.calibration import FORMAT, VERSION, compare_calibration
from firmware_bridge.errors import HandshakeFailed
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.dry import DryLink
from firmware_bridge.ready import ReadyArm
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator.make import Setup
from firmware_bridge.watch import Kind, Watch

NAME = "so-101"


def measured(arm, shift=0.0):
    return [
        {"servo_id": i, "zero_ticks": float(zero) + shift, "ticks_per_rad": float(scale)}
        for i, zero, scale in zip(arm.servo_ids, arm.zero_ticks, arm.ticks_per_rad)
    ]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "calibrations").mkdir()
    return tmp_path


def written(folder, servos, like=NAME, kind=FORMAT):
    """Write a calibration and an arm's file that names it; returns both paths."""
    document = documents.compose(kind, VERSION, {"servos": servos}, {})
    calibration = folder / "calibrations" / "servo.json"
    calibration.write_text(documents.to_text(document))
    arm = folder / "mine.toml"
    arm.write_text(
        f'like = "{like}"\n[calibration]\nfile = "calibrations/servo.json"\n'
        f'sha256 = "{document["sha256"]}"\n'
    )
    return calibration, arm


def troubles_of(path):
    return "; ".join(compare_calibration(ArmModel.load(path))[0])


def test_an_arm_that_names_no_calibration_is_not_compared():
    assert compare_calibration(ArmModel.load(NAME)) == ([], [])


@pytest.mark.parametrize("shift", [0.0, 0.05, -0.05])
def test_a_calibration_that_says_the_same_up_to_rounding_is_fine(folder, shift):
    _, path = written(folder, measured(ArmModel.load(NAME), shift))
    assert compare_calibration(ArmModel.load(path)) == ([], [])


def test_a_missing_calibration_is_named(folder):
    calibration, path = written(folder, measured(ArmModel.load(NAME)))
    calibration.unlink()
    assert "servo.json: cannot read" in troubles_of(path)
    assert "calibrate again" in troubles_of(path)


def test_an_edited_calibration_does_not_match_its_own_hash(folder):
    calibration, path = written(folder, measured(ArmModel.load(NAME)))
    calibration.write_text(calibration.read_text().replace("2048.0", "2049.0", 1))
    assert "the content does not match its hash" in troubles_of(path)


def test_a_newer_calibration_is_not_the_one_of_the_arms_file(folder):
    _, path = written(folder, measured(ArmModel.load(NAME)))
    text = path.read_text()
    written(folder, measured(ArmModel.load(NAME), 0.01))
    path.write_text(text)
    assert "is not the one that the arm's file was made from" in troubles_of(path)


@pytest.mark.parametrize(
    ("key", "by", "message"),
    [
        ("zero_ticks", 0.1, r"elbow_flex \(id 3\) has zero_ticks 2048.0 .* measured 2048.1"),
        ("ticks_per_rad", -2.0, r"elbow_flex \(id 3\) has ticks_per_rad 651.9 .* measured 649.9"),
    ],
)
def test_another_value_is_told_with_joint_and_both_numbers(folder, key, by, message):
    servos = measured(ArmModel.load(NAME))
    servos[2][key] += by
    _, path = written(folder, servos)
    troubles, _ = compare_calibration(ArmModel.load(path))
    assert len(troubles) == 1
    assert re.search(message, troubles[0])


def test_a_joint_that_was_not_measured_is_a_note_and_a_strange_servo_a_trouble(folder):
    servos = measured(ArmModel.load(NAME))
    servos[4]["servo_id"] = 77
    _, path = written(folder, servos)
    troubles, notes = compare_calibration(ArmModel.load(path))
    assert "is of a servo 77" in troubles[0]
    assert "says nothing of wrist_roll (id 5)" in notes[0]


@pytest.mark.parametrize(
    "servos",
    [
        [],
        {},
        [3],
        [{"servo_id": 1}],
        [{"servo_id": 1, "zero_ticks": "2048", "ticks_per_rad": 1.0}],
        [{"servo_id": 1, "zero_ticks": float("nan"), "ticks_per_rad": 1.0}],
        [{"servo_id": True, "zero_ticks": 1.0, "ticks_per_rad": 1.0}],
        [{"servo_id": 1, "zero_ticks": 1.0, "ticks_per_rad": 1.0}] * 2,
    ],
)
def test_a_signed_file_of_something_else_is_refused(folder, servos):
    _, path = written(folder, servos)
    assert "servo.json: servo" in troubles_of(path)


def test_a_file_of_another_format_is_refused(folder):
    _, path = written(folder, measured(ArmModel.load(NAME)), kind="apex-travel")
    assert "not a file of format 'apex-servo'" in troubles_of(path)


def test_the_calibration_is_looked_for_beside_the_file_that_names_it(folder):
    written(folder, measured(ArmModel.load(NAME)))
    (folder / "other").mkdir()
    path = folder / "other" / "copy.toml"
    path.write_text('like = "../mine.toml"\nname = "copy"\n')
    assert compare_calibration(ArmModel.load(path)) == ([], [])
    path.write_text('like = "../mine.toml"\n[joints.elbow_flex]\nzero_ticks = 2040.0\n')
    assert "elbow_flex (id 3) has zero_ticks 2040.0" in troubles_of(path)


def test_a_session_refuses_to_arm_with_another_calibration_and_arms_with_its_own(folder):
    servos = measured(ArmModel.load(NAME))
    servos[0]["zero_ticks"] += 5.0
    _, path = written(folder, servos)
    with LiveArm("sts") as live:
        session = ArmSession(ArmModel.load(path), live.session.bus, time.monotonic)
        session.open()
        assert "shoulder_pan (id 1)" in "; ".join(session.handshake().troubles)
        with pytest.raises(HandshakeFailed, match=r"shoulder_pan \(id 1\) has zero_ticks"):
            session.arm()
        assert session.state is SessionState.CONNECTED
        _, path = written(folder, measured(ArmModel.load(NAME)))
        session = ArmSession(ArmModel.load(path), live.session.bus, time.monotonic)
        session.open()
        session.arm()
        assert session.state is SessionState.ARMED


def test_an_arm_that_cannot_be_measured_is_held_against_its_calibration_too(folder):
    name = "armpi-mini"
    arm = ArmModel.load(name)
    clock = [0.0]
    for shift in (5.0, 0.0):
        _, path = written(folder, measured(arm, shift), like=name)
        link = DryLink(lambda: clock[0], lambda s: None, Setup("rrc", "armpi-mini").firmware())
        session = ArmSession(ArmModel.load(path), link, lambda: clock[0])
        session.open()
        if not shift:
            session.arm(arm.home_rad)
            assert session.state is SessionState.ARMED
            continue
        with pytest.raises(HandshakeFailed, match="has zero_ticks"):
            session.arm(arm.home_rad)
        assert link.frames == []


def test_the_policy_of_the_arms_file_is_used_unless_another_is_given(folder):
    path = folder / "strict.toml"
    path.write_text('like = "so-101"\n[policy]\nmin_v = 9.0\nestop = "torque-off"\n')
    arm = ArmModel.load(path)
    assert (arm.policy.min_v, arm.policy.estop, arm.policy.max_c) == (9.0, "torque-off", 65.0)
    with LiveArm("sts") as live:
        ready = ReadyArm(arm, "", time.monotonic, link=live.link, is_supervised=False)
        assert ready.session.policy is arm.policy
        other = ArmModel.load("armpi").policy
        assert ArmSession(arm, live.link, time.monotonic, policy=other).policy is other
        live.session = ArmSession(arm, live.session.bus, time.monotonic)
        live.ready()
        assert live.tick_until(live.is_state(SessionState.FAULT))
        assert "at least 9.0 V are needed" in live.session.reason  # the simulated supply has 7.4 V


@pytest.mark.parametrize("name", known_arms())
def test_a_sound_supply_of_7_or_12_volts_is_no_trouble_to_a_shipped_arm(name):
    arm = ArmModel.load(name)
    watch = Watch(arm.policy, {1: "one"}, (1,))
    assert [watch.voltage(1, volts) for volts in (6.0, 7.4, 8.4, 12.0, 12.6)] == [None] * 5
    assert watch.voltage(1, 4.4).kind is Kind.BROWN_OUT


def test_a_12_volt_arm_can_be_told_of_a_supply_that_sags():
    watch = Watch(replace(ArmModel.load(NAME).policy, min_v=9.0), {1: "one"}, (1,))
    assert watch.voltage(1, 9.5) is None
    assert "at least 9.0 V" in watch.voltage(1, 8.5).text
