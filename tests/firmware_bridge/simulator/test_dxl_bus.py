import pytest

from firmware_bridge.codec import dxl2, dxl2_frame
from firmware_bridge.codec.dxl2 import Dxl2
from firmware_bridge.codec.protocol import Quantity, ServoFlag, ServoTarget
from firmware_bridge.simulator.dxl_bus import ACCESS, DATA_LIMIT, DATA_RANGE, FAILED, DxlBus
from firmware_bridge.simulator.physics import PHYSICS
from firmware_bridge.simulator.servo import SimServo

SPEAKS = Dxl2()


@pytest.fixture
def bus():
    return DxlBus([SimServo(one, 2048, (0, 4095), 3000.0) for one in range(1, 5)])


def send(bus, *messages):
    """Send messages and return the statuses that came back within 20 ms."""
    for message in messages:
        bus.feed(message if isinstance(message, bytes) else dxl2.encode(message))
    bus.step(0.02)
    parser = dxl2.host_parser()
    return [dxl2.decode_from_servo(frame) for frame in parser.feed(bus.replies())]


def ask(bus, quantity, *servo_ids):
    (query,) = SPEAKS.query(quantity, servo_ids)
    bus.feed(query.frame)
    bus.step(0.02)
    parser = SPEAKS.parser()
    replies = [SPEAKS.match(query, frame) for frame in parser.feed(bus.replies())]
    return {reply.servo_id: reply.values for (reply,) in replies}


def u32(value):
    return value.to_bytes(4, "little")


def test_a_ping_tells_model_and_firmware_and_one_to_all_is_answered_in_turn(bus):
    identity = (1060).to_bytes(2, "little") + b"\x2d"
    assert send(bus, dxl2.Ping(2)) == [dxl2.Status(2, 0, identity)]
    answers = send(bus, dxl2.Ping(0xFE))
    assert answers == [dxl2.Status(one, 0, identity) for one in range(1, 5)]


def test_a_move_arrives_with_the_speed_it_names(bus):
    send(bus, *SPEAKS.move([ServoTarget(1, 3048, 1000), ServoTarget(2, 2548, 500)], 1000))
    bus.step(0.48)
    half = ask(bus, Quantity.POSITION, 1, 2)
    assert half[1][0] == pytest.approx(2548, abs=60)
    assert half[2][0] == pytest.approx(2298, abs=60)
    bus.step(0.7)
    assert ask(bus, Quantity.POSITION, 1, 2, 3) == {1: (3048,), 2: (2548,), 3: (2048,)}


def test_a_time_based_profile_takes_the_register_as_milliseconds(bus):
    bus.member(1).set("drive_mode", 4)
    send(bus, dxl2.Write(1, 112, u32(1000) + u32(3048)))
    bus.step(0.48)
    assert ask(bus, Quantity.POSITION, 1)[1][0] == pytest.approx(2548, abs=60)


@pytest.mark.parametrize(
    ("message", "error"),
    [
        (dxl2.Write(1, 116, u32(2048)), 0),
        (dxl2.Write(1, 116, u32(4096)), DATA_LIMIT),
        (dxl2.Write(1, 64, b"\x02"), DATA_RANGE),
        (dxl2.Write(1, 132, u32(0)), ACCESS),
        (dxl2.Write(1, 7, b"\x09"), ACCESS),  # the EEPROM is shut while the torque is on
    ],
)
def test_a_write_that_a_servo_does_not_take_comes_back_with_its_error(bus, message, error):
    assert send(bus, message) == [dxl2.Status(1, error)]
    assert (bus.commanded == {1: 2048}) == (error == 0)


def test_the_eeprom_is_open_while_the_torque_is_off_and_outlives_a_reboot(bus):
    send(bus, *SPEAKS.set_limits(1, 1500, 2500))
    assert ask(bus, Quantity.LIMITS, 1) == {1: (0, 4095)}
    send(bus, *SPEAKS.torque([1], False), *SPEAKS.set_limits(1, 1500, 2500))
    send(bus, dxl2.Reboot(1))
    bus.step(1.0)
    assert ask(bus, Quantity.LIMITS, 1, 2) == {1: (1500, 2500), 2: (0, 4095)}
    send(bus, *SPEAKS.torque([1], True), *SPEAKS.move([ServoTarget(1, 4000)], 0))
    bus.step(1.0)
    assert ask(bus, Quantity.POSITION, 1) == {1: (2048,)}  # refused, not cut


