"""The simulated LX bus does what LX servos do, register by register."""

import pytest

from firmware_bridge.codec import lx
from firmware_bridge.codec.lx import Message
from firmware_bridge.simulator.lx_bus import LxBus
from firmware_bridge.simulator.physics import PHYSICS
from firmware_bridge.simulator.servo import SimServo


@pytest.fixture
def bus():
    return LxBus([SimServo(one, 500, (0, 1000), 2000.0) for one in (1, 2, 3)])


def tell(bus, servo_id, command, *values):
    bus.feed(lx.encode_command(Message(servo_id, command, values)))
    assert bus.replies() == b""  # writes are not acknowledged


def ask(bus, servo_id, command):
    bus.feed(lx.encode_command(Message(servo_id, command)))
    return [lx.decode_reply(frame) for frame in lx.host_parser().feed(bus.replies())]


def value(bus, servo_id, command):
    (message,) = ask(bus, servo_id, command)
    assert (message.servo_id, message.command) == (servo_id, command)
    return message.values


def run(bus, seconds):
    for _ in range(round(seconds / 0.01)):
        bus.step(0.01)


def test_a_move_arrives_in_its_time_and_moves_one_servo_alone(bus):
    tell(bus, 2, lx.MOVE_TIME_WRITE, 700, 400)
    run(bus, 0.2)
    assert 550 < value(bus, 2, lx.POS_READ)[0] < 620
    run(bus, 0.4)
    assert value(bus, 2, lx.POS_READ) == (700,)
    assert value(bus, 2, lx.MOVE_TIME_READ) == (700, 400)
    assert value(bus, 1, lx.POS_READ) == value(bus, 3, lx.POS_READ) == (500,)


def test_a_servo_keeps_within_its_own_limits(bus):
    tell(bus, 1, lx.ANGLE_LIMIT_WRITE, 200, 800)
    tell(bus, 1, lx.MOVE_TIME_WRITE, 1000, 0)
    run(bus, 1.0)
    assert value(bus, 1, lx.POS_READ) == (800,)
    assert bus.commanded == {1: 800}
    assert bus.n_clamped == 1


def test_a_position_beyond_the_range_is_kept_within_it(bus):
    bus.feed(lx.frame_bytes(1, lx.MOVE_TIME_WRITE, (1234).to_bytes(2, "little") + bytes(2)))
    assert bus.commanded == {1: 1000}
    assert bus.n_clamped == 1


@pytest.mark.parametrize(
    ("command", "content"),
    [
        (lx.ANGLE_LIMIT_WRITE, b"\x84\x03\x64\x00"),  # 900..100
        (lx.ANGLE_LIMIT_WRITE, b"\x64\x00\xd0\x07"),  # ..2000
        (lx.VIN_LIMIT_WRITE, b"\x00\x00\x00\x20"),
        (lx.TEMP_MAX_WRITE, b"\x65"),
        (lx.OFFSET_ADJUST, b"\x7f"),
        (lx.ID_WRITE, b"\xfe"),
        (lx.LED_ERROR_WRITE, b"\x08"),
        (lx.MODE_WRITE, b"\x02\x00\x00\x00"),
    ],
)
def test_settings_a_servo_does_not_take_are_counted_and_change_nothing(bus, command, content):
    reads = sorted(lx.REPLIES)
    before = [value(bus, 1, read) for read in reads]
    bus.feed(lx.frame_bytes(1, command, content))
    assert bus.n_rejected == 1
    assert [value(bus, 1, read) for read in reads] == before


def test_prepared_moves_start_together_and_not_before(bus):
    tell(bus, 1, lx.MOVE_TIME_WAIT_WRITE, 700, 100)
    tell(bus, 2, lx.MOVE_TIME_WAIT_WRITE, 300, 100)
    run(bus, 0.5)
    assert bus.commanded == {}
    assert value(bus, 1, lx.MOVE_TIME_WAIT_READ) == (700, 100)
    tell(bus, lx.BROADCAST, lx.MOVE_START)
    run(bus, 0.5)
    assert bus.commanded == {1: 700, 2: 300}
    assert value(bus, 3, lx.POS_READ) == (500,)


def test_stop_to_all_holds_every_servo_where_it_is(bus):
    for one in (1, 2, 3):
        tell(bus, one, lx.MOVE_TIME_WRITE, 900, 1000)
    run(bus, 0.3)
    tell(bus, lx.BROADCAST, lx.MOVE_STOP)
    stopped = [value(bus, one, lx.POS_READ)[0] for one in (1, 2, 3)]
    assert all(550 < place < 700 for place in stopped)
    run(bus, 1.0)
    assert [value(bus, one, lx.POS_READ)[0] for one in (1, 2, 3)] == stopped


def test_a_servo_can_be_given_another_id(bus):
    tell(bus, 1, lx.ID_WRITE, 7)
    assert ask(bus, 1, lx.POS_READ) == []
    assert value(bus, 7, lx.ID_READ) == (7,)


def test_only_the_question_for_the_id_is_answered_when_asked_of_all():
    alone = LxBus([SimServo(9, 500, (0, 1000), 2000.0)])
    assert ask(alone, lx.BROADCAST, lx.ID_READ) == [Message(9, lx.ID_READ, (9,))]
    assert ask(alone, lx.BROADCAST, lx.POS_READ) == []


