import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import protocol, rrc
from firmware_bridge.codec.protocol import Quantity, Reply, ServoTarget
from firmware_bridge.codec.rrc_protocol import RrcBus, RrcPwm
from firmware_bridge.errors import ProtocolError
from offline_train.benchmarks.firmware import kit_rrc, peers

PWM, BUS = RrcPwm(), RrcBus()
CASES = [pytest.param(case, id=case.what) for case in kit_rrc.vectors()]


@pytest.mark.parametrize("case", CASES)
def test_frame_is_the_vendors(case):
    assert case.ours == case.expected


def test_crcmod_agrees_about_random_commands():
    if peers.load("crcmod", "crcmod") is None:
        pytest.skip("crcmod is not installed; scripts/setup_peers.py does that")
    rng = random.Random(3)
    for _ in range(300):
        ours, theirs = kit_rrc.random_command(rng)
        assert ours == theirs


@given(st.integers(0, 10**9))
def test_any_message_comes_back_as_it_was_sent(seed):
    assert kit_rrc.round_trip(random.Random(seed))


def test_both_dialects_are_found_by_name():
    assert isinstance(protocol("rrc"), RrcPwm)
    assert isinstance(protocol("rrc-bus"), RrcBus)


def test_pwm_targets_are_what_was_commanded_and_nothing_is_measured():
    (query,) = PWM.query(Quantity.TARGET, (3,))
    frame = rrc.encode(rrc.PwmPosition(3, 1700))
    assert len(frame) == query.n_reply
    assert PWM.match(query, frame) == (Reply(3, (1700,)),)
    assert PWM.match(query, rrc.encode(rrc.PwmPosition(4, 1700))) == ()
    assert PWM.match(query, rrc.encode(rrc.PwmOffsetReply(3, 5))) == ()
    assert not PWM.has_feedback
    with pytest.raises(ProtocolError):
        PWM.query(Quantity.POSITION, (3,))


def test_the_pushed_battery_is_reported_and_answers_nothing():
    frame = rrc.encode(rrc.Battery(7400))
    for speech in (PWM, BUS):
        assert speech.report(frame) == ((Quantity.VOLTAGE, Reply(0, (7400,))),)
        assert speech.report(rrc.encode(rrc.PwmPosition(1, 1500))) == ()
        for quantity in speech.quantities:
            assert speech.match(speech.query(quantity, (1,))[0], frame) == ()


@pytest.mark.parametrize("quantity", sorted(BUS.quantities, key=lambda one: one.value))
def test_bus_questions_are_answered_by_their_own_reply_alone(quantity):
    (query,) = BUS.query(quantity, (5,))
    what = query.frame[4]
    values = {rrc.BUS_ID: (5,), rrc.BUS_LIMITS: (10, 900)}.get(what, (1,))
    frame = rrc.encode(rrc.BusReply(5, what, True, values))
    assert len(frame) == query.n_reply
    expected = (0,) if quantity is Quantity.MODEL else values
    assert BUS.match(query, frame) == (Reply(5, expected),)
    assert BUS.match(query, rrc.encode(rrc.BusReply(6, what, True, values))) == ()
    failed = rrc.encode(rrc.BusReply(5, what, False, values))
    assert [reply.is_ok for reply in BUS.match(query, failed)] == [False]
    for other in BUS.quantities - {quantity}:
        assert BUS.match(BUS.query(other, (5,))[0], frame) == ()


def test_a_measured_position_out_of_this_world_is_no_answer():
    (query,) = BUS.query(Quantity.POSITION, (5,))
    far = rrc.encode(rrc.BusReply(5, rrc.BUS_POSITION, True, (9000,)))
    assert BUS.match(query, far) == ()


def test_torque_is_off_by_0x0b_and_on_by_0x0c():
    assert BUS.torque((1,), False) == (bytes.fromhex("AA5505020B01B3"),)
    assert BUS.torque((1,), True) == (bytes.fromhex("AA5505020C01DD"),)
    assert PWM.torque((1,), False) == ()


def test_stop_of_pwm_holds_a_pulse_within_range_and_of_bus_servos_stops_them():
    (frame,) = PWM.stop([ServoTarget(1, 2600)])
    assert rrc.decode_to_board(frame) == rrc.PwmMove(20, ((1, 2500),))
    (frame,) = BUS.stop([ServoTarget(1, 0), ServoTarget(2, 0)])
    assert frame == bytes.fromhex("AA550504030201024B")
    assert BUS.stop([]) == PWM.stop([]) == ()


@pytest.mark.parametrize(("speech", "ticks"), [(PWM, 499), (PWM, 2501), (BUS, -1), (BUS, 1001)])
def test_a_position_out_of_range_is_refused(speech, ticks):
    with pytest.raises(ProtocolError):
        speech.move([ServoTarget(1, ticks)], 100)
