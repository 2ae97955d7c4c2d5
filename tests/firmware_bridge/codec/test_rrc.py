import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import rrc, rrc_frames
from firmware_bridge.codec.rrc_frames import RrcFrame, device_parser, host_parser
from firmware_bridge.errors import ProtocolError

TO_BOARD = [
    (rrc.PwmMove(500, ((1, 1500),)), "AA 55 04 07 01 F4 01 01 01 DC 05 22"),
    (
        rrc.PwmMove(3000, ((3, 500), (4, 2171), (5, 1500), (6, 1500))),
        "AA 55 04 10 01 B8 0B 04 03 F4 01 04 7B 08 05 DC 05 06 DC 05 4F",
    ),
    (rrc.PwmOffset(2, 10), "AA 55 04 03 07 02 0A 02"),
    (rrc.PwmPositionRequest(1), "AA 55 04 02 05 01 E0"),
    (rrc.BusMove(1000, ((1, 833), (2, 1000))), "AA 55 05 0A 01 E8 03 02 01 41 03 02 E8 03 9F"),
    (rrc.BusStop((1, 2)), "AA 55 05 04 03 02 01 02 4B"),
    (rrc.BusTorque(1, False), "AA 55 05 02 0B 01 B3"),
    (rrc.BusTorque(1, True), "AA 55 05 02 0C 01 DD"),
    (rrc.BusRead(5, rrc.BUS_POSITION), "AA 55 05 02 05 05 0E"),
    (rrc.Buzzer(1900, 50, 10, 1), "AA 55 02 08 6C 07 32 00 0A 00 01 00 E9"),
    (rrc.Led(1, 100, 100, 5), "AA 55 01 07 01 64 00 64 00 05 00 37"),
]
FROM_BOARD = [
    (rrc.BusReply(5, rrc.BUS_POSITION, True, (833,)), "AA 55 05 05 05 05 00 41 03 CC"),
    (rrc.BusReply(5, rrc.BUS_POSITION, False, (0,)), "AA 55 05 05 05 05 FF 00 00 A3"),
    (rrc.Battery(7400), "AA 55 00 03 04 E8 1C 2B"),
]

frames = st.builds(RrcFrame, st.integers(0, 255), st.binary(max_size=40))
framed = st.builds(RrcFrame, st.sampled_from((0, 3, 6, 7, 8, 9, 10, 11)), st.binary(max_size=40))
servo_ids = st.integers(1, 253)
durations = st.integers(0, 30000)
u16 = st.integers(0, 0xFFFF)


def moves(low, high):
    return st.lists(
        st.tuples(servo_ids, st.integers(low, high)),
        min_size=1,
        max_size=20,
        unique_by=lambda t: t[0],
    ).map(tuple)


def bus_reply(what):
    values = struct.unpack(rrc.BUS_READS[what], bytes(struct.calcsize(rrc.BUS_READS[what])))
    value = {"h": st.integers(-500, 1500), "H": u16, "B": st.integers(0, 255)}
    one = value.get(rrc.BUS_READS[what][1], st.integers(-125, 125))
    return st.builds(
        rrc.BusReply, servo_ids, st.just(what), st.booleans(), st.tuples(*[one] * len(values))
    )


to_board = st.one_of(
    st.builds(rrc.PwmMove, durations, moves(500, 2500)),
    st.builds(rrc.PwmMoveOne, durations, servo_ids, st.integers(500, 2500)),
    st.builds(rrc.PwmPositionRequest, servo_ids),
    st.builds(rrc.PwmOffset, servo_ids, st.integers(-100, 100)),
    st.builds(rrc.Buzzer, u16, u16, u16, u16),
    st.builds(rrc.Led, st.integers(1, 255), u16, u16, u16),
    st.builds(rrc.BusMove, durations, moves(0, 1000)),
    st.builds(rrc.BusStop, st.lists(servo_ids, min_size=1, max_size=20, unique=True).map(tuple)),
    st.builds(rrc.BusTorque, servo_ids, st.booleans()),
    st.builds(rrc.BusRead, servo_ids, st.sampled_from(sorted(rrc.BUS_READS))),
    st.builds(rrc.PwmOffsetRequest, servo_ids),
    st.builds(rrc.BusSetId, servo_ids, servo_ids),
    st.builds(rrc.BusOffset, servo_ids, st.integers(-125, 125)),
    st.builds(rrc.BusSaveOffset, servo_ids),
    st.builds(rrc.BusLimits, servo_ids, st.integers(0, 499), st.integers(500, 1000)),
    st.builds(rrc.BusVinLimits, servo_ids, st.integers(4500, 6000), st.integers(6001, 12000)),
    st.builds(rrc.BusTempLimit, servo_ids, st.integers(50, 100)),
)
from_board = st.one_of(
    st.builds(rrc.PwmPosition, servo_ids, st.integers(500, 2500)),
    st.builds(rrc.PwmOffsetReply, servo_ids, st.integers(-100, 100)),
    st.sampled_from(sorted(rrc.BUS_READS)).flatmap(bus_reply),
    st.builds(rrc.Imu, *[st.floats(width=32, allow_nan=False)] * 6),
    st.builds(rrc.Battery, u16),
)


