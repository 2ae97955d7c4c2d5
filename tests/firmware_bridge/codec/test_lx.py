import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import lx
from firmware_bridge.codec.lx import Lx16a, Message
from firmware_bridge.codec.protocol import Quantity, Reply, ServoTarget
from firmware_bridge.errors import ProtocolError
from offline_train.benchmarks.firmware import kit_lx16a, peers

SPEECH = Lx16a()
CASES = [pytest.param(case, id=case.what) for case in kit_lx16a.vectors()]


def values_of(layout):
    return st.tuples(*[st.integers(field.low, field.high) for field in layout.fields])


def messages(table, max_id):
    """Draw any message of a table; pairs of limits are put in order."""

    def ordered(message):
        values = message.values
        if message.command in lx._PAIRS and len(values) == 2:
            low, high = sorted(values)
            top = table[message.command].fields[0].high
            low, high = (low, high) if low < high else (top - 1, top)
            return message._replace(values=(low, high))
        return message

    def of(number):
        return st.builds(Message, st.integers(0, max_id), st.just(number), values_of(table[number]))

    return st.sampled_from(sorted(table)).flatmap(of).map(ordered)


commands = messages(lx.COMMANDS, lx.BROADCAST)
replies = messages(lx.REPLIES, lx.MAX_ID)


@pytest.mark.parametrize("case", CASES)
def test_frame_is_the_published_one(case):
    assert case.ours == case.expected


def test_the_peer_says_the_same_for_random_commands():
    import random

    if peers.load("lewansoul-lx16a", "lewansoul_lx16a") is None:
        pytest.skip("lewansoul-lx16a is not installed; scripts/setup_peers.py does that")
    rng = random.Random(3)
    for _ in range(500):
        ours, theirs = kit_lx16a.random_command(rng)
        assert ours == theirs


@given(commands)
def test_any_command_comes_back_as_it_was_sent(message):
    (frame,) = lx.device_parser().feed(lx.encode_command(message))
    assert lx.decode_command(frame) == message


@given(replies)
def test_any_reply_comes_back_as_it_was_sent(message):
    (frame,) = lx.host_parser().feed(lx.encode_reply(message))
    assert lx.decode_reply(frame) == message


@pytest.mark.parametrize(
    "message",
    [
        Message(255, lx.MOVE_STOP),
        Message(-1, lx.MOVE_STOP),
        Message(1, 99),
        Message(1, lx.MOVE_TIME_WRITE, (1001, 0)),
        Message(1, lx.MOVE_TIME_WRITE, (-1, 0)),
        Message(1, lx.MOVE_TIME_WRITE, (500, 30001)),
        Message(1, lx.MOVE_TIME_WRITE, (500.0, 100)),
        Message(1, lx.MOVE_TIME_WRITE, (500,)),
        Message(1, lx.MOVE_STOP, (1,)),
        Message(1, lx.ANGLE_LIMIT_WRITE, (500, 500)),
        Message(1, lx.VIN_LIMIT_WRITE, (4000, 9000)),
        Message(1, lx.TEMP_MAX_WRITE, (101,)),
        Message(1, lx.OFFSET_ADJUST, (126,)),
        Message(1, lx.ID_WRITE, (254,)),
        Message(1, lx.TORQUE_WRITE, (True,)),
    ],
)
def test_a_value_no_servo_takes_is_not_encoded(message):
    with pytest.raises(ProtocolError):
        lx.encode_command(message)


def test_a_servo_never_answers_as_all():
    with pytest.raises(ProtocolError):
        lx.encode_reply(Message(lx.BROADCAST, lx.POS_READ, (1,)))


@pytest.mark.parametrize(
    "frame",
    [
        b"",
        lx.frame_bytes(1, lx.POS_READ, b"\x01"),  # too short for the command
        lx.frame_bytes(1, lx.POS_READ, b"\x01\x02\x03"),
        lx.frame_bytes(1, lx.MOVE_TIME_WRITE, b"\x01\x02"),  # no reply
        lx.frame_bytes(1, lx.POS_READ, b"\x10\x27"),  # 10000
        lx.frame_bytes(1, lx.TORQUE_READ, b"\x02"),
        lx.frame_bytes(1, lx.ANGLE_LIMIT_READ, b"\x05\x00\x04\x00"),
        lx.frame_bytes(254, lx.ID_READ, b"\x01"),
    ],
)
def test_a_reply_that_does_not_fit_is_refused(frame):
    with pytest.raises(ProtocolError):
        lx.decode_reply(frame)


@given(st.binary(max_size=12))
def test_no_bytes_make_a_decoder_fail_in_any_other_way(data):
    for decode in (lx.decode_command, lx.decode_reply):
        try:
            decode(data)
        except ProtocolError as error:
            assert str(error)


def test_a_host_does_not_hear_its_own_echo():
    parser = lx.host_parser()
    echo = lx.encode_command(Message(1, lx.MOVE_TIME_WRITE, (500, 1000)))
    echo += lx.encode_command(Message(1, lx.POS_READ))
    answer = lx.encode_reply(Message(1, lx.POS_READ, (500,)))
    assert parser.feed(echo + answer) == [answer]


def test_a_move_is_one_frame_per_servo_and_stop_is_one_for_all():
    frames = SPEECH.move([ServoTarget(1, 500), ServoTarget(6, 1000)], 1000)
    assert [frame[2] for frame in frames] == [1, 6]
    assert SPEECH.stop([ServoTarget(1, 500)]) == (bytes.fromhex("5555FE030CF2"),)
    assert SPEECH.torque((), False) == (lx.encode_command(Message(254, lx.TORQUE_WRITE, (0,))),)


def test_a_move_to_all_at_once_is_refused():
    with pytest.raises(ProtocolError):
        SPEECH.move([ServoTarget(lx.BROADCAST, 500)], 100)


@pytest.mark.parametrize("quantity", sorted(SPEECH.quantities, key=lambda one: one.value))
def test_every_question_is_answered_by_its_own_reply_alone(quantity):
    first, second = SPEECH.query(quantity, (1, 2))
    command = first.frame[4]
    values = tuple(field.low for field in lx.REPLIES[command].fields)
    values = (1,) if command == lx.ID_READ else (0, 9) if values == (0, 0) else values
    frame = lx.encode_reply(Message(1, command, values))
    assert len(frame) == first.n_reply
    (reply,) = SPEECH.match(first, frame)
    expected = {Quantity.MODEL: (0,), Quantity.TARGET: values[:1]}.get(quantity, values)
    assert reply == Reply(1, expected)
    assert SPEECH.match(second, frame) == ()
    for other in SPEECH.quantities - {quantity}:
        assert SPEECH.match(SPEECH.query(other, (1,))[0], frame) == ()


def test_what_servos_do_not_tell_is_refused():
    for quantity in set(Quantity) - SPEECH.quantities:
        with pytest.raises(ProtocolError):
            SPEECH.query(quantity, (1,))
