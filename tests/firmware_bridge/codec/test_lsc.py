import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import lsc
from firmware_bridge.codec.lsc import Lsc, LscPwm
from firmware_bridge.codec.protocol import Quantity, Reply, ServoTarget
from firmware_bridge.errors import ProtocolError
from offline_train.benchmarks.firmware import kit_lsc, peers

SPEECH = Lsc()
CASES = [pytest.param(case, id=case.what) for case in kit_lsc.vectors()]
seeds = st.integers(0, 10**9)


@pytest.mark.parametrize("case", CASES)
def test_frame_is_the_published_one(case):
    assert case.ours == case.expected


def test_the_peer_says_the_same_for_random_commands():
    if peers.load("xarm", "xarm") is None:
        pytest.skip("xarm is not installed; scripts/setup_peers.py does that")
    rng = random.Random(3)
    for _ in range(300):
        ours, theirs = kit_lsc.random_command(rng)
        assert ours == theirs


@given(seeds)
def test_any_message_comes_back_as_it_was_sent(seed):
    rng = random.Random(seed)
    sent, answer = kit_lsc.random_message(rng), kit_lsc.random_answer(rng)
    (frame,) = lsc.device_parser().feed(lsc.encode(sent))
    back = lsc.decode_to_board(frame)
    assert (back, type(back)) == (sent, type(sent))
    (frame,) = lsc.host_parser().feed(lsc.encode(answer))
    back = lsc.decode_from_board(frame)
    assert (back, type(back)) == (answer, type(answer))


@pytest.mark.parametrize(
    "message",
    [
        lsc.Move(30001, ((1, 500),)),
        lsc.Move(100, ()),
        lsc.Move(100, ((0, 500),)),
        lsc.Move(100, ((1, 2501),)),
        lsc.Move(100, ((1, 500), (1, 600))),
        lsc.Move(100, ((1, 500.0),)),
        lsc.Move(100, ((1, True),)),
        lsc.Move(100, tuple((i, 500) for i in range(1, 22))),
        lsc.Unload(()),
        lsc.Unload((254,)),
        lsc.PositionRequest((True,)),
        lsc.GroupRun(256, 1),
        lsc.GroupSpeed(1, 0),
        lsc.Battery(20001),
    ],
)
def test_a_value_no_board_takes_is_not_encoded(message):
    with pytest.raises(ProtocolError):
        lsc.encode(message)


@pytest.mark.parametrize(
    "text",
    [
        "55 55 08 03 01 E8 03 01 C5 09",  # 2501
        "55 55 08 03 01 31 75 01 F4 01",  # 30001 ms
        "55 55 08 03 02 E8 03 01 F4 01",  # says two servos
        "55 55 08 03 01 E8 03 00 F4 01",  # id 0
        "55 55 03 0F 00",
        "55 55 02 63",
    ],
)
def test_without_a_checksum_only_sensible_frames_count(text):
    data = bytes.fromhex(text)
    assert lsc.device_parser().feed(data + bytes(lsc.MAX_FRAME)) == []
    with pytest.raises(ProtocolError):
        lsc.decode_to_board(data)


@given(st.binary(max_size=70))
def test_no_bytes_make_a_decoder_fail_in_any_other_way(data):
    for decode in (lsc.decode_to_board, lsc.decode_from_board):
        for frame in (data, lsc.HEADER + bytes((len(data) + 1,)) + data):
            try:
                decode(frame)
            except ProtocolError as error:
                assert str(error)


@pytest.mark.parametrize("unasked", [lsc.GroupRun(1, 1), lsc.GroupStop(), lsc.GroupComplete(1, 1)])
def test_what_a_board_says_unasked_answers_nothing(unasked):
    frame = lsc.encode(unasked)
    assert lsc.host_parser().feed(frame) == [frame]
    for quantity in SPEECH.quantities:
        assert SPEECH.match(SPEECH.query(quantity, (1,))[0], frame) == ()
    assert SPEECH.report(frame) == ()


def test_positions_answer_only_who_was_asked():
    (query,) = SPEECH.query(Quantity.POSITION, (1, 2))
    frame = lsc.encode(lsc.Positions(((1, 500), (2, -3))))
    assert len(frame) == query.n_reply
    assert SPEECH.match(query, frame) == (Reply(1, (500,)), Reply(2, (-3,)))
    assert SPEECH.match(query, lsc.encode(lsc.Positions(((2, 500),)))) == (Reply(2, (500,)),)
    assert SPEECH.match(query, lsc.encode(lsc.Positions(((3, 500),)))) == ()
    assert SPEECH.match(query, lsc.encode(lsc.Battery(7400))) == ()


def test_the_board_answers_for_its_supply():
    (query,) = SPEECH.query(Quantity.VOLTAGE, ())
    assert SPEECH.match(query, lsc.encode(lsc.Battery(7400))) == (Reply(0, (7400,)),)
    assert SPEECH.match(query, lsc.encode(lsc.Positions(((1, 500),)))) == ()


def test_stop_ends_groups_and_holds_every_servo_where_it_stands():
    frames = SPEECH.stop([ServoTarget(1, 480), ServoTarget(2, 1020)])
    decoded = [lsc.decode_to_board(frame) for frame in frames]
    assert decoded == [lsc.GroupStop(), lsc.Move(0, ((1, 480), (2, 1000)))]


def test_torque_comes_back_with_the_next_move_alone():
    assert SPEECH.torque((1, 2), True) == ()
    assert SPEECH.torque((1, 2), False) == (lsc.encode(lsc.Unload((1, 2))),)
    assert SPEECH.set_limits(1, 0, 1000) == ()


def test_pulses_and_steps_are_not_mixed_up():
    with pytest.raises(ProtocolError):
        SPEECH.move([ServoTarget(1, 1500)], 100)
    with pytest.raises(ProtocolError):
        LscPwm().move([ServoTarget(1, 400)], 100)
    assert len(LscPwm().move([ServoTarget(1, 1500)], 100)) == 1
    with pytest.raises(ProtocolError):
        LscPwm().query(Quantity.POSITION, (1,))