def test_ram_is_lost_by_a_reboot(bus):
    send(bus, *SPEAKS.move([ServoTarget(1, 2100, 700)], 0))
    bus.step(1.0)
    send(bus, dxl2.Reboot(1))
    bus.step(1.0)
    assert bus.member(1).get("profile_velocity") == 0
    assert ask(bus, Quantity.TORQUE, 1) == {1: (0,)}
    assert ask(bus, Quantity.TARGET, 1) == {1: (2100,)}


@pytest.mark.parametrize(("level", "n_answers"), [(0, 1), (1, 2), (2, 3)])
def test_the_status_level_says_what_is_answered(bus, level, n_answers):
    bus.member(1).set("status_level", level)
    messages = dxl2.Ping(1), dxl2.Read(1, 132, 4), dxl2.Write(1, 65, b"\x01")
    assert len(send(bus, *messages)) == n_answers


def test_overheating_switches_off_until_a_reboot_and_alerts_in_every_answer(bus):
    servo = bus.member(1).servo
    servo.temperature_c = 80.0
    bus.step(0.01)
    assert send(bus, dxl2.Write(1, 65, b"\x01")) == [dxl2.Status(1, dxl2.ALERT)]
    servo.temperature_c = 30.0
    bus.step(0.01)
    assert ask(bus, Quantity.FLAGS, 1) == {1: (int(ServoFlag.OVERHEAT),)}
    assert send(bus, dxl2.Write(1, 64, b"\x01")) == [dxl2.Status(1, dxl2.ALERT | FAILED)]
    send(bus, dxl2.Reboot(1))
    bus.step(1.0)
    assert send(bus, dxl2.Write(1, 64, b"\x01")) == [dxl2.Status(1, 0)]


def test_a_stalled_servo_goes_limp_by_itself():
    servo = SimServo(1, 2048, (0, 4095), 3000.0, physics=PHYSICS["dxl2"])
    servo.supply_mv = 12000.0
    bus = DxlBus([servo])
    servo.block_ticks = (1900.0, 2200.0)
    send(bus, *SPEAKS.move([ServoTarget(1, 4000)], 0))
    for _ in range(200):
        bus.step(0.01)
    assert not servo.is_torque_on
    assert ask(bus, Quantity.FLAGS, 1) == {1: (int(ServoFlag.STALL),)}
    assert ask(bus, Quantity.TORQUE, 1) == {1: (0,)}


def test_a_prepared_write_waits_for_the_action(bus):
    assert send(bus, dxl2.RegWrite(1, 116, u32(1000))) == [dxl2.Status(1, 0)]
    assert bus.commanded == {}
    send(bus, dxl2.Action())
    assert bus.commanded == {1: 1000}


def test_an_offset_shifts_what_is_told_and_what_is_commanded(bus):
    send(bus, *SPEAKS.torque([1], False), dxl2.Write(1, 20, u32(100)), *SPEAKS.torque([1], True))
    send(bus, *SPEAKS.move([ServoTarget(1, 2200)], 0))
    bus.step(1.0)
    assert bus.member(1).servo.measured == 2100
    assert ask(bus, Quantity.POSITION, 1) == {1: (2200,)}


def test_a_frame_that_was_not_stuffed_is_not_obeyed(bus):
    body = bytes((dxl2_frame.WRITE, 0x70, 0x00)) + b"\xff\xff\xfd\x00"
    frame = dxl2_frame.HEADER + b"\x01" + (len(body) + 2).to_bytes(2, "little") + body
    frame += dxl2_frame.crc16(frame).to_bytes(2, "little")
    assert send(bus, frame) == []
    assert bus.n_rejected == 1
    assert bus.member(1).get("profile_velocity") == 0
    send(bus, dxl2.Write(1, 112, b"\xff\xff\xfd\x00"))
    assert bus.member(1).get("profile_velocity") == 0xFDFFFF


def test_an_answer_that_needs_stuffing_is_stuffed(bus):
    bus.member(1).set("profile_velocity", 0xFDFFFF)
    assert send(bus, dxl2.Read(1, 112, 4)) == [dxl2.Status(1, 0, b"\xff\xff\xfd\x00")]


def test_servos_wait_their_return_delay(bus):
    bus.feed(dxl2.encode(dxl2.Ping(1)))
    bus.step(0.0004)
    assert bus.replies() == b""
    bus.step(0.0002)
    assert len(bus.replies()) == 14