def wire(frame):
    return rrc_frames.frame_bytes(*frame)


def parse_all(data):
    parser = device_parser()
    return [rrc_frames.open_frame(f) for f in parser.feed(data) + parser.flush()]


def obeyed(data):
    """What a board would do on these bytes: CRC first, then lengths that must fit the command."""
    commands = []
    parser = device_parser()
    for frame in parser.feed(data) + parser.flush():
        with contextlib.suppress(ProtocolError):
            commands.append(rrc.decode_to_board(frame))
    return commands


def test_crc_has_the_published_check_value():
    assert rrc_frames.crc8(b"123456789") == 0xA1


@pytest.mark.parametrize(("message", "expected"), TO_BOARD + FROM_BOARD)
def test_message_is_encoded_byte_for_byte_as_the_vendor_does(message, expected):
    assert rrc.encode(message) == bytes.fromhex(expected)


@pytest.mark.parametrize(("message", "data"), TO_BOARD)
def test_vendor_command_is_understood(message, data):
    (frame,) = device_parser().feed(bytes.fromhex(data))
    assert rrc.decode_to_board(frame) == message


@pytest.mark.parametrize(("message", "data"), FROM_BOARD)
def test_vendor_report_is_understood(message, data):
    (frame,) = host_parser().feed(bytes.fromhex(data))
    assert rrc.decode_from_board(frame) == message


@given(to_board)
def test_any_command_comes_back_as_it_was_sent(message):
    (frame,) = device_parser().feed(rrc.encode(message))
    decoded = rrc.decode_to_board(frame)
    assert decoded == message
    assert type(decoded) is type(message)


@given(from_board)
def test_any_report_comes_back_as_it_was_sent(message):
    (frame,) = host_parser().feed(rrc.encode(message))
    decoded = rrc.decode_from_board(frame)
    assert decoded == message
    assert type(decoded) is type(message)


@given(st.lists(framed, max_size=8), st.data())
def test_any_chunking_gives_the_same_frames(sent, data):
    stream = b"".join(wire(frame) for frame in sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=12)))
    parser = device_parser()
    got = []
    for begin, end in zip([0, *cuts], [*cuts, len(stream)]):
        got += parser.feed(stream[begin:end])
    assert [rrc_frames.open_frame(frame) for frame in got] == sent


@given(st.lists(framed, min_size=1, max_size=6), st.lists(st.binary(max_size=30), min_size=7))
def test_garbage_between_frames_costs_no_frame(sent, garbage):
    # a stray 0xAA may end the garbage; only a complete false header is kept out of it here
    clean = [chunk.replace(b"\xaa\x55", b"\xaa\xaa") for chunk in garbage]
    stream = clean[0] + b"".join(wire(frame) + chunk for frame, chunk in zip(sent, clean[1:]))
    assert parse_all(stream) == sent


@given(st.lists(framed, min_size=1, max_size=6), st.integers(0, 255), st.integers(0, 255))
def test_a_false_header_swallows_nothing_behind_it(sent, function, length):
    stream = rrc_frames.HEADER + bytes((function, length)) + b"".join(wire(frame) for frame in sent)
    swallowed = stream[2 : 2 + length + 2]
    is_forged = len(stream) >= length + 5 and rrc_frames.crc8(swallowed) == stream[length + 4]
    if not is_forged:  # one in 256 is a valid frame for every reader
        assert parse_all(stream) == sent