def test_several_answers_to_the_id_question_spoil_each_other(bus):
    bus.feed(lx.encode_command(Message(lx.BROADCAST, lx.ID_READ)))
    data = bus.replies()
    assert len(data) == lx.REPLIES[lx.ID_READ].length + 3
    assert lx.host_parser().feed(data) == []


def test_the_offset_shifts_the_shaft_and_is_lost_without_saving(bus):
    tell(bus, 1, lx.OFFSET_ADJUST, -100)
    run(bus, 0.5)
    assert bus.servos[0].measured == 400
    assert value(bus, 1, lx.POS_READ) == (500,)
    assert value(bus, 1, lx.OFFSET_READ) == (-100,)
    bus.servos[0].reset(0.0)
    assert value(bus, 1, lx.OFFSET_READ) == (0,)
    assert value(bus, 1, lx.POS_READ) == (400,)


def test_what_is_saved_outlives_a_reset_and_the_rest_does_not(bus):
    tell(bus, 1, lx.ANGLE_LIMIT_WRITE, 100, 900)
    tell(bus, 1, lx.TEMP_MAX_WRITE, 70)
    tell(bus, 1, lx.OFFSET_ADJUST, 5)
    tell(bus, 1, lx.OFFSET_WRITE)
    tell(bus, 1, lx.MOVE_TIME_WAIT_WRITE, 700, 100)
    tell(bus, 1, lx.LED_WRITE, 1)
    bus.servos[0].reset(0.0)
    assert value(bus, 1, lx.ANGLE_LIMIT_READ) == (100, 900)
    assert value(bus, 1, lx.TEMP_MAX_READ) == (70,)
    assert value(bus, 1, lx.OFFSET_READ) == (5,)
    assert value(bus, 1, lx.MOVE_TIME_WAIT_READ) == (0, 0)
    assert value(bus, 1, lx.LED_READ) == (0,)


def test_torque_off_lets_go_and_torque_on_does_not_jump(bus):
    tell(bus, 1, lx.MOVE_TIME_WRITE, 900, 2000)
    run(bus, 0.5)
    tell(bus, 1, lx.TORQUE_WRITE, 0)
    run(bus, 0.2)
    let_go = value(bus, 1, lx.POS_READ)
    run(bus, 2.0)
    assert value(bus, 1, lx.POS_READ) == let_go
    assert value(bus, 1, lx.TORQUE_READ) == (0,)
    tell(bus, 1, lx.TORQUE_WRITE, 1)
    run(bus, 1.0)
    assert value(bus, 1, lx.POS_READ) == let_go
    assert value(bus, 1, lx.TORQUE_READ) == (1,)


def test_too_hot_a_servo_goes_limp_and_blinks_unless_told_not_to():
    bus = LxBus([SimServo(1, 500, (0, 1000), 2000.0, physics=PHYSICS["lx16a"])])
    member = bus.members[0]
    tell(bus, 1, lx.TEMP_MAX_WRITE, 60)
    bus.servos[0].temperature_c = 61.0
    run(bus, 0.1)
    assert value(bus, 1, lx.TORQUE_READ) == (0,)
    assert (member.errors, member.is_alarm_on) == (1, True)
    assert value(bus, 1, lx.LED_ERROR_READ) == (7,)  # which faults blink, not which there are
    tell(bus, 1, lx.LED_ERROR_WRITE, 6)
    assert not member.is_alarm_on


def test_a_supply_beyond_the_stored_limits_is_a_fault():
    bus = LxBus([SimServo(1, 500, (0, 1000), 2000.0, physics=PHYSICS["lx16a"])])
    tell(bus, 1, lx.VIN_LIMIT_WRITE, 7000, 8000)
    assert bus.members[0].errors == 0
    bus.servos[0].supply_mv = 6900.0
    assert bus.members[0].errors == 2
    assert value(bus, 1, lx.VIN_READ) == (6900,)


def test_in_motor_mode_positions_are_not_obeyed(bus):
    tell(bus, 1, lx.MODE_WRITE, 1, 0, -300)
    tell(bus, 1, lx.MOVE_TIME_WRITE, 700, 0)
    assert value(bus, 1, lx.MODE_READ) == (1, 0, -300)
    assert bus.commanded == {}


def test_frames_with_a_wrong_checksum_or_another_id_are_ignored(bus):
    frame = bytearray(lx.encode_command(Message(1, lx.MOVE_TIME_WRITE, (700, 0))))
    frame[-1] ^= 1
    bus.feed(bytes(frame))
    tell(bus, 77, lx.MOVE_TIME_WRITE, 700, 0)
    assert bus.commanded == {}
    assert (bus.n_bad, bus.n_frames) == (1, 1)


def test_a_half_frame_is_forgotten_when_the_line_falls_silent(bus):
    frame = lx.encode_command(Message(1, lx.MOVE_TIME_WRITE, (700, 0)))
    bus.feed(frame[:4])
    run(bus, 0.05)
    bus.feed(frame[4:])
    assert bus.commanded == {}
    bus.feed(frame)
    assert bus.commanded == {1: 700}
