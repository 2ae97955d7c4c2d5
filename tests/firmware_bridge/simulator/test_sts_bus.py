import pytest

from firmware_bridge.codec import sts
from firmware_bridge.codec.protocol import Quantity, ServoFlag, ServoTarget
from firmware_bridge.codec.sts import Sts
from firmware_bridge.simulator.physics import PHYSICS
from firmware_bridge.simulator.servo import SimServo
from firmware_bridge.simulator.sts_bus import StsBus

SPEAKS = Sts()


@pytest.fixture
def bus():
    return StsBus([SimServo(one, 2048, (0, 4095), 3000.0) for one in range(1, 5)])


def send(bus, *messages):
    """Send messages and return the statuses that came back within 10 ms."""
    for message in messages:
        bus.feed(message if isinstance(message, bytes) else sts.encode(message))
    bus.step(0.01)
    parser = sts.host_parser()
    return [sts.decode_from_servo(frame) for frame in parser.feed(bus.replies())]


def ask(bus, quantity, *servo_ids):
    (query,) = SPEAKS.query(quantity, servo_ids)
    bus.feed(query.frame)
    bus.step(0.01)
    parser = SPEAKS.parser()
    replies = [SPEAKS.match(query, frame) for frame in parser.feed(bus.replies())]
    return {reply.servo_id: reply.values for (reply,) in replies}


def reset(bus, servo_id):
    bus.member(servo_id).servo.reset()
    bus.step(1.0)


def test_a_ping_is_answered_by_that_servo_alone(bus):
    assert send(bus, sts.Ping(2)) == [sts.Status(2, 0)]
    assert send(bus, sts.Ping(9)) == []


def test_a_move_goes_at_the_speed_it_names(bus):
    for frame in SPEAKS.move([ServoTarget(1, 3048, 1000), ServoTarget(2, 2548, 500)], 1000):
        bus.feed(frame)
    bus.step(0.5)
    half = ask(bus, Quantity.POSITION, 1, 2)
    assert half[1][0] == pytest.approx(2548, abs=40)
    assert half[2][0] == pytest.approx(2298, abs=40)
    bus.step(0.7)
    assert ask(bus, Quantity.POSITION, 1, 2, 3) == {1: (3048,), 2: (2548,), 3: (2048,)}
    assert ask(bus, Quantity.TARGET, 1, 2) == {1: (3048,), 2: (2548,)}


def test_a_stop_holds_a_servo_where_it_stands(bus):
    for frame in SPEAKS.move([ServoTarget(1, 4000, 1000)], 2000):
        bus.feed(frame)
    bus.step(0.5)
    ((at,),) = ask(bus, Quantity.POSITION, 1).values()
    for frame in SPEAKS.stop([ServoTarget(1, at)]):
        bus.feed(frame)
    bus.step(1.0)
    assert ask(bus, Quantity.POSITION, 1) == {1: (at,)}


def test_servos_answer_a_sync_read_in_the_order_asked(bus):
    answers = send(bus, sts.SyncRead(3, 2, (3, 1, 2)))
    assert [answer.servo_id for answer in answers] == [3, 1, 2]
    assert {answer.data for answer in answers} == {(777).to_bytes(2, "little")}


def test_writes_to_one_are_answered_and_broadcasts_are_not(bus):
    assert send(bus, sts.Write(1, 42, b"\x00\x08")) == [sts.Status(1, 0)]
    assert send(bus, sts.Write(0xFE, 42, b"\x00\x08")) == []
    assert send(bus, sts.SyncWrite(42, ((1, b"\x00\x08"), (2, b"\x00\x08")))) == []
    assert send(bus, sts.Action()) == []
    assert send(bus, sts.Read(0xFD, 42, 2)) == []


def test_at_status_level_0_only_pings_and_reads_are_answered(bus):
    bus.member(1).set("status_level", 0)
    assert send(bus, sts.Write(1, 42, b"\x00\x08")) == []
    assert len(send(bus, sts.Ping(1), sts.Read(1, 42, 2))) == 2


def test_a_prepared_write_waits_for_the_action(bus):
    send(bus, sts.RegWrite(1, 42, (1000).to_bytes(2, "little")))
    bus.step(1.0)
    assert ask(bus, Quantity.POSITION, 1) == {1: (2048,)}
    send(bus, sts.Action())
    bus.step(1.0)
    assert ask(bus, Quantity.POSITION, 1) == {1: (1000,)}
    assert bus.commanded == {1: 1000}


def test_limits_hold_in_the_servo_and_outlive_a_reset(bus):
    send(bus, *SPEAKS.set_limits(1, 1500, 2500))
    reset(bus, 1)
    send(bus, *SPEAKS.torque([1], True))
    send(bus, *SPEAKS.move([ServoTarget(1, 4000), ServoTarget(2, 4000)], 0))
    bus.step(2.0)
    assert ask(bus, Quantity.LIMITS, 1, 2) == {1: (1500, 2500), 2: (0, 4095)}
    assert ask(bus, Quantity.POSITION, 1, 2) == {1: (2500,), 2: (4000,)}


def test_what_is_written_while_the_eeprom_is_locked_is_lost_by_a_reset(bus):
    send(bus, sts.Write(1, 9, (1500).to_bytes(2, "little")))
    assert ask(bus, Quantity.LIMITS, 1) == {1: (1500, 4095)}
    reset(bus, 1)
    assert ask(bus, Quantity.LIMITS, 1) == {1: (0, 4095)}