@given(st.data())
def test_a_single_flipped_bit_is_never_obeyed(data):
    stream = bytearray(rrc.encode(data.draw(to_board)))
    bit = data.draw(st.integers(0, len(stream) * 8 - 1))
    stream[bit // 8] ^= 1 << (bit % 8)
    assert obeyed(bytes(stream)) == []


def test_every_single_bit_and_short_burst_in_a_move_is_never_obeyed():
    good = rrc.encode(rrc.PwmMove(500, ((1, 1500),)))
    n_bits = len(good) * 8
    as_number = int.from_bytes(good, "little")  # bit order on the wire
    n_tried = 0
    for width in range(1, 9):
        inner = range(1 << max(width - 2, 0))
        for pattern in {(1 << (width - 1)) | (i << 1) | 1 for i in inner}:
            for shift in range(n_bits - width + 1):
                bad = (as_number ^ (pattern << shift)).to_bytes(len(good), "little")
                n_tried += 1
                assert obeyed(bad) == []
    assert n_tried > 10_000


@given(st.binary(max_size=3000))
def test_the_buffer_stays_below_one_frame(data):
    parser = device_parser()
    for begin in range(0, len(data), 100):
        parser.feed(data[begin : begin + 100])
        assert parser.n_held < rrc_frames.MAX_FRAME


def test_flush_frees_a_frame_held_up_behind_a_cut_one():
    whole = RrcFrame(4, b"\x05\x01")
    parser = device_parser()
    assert parser.feed(rrc_frames.HEADER + b"\x04\x40" + wire(whole)) == []
    assert parser.flush() == [wire(whole)]
    assert parser.flush() == []


def test_what_was_dropped_is_counted():
    bad = bytearray(rrc.encode(rrc.PwmPositionRequest(1)))
    bad[-1] ^= 1
    parser = device_parser()
    assert parser.feed(b"noise" + bytes(bad)) == []
    assert (parser.n_frames, parser.n_bad, parser.n_skipped) == (0, 1, 5 + len(bad))


@pytest.mark.parametrize(
    "message",
    [
        rrc.PwmMove(500, ((0, 1500),)),
        rrc.PwmMove(500, ((254, 1500),)),
        rrc.PwmMove(500, ((1, 499),)),
        rrc.PwmMove(500, ((1, 2501),)),
        rrc.PwmMove(30001, ((1, 1500),)),
        rrc.PwmMove(-1, ((1, 1500),)),
        rrc.PwmMove(500, ()),
        rrc.PwmMove(500, ((1, 1500), (1, 1600))),
        rrc.PwmMove(500, tuple((i, 1500) for i in range(1, 82))),
        rrc.PwmMove(500, ((1, 1500.0),)),
        rrc.PwmMove(500, ((True, 1500),)),
        rrc.PwmMoveOne(500, 0, 1500),
        rrc.PwmPositionRequest(0),
        rrc.PwmOffset(1, 101),
        rrc.Buzzer(70000, 1, 1, 1),
        rrc.BusMove(10, ((1, 1001),)),
        rrc.BusStop(()),
        rrc.BusStop((0,)),
        rrc.Battery(-1),
    ],
)
def test_a_value_no_servo_can_take_is_not_encoded(message):
    with pytest.raises(ProtocolError):
        rrc.encode(message)


def test_a_payload_too_long_for_a_frame_is_refused():
    assert len(rrc_frames.frame_bytes(0, bytes(255))) == 260
    with pytest.raises(ProtocolError, match="payload length"):
        rrc_frames.frame_bytes(0, bytes(256))


@pytest.mark.parametrize(
    "frame",
    [
        RrcFrame(4, b""),
        RrcFrame(4, b"\x01\xf4\x01\x02\x01\xdc\x05"),  # says two servos, names one
        RrcFrame(4, b"\x05"),
        RrcFrame(4, b"\x63\x01"),
        RrcFrame(5, b""),
        RrcFrame(5, b"\x03\x05\x01"),
        RrcFrame(5, b"\x40"),
        RrcFrame(2, b"\x01"),
        RrcFrame(99, b"\x01"),
    ],
)
def test_a_command_that_does_not_fit_is_refused(frame):
    with pytest.raises(ProtocolError):
        rrc.decode_to_board(wire(frame))


@given(frames)
def test_no_payload_makes_a_decoder_fail_in_any_other_way(frame):
    for decode in (rrc.decode_to_board, rrc.decode_from_board):
        try:
            decode(wire(frame))
        except ProtocolError as error:
            assert str(error)
