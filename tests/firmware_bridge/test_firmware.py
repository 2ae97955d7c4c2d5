import numpy as np
import pytest

from firmware_bridge.codec import rrc, rrc_frames
from firmware_bridge.simulator import PtyBoard, RrcFirmware


@pytest.fixture
def firmware(arm):
    return RrcFirmware(arm)


def move_bytes(arm, q, duration_ms):
    pulses = arm.ticks(q)
    return rrc.encode(
        rrc.PwmMove(duration_ms, tuple((i, int(p)) for i, p in zip(arm.servo_ids, pulses)))
    )


def run(firmware, seconds, dt_s=0.01):
    poses = []
    for _ in range(int(round(seconds / dt_s))):
        firmware.step(dt_s)
        poses.append(firmware.joints_rad)
    return np.array(poses)


def test_servos_stand_still_without_bytes(arm, firmware):
    before = firmware.joints_rad
    poses = run(firmware, 3.0)
    assert np.array_equal(poses[-1], before)
    assert np.abs(before - arm.home_rad).max() < 0.001


def test_a_move_arrives_when_it_was_told_to_and_not_earlier(arm, firmware):
    goal = arm.home_rad + [0.6, -0.4, 0.2, 0.3]
    firmware.feed(move_bytes(arm, goal, 500))
    poses = run(firmware, 0.7)
    gap = np.abs(poses - goal).max(axis=1)
    assert gap[48] > 0.01  # at 0.49 s the servo lags behind the command
    assert gap[24] > 0.25  # half way at half time
    assert gap[-1] < 0.0015


def test_no_servo_is_faster_than_its_rate(arm, firmware):
    firmware.feed(move_bytes(arm, arm.home_rad + [1.5, -1.5, 0.0, 0.0], 0))
    poses = run(firmware, 1.0)
    speed = np.abs(np.diff(poses, axis=0)) / 0.01
    assert speed.max() <= 3.0 * (1 + 1e-9)
    assert speed.max() > 2.9


def test_the_step_of_simulation_does_not_change_the_motion(arm):
    ends = []
    for dt_s in (0.005, 0.01, 0.05):
        firmware = RrcFirmware(arm)
        firmware.feed(move_bytes(arm, arm.home_rad + [0.5, -0.5, 0.0, 0.0], 400))
        ends.append(run(firmware, 0.3, dt_s)[-1])
    assert np.allclose(ends, ends[0], atol=1e-9)


def test_a_new_move_starts_from_where_the_old_one_is(arm, firmware):
    firmware.feed(move_bytes(arm, arm.home_rad + [0.8, 0, 0, 0], 800))
    run(firmware, 0.4)
    firmware.feed(move_bytes(arm, arm.home_rad, 400))
    poses = run(firmware, 0.6)
    assert poses[:, 0].max() < 0.45
    assert abs(poses[-1, 0]) < 0.0015


def test_frames_in_any_chunks_mean_the_same(arm, firmware):
    data = move_bytes(arm, arm.home_rad + [0.5, 0, 0, 0], 100)
    for byte in data:
        firmware.feed(bytes((byte,)))
    assert abs(run(firmware, 0.4)[-1, 0] - 0.5) < 0.0015


def test_a_damaged_frame_moves_nothing_and_is_counted(arm, firmware):
    data = bytearray(move_bytes(arm, arm.home_rad + [0.5, 0, 0, 0], 100))
    data[8] ^= 0x04
    firmware.feed(bytes(data))
    assert np.abs(run(firmware, 0.5)[-1] - arm.home_rad).max() < 0.001
    assert firmware.n_bad_crc == 1
    assert firmware.n_frames == 0


def test_servos_it_does_not_have_and_commands_it_does_not_know_are_counted(firmware):
    firmware.feed(rrc.encode(rrc.PwmMove(100, ((77, 1500),))))
    firmware.feed(rrc_frames.frame_bytes(rrc_frames.RGB, b"abc"))
    assert firmware.n_rejected == 2


def test_a_pulse_out_of_range_is_kept_within_what_servos_take(arm, firmware):
    firmware.feed(
        rrc_frames.frame_bytes(rrc_frames.PWM_SERVO, bytes.fromhex("01 64 00 01 06 B8 0B"))
    )  # 3000 us
    run(firmware, 1.5)
    assert firmware.n_clamped == 1
    assert firmware.joints_rad[0] == pytest.approx(np.pi / 2, abs=0.001)


def test_a_position_request_is_answered_with_the_last_command(arm, firmware):
    firmware.feed(move_bytes(arm, arm.home_rad + [0.5, 0, 0, 0], 5000))
    run(firmware, 0.1)
    firmware.feed(rrc.encode(rrc.PwmPositionRequest(6)))
    expected = rrc.PwmPosition(6, int(arm.ticks(arm.home_rad + [0.5, 0, 0, 0])[0]))
    assert firmware.replies() == rrc.encode(expected)
    assert firmware.replies() == b""


def test_the_battery_is_reported_once_a_second(firmware):
    run(firmware, 3.505)
    assert firmware.replies() == rrc.encode(rrc.Battery(7400)) * 3


def test_the_gripper_moves_by_its_own_servo(arm, firmware):
    firmware.feed(rrc.encode(rrc.PwmMoveOne(100, arm.gripper.servo_id, arm.gripper.open_ticks)))
    run(firmware, 0.5)
    assert firmware.gripper_us == pytest.approx(arm.gripper.open_ticks, abs=1.0)


def test_an_unplugged_board_pumps_nothing_and_closes_twice(firmware):
    board = PtyBoard(firmware)
    board.close()
    board.close()
    assert board.pump() == 0
    assert not board.is_open