def test_a_reset_loses_the_ram_and_the_servo_is_limp(bus):
    send(bus, *SPEAKS.move([ServoTarget(1, 2148, 700)], 0))
    bus.step(1.0)
    reset(bus, 1)
    assert ask(bus, Quantity.TORQUE, 1, 2) == {1: (0,), 2: (1,)}
    assert bus.member(1).get("goal_speed") == 0
    assert ask(bus, Quantity.TARGET, 1) == {1: (2148,)}  # where it stood


def test_a_changed_id_answers_under_the_old_one_once_and_then_under_the_new(bus):
    assert send(bus, sts.Write(1, 55, b"\x00"), sts.Write(1, 5, b"\x09")) == [sts.Status(1, 0)] * 2
    assert send(bus, sts.Ping(1), sts.Ping(9)) == [sts.Status(9, 0)]
    reset(bus, 9)
    assert send(bus, sts.Ping(9)) == [sts.Status(9, 0)]


def test_a_servo_at_another_baud_is_silent_until_the_line_follows(bus):
    send(bus, sts.Write(1, 6, b"\x04"))
    assert send(bus, sts.Ping(1)) == []
    assert bus.listen(115_200)
    assert send(bus, sts.Ping(1), sts.Ping(2)) == [sts.Status(1, 0)]


def test_a_return_delay_passes_before_the_answer(bus):
    bus.member(1).set("return_delay", 250)
    bus.feed(sts.encode(sts.Ping(1)))
    bus.step(0.0004)
    assert bus.replies() == b""
    bus.step(0.0002)
    assert bus.replies() == sts.encode(sts.Status(1, 0))


@pytest.mark.parametrize(
    ("change", "flag"),
    [
        ({"temperature_c": 75.0}, ServoFlag.OVERHEAT),
        ({"supply_mv": 3000.0}, ServoFlag.VOLTAGE),
        ({"supply_mv": 15000.0}, ServoFlag.VOLTAGE),
        ({"load_permille": 900.0}, ServoFlag.STALL),
    ],
)
def test_what_is_wrong_with_a_servo_is_in_its_answers_and_its_status(bus, change, flag):
    for name, value in change.items():
        setattr(bus.member(2).servo, name, value)
    bus.step(0.001)
    (query,) = SPEAKS.query(Quantity.FLAGS, [2])
    bus.feed(query.frame)
    (reply,) = SPEAKS.match(query, bus.replies())
    assert reply.values == (int(flag),)
    assert reply.flags == flag
    assert send(bus, sts.Ping(1)) == [sts.Status(1, 0)]


def test_a_current_above_protection_is_reported():
    servo = SimServo(1, 2048, (0, 4095), 3000.0, physics=PHYSICS["sts"])
    bus = StsBus([servo])
    bus.member(1).set("protection_current", 100)  # 650 mA
    servo.load_permille = 500.0
    assert send(bus, sts.Ping(1)) == [sts.Status(1, 8)]


def test_an_overheated_servo_goes_limp_and_says_so(bus):
    bus.member(1).servo.temperature_c = 90.0
    bus.step(0.01)
    assert ask(bus, Quantity.TORQUE, 1) == {1: (0,)}
    assert ask(bus, Quantity.TEMPERATURE, 1) == {1: (90,)}


def test_torque_off_lets_no_move_through_and_torque_on_obeys_the_last_goal(bus):
    send(bus, *SPEAKS.torque([1], False), *SPEAKS.move([ServoTarget(1, 2148)], 0))
    bus.step(1.0)
    assert ask(bus, Quantity.POSITION, 1) == {1: (2048,)}
    send(bus, *SPEAKS.torque([1], True))
    bus.step(1.0)
    assert ask(bus, Quantity.POSITION, 1) == {1: (2148,)}


def test_an_offset_shifts_what_is_told_and_what_is_commanded(bus):
    send(bus, sts.Write(1, 31, b"\x64\x08"))  # -100
    assert ask(bus, Quantity.OFFSET, 1) == {1: (-100,)}
    assert ask(bus, Quantity.POSITION, 1) == {1: (2148,)}
    send(bus, *SPEAKS.move([ServoTarget(1, 2200)], 0))
    bus.step(1.0)
    assert bus.member(1).servo.measured == 2100
    assert ask(bus, Quantity.POSITION, 1) == {1: (2200,)}


def test_torque_enable_128_makes_this_the_middle(bus):
    send(bus, *SPEAKS.move([ServoTarget(1, 1900)], 0))
    bus.step(1.0)
    send(bus, sts.Write(1, 40, b"\x80"))
    assert ask(bus, Quantity.POSITION, 1) == {1: (2048,)}


def test_read_only_registers_stay_as_they_are(bus):
    send(bus, sts.Write(1, 3, b"\x00\x00"), sts.Write(1, 56, b"\x00\x00"))
    assert ask(bus, Quantity.MODEL, 1) == {1: (777,)}
    assert ask(bus, Quantity.POSITION, 1) == {1: (2048,)}


def test_a_frame_that_breaks_off_is_given_up_when_the_line_is_silent(bus):
    whole = sts.encode(sts.SyncWrite(42, ((1, b"\x00\x04"), (2, b"\x00\x04"))))
    bus.feed(whole[:9])
    bus.step(0.01)
    assert send(bus, sts.Ping(1)) == [sts.Status(1, 0)]
    assert bus.commanded == {}


def test_a_dead_servo_is_silent_and_the_others_answer_on(bus):
    bus.member(2).servo.is_dead = True
    assert set(ask(bus, Quantity.POSITION, 1, 2, 3)) == {1, 3}


def test_a_frame_that_makes_no_sense_is_counted_and_ignored(bus):
    assert send(bus, sts.frame_bytes(1, sts.READ, b"\x46\x02")) == []
    assert bus.n_rejected == 1
