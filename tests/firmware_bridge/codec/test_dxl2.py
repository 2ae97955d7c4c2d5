import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import dxl2, dxl2_frame
from firmware_bridge.codec.dxl2 import Dxl2
from firmware_bridge.codec.dxl2_table import N_REGISTERS, TICKS_S_PER_VELOCITY
from firmware_bridge.codec.protocol import Quantity, ServoFlag, ServoTarget
from firmware_bridge.errors import ProtocolError
from offline_train.benchmarks.firmware import kit_dxl2

ids = st.integers(0, dxl2_frame.MAX_ID)
id_lists = st.lists(ids, min_size=1, max_size=8, unique=True).map(tuple)
awkward = st.one_of(st.sampled_from((0xFF, 0xFF, 0xFD, 0x00)), st.integers(0, 255))


def contents(n_bytes):
    return st.lists(awkward, min_size=n_bytes, max_size=n_bytes).map(bytes)


@st.composite
def to_servo(draw):
    address = draw(st.integers(0, N_REGISTERS - 1))
    n_bytes = draw(st.integers(1, min(N_REGISTERS - address, 12)))
    servo_id = draw(st.sampled_from((draw(ids), 0xFE)))
    kind = draw(st.sampled_from((0, 1, 2, 3, 4, 5, 6, 7)))
    if kind < 3:
        return (dxl2.Ping, dxl2.Action, dxl2.Reboot)[kind](servo_id)
    if kind == 3:
        return dxl2.Read(draw(ids), address, n_bytes)
    if kind == 4:
        return dxl2.Write(servo_id, address, draw(contents(n_bytes)))
    if kind == 5:
        return dxl2.RegWrite(servo_id, address, draw(contents(n_bytes)))
    if kind == 6:
        return dxl2.SyncRead(address, n_bytes, draw(id_lists))
    items = tuple((one, draw(contents(n_bytes))) for one in draw(id_lists))
    return dxl2.SyncWrite(address, items)


statuses = st.builds(
    dxl2.Status, ids, st.integers(0, 255), st.lists(awkward, max_size=16).map(bytes)
)


@pytest.mark.parametrize("vector", kit_dxl2.vectors(), ids=lambda vector: vector.what)
def test_frame_is_byte_for_byte_the_published_one(vector):
    assert vector.ours == vector.expected


@pytest.mark.parametrize(("what", "message", "text"), kit_dxl2._FACTS)
def test_published_frame_is_understood(what, message, text):
    (frame,) = dxl2.servo_parser().feed(bytes.fromhex(text))
    assert dxl2.decode_to_servo(frame) == message


def test_random_commands_equal_the_vendor_library_with_its_stuffing_put_right():
    peer = kit_dxl2.sdk()
    if peer is None:
        pytest.skip("dynamixel-sdk is not set up")
    rng = random.Random(4)
    n_stuffed = 0
    for _ in range(2000):
        message = kit_dxl2.random_message(rng)
        ours, theirs = dxl2.encode(message), kit_dxl2.by_sdk(peer, message)
        if kit_dxl2.needs_stuffing(ours):
            n_stuffed += 1
            assert theirs != ours  # the library's known defect
            theirs = peer.corrected(theirs)
        assert theirs == ours
    assert n_stuffed > 20


@given(to_servo())
def test_any_command_comes_back_as_it_was_sent(message):
    (frame,) = dxl2.servo_parser().feed(dxl2.encode(message))
    decoded = dxl2.decode_to_servo(frame)
    assert decoded == message
    assert type(decoded) is type(message)


@given(statuses)
def test_any_status_comes_back_as_it_was_sent(status):
    (frame,) = dxl2.host_parser().feed(dxl2.encode(status))
    assert dxl2.decode_from_servo(frame) == status


@given(st.lists(awkward, max_size=60).map(bytes))
def test_stuffing_hides_every_false_header_and_can_be_undone(body):
    stuffed = dxl2_frame.stuff(body)
    assert dxl2_frame.HEADER not in stuffed
    assert dxl2_frame.unstuff(stuffed) == body


@pytest.mark.parametrize(
    ("payload", "stuffed"),
    [
        ("FF FF FD", "FF FF FD FD"),
        ("FF FF FD FD", "FF FF FD FD FD"),
        ("FF FF FF FD", "FF FF FF FD FD"),
        ("FF FD FF FF FD FF FF FD", "FF FD FF FF FD FD FF FF FD FD"),
        ("FF FD FD", "FF FD FD"),
    ],
)
def test_stuffing_by_hand(payload, stuffed):
    assert dxl2_frame.stuff(bytes.fromhex(payload)) == bytes.fromhex(stuffed)
    assert dxl2_frame.unstuff(bytes.fromhex(stuffed)) == bytes.fromhex(payload)


def unstuffed_frame(data):
    body = bytes((dxl2_frame.WRITE,)) + data
    frame = dxl2_frame.HEADER + b"\x01" + (len(body) + 2).to_bytes(2, "little") + body
    return frame + dxl2_frame.crc16(frame).to_bytes(2, "little")


def test_a_frame_that_was_not_stuffed_is_refused_though_its_crc_is_right():
    (frame,) = dxl2.servo_parser().feed(unstuffed_frame(b"\x74\x00\xff\xff\xfd\x00"))
    with pytest.raises(ProtocolError, match="stuffing"):
        dxl2.decode_to_servo(frame)


@pytest.mark.parametrize(
    "message",
    [
        dxl2.Ping(253),
        dxl2.Ping(255),
        dxl2.Read(254, 132, 4),
        dxl2.Read(1, 146, 2),
        dxl2.Read(1, 146, 0),
        dxl2.Write(253, 64, b"\x00"),
        dxl2.Write(1, 64, b""),
        dxl2.SyncRead(132, 4, ()),
        dxl2.SyncRead(132, 4, (1, 1)),
        dxl2.SyncWrite(116, ((1, bytes(4)), (2, bytes(3)))),
        dxl2.SyncWrite(0, tuple((one, bytes(140)) for one in range(4))),
        dxl2.Status(1, 256),
        dxl2.Status(1, 0, bytes(17)),
    ],
)
def test_what_no_frame_can_carry_is_refused(message):
    with pytest.raises(ProtocolError):
        dxl2.encode(message)


@pytest.mark.parametrize(
    ("code", "data"),
    [
        (9, b""),
        (dxl2_frame.PING, b"\x00"),
        (dxl2_frame.READ, b"\x84\x00\x04"),
        (dxl2_frame.READ, b"\x84\x00\x04\x00\x00"),
        (dxl2_frame.READ, b"\x92\x00\x04\x00"),
        (dxl2_frame.SYNC_WRITE, b"\x74\x00\x04\x00\x01\x00\x08\x00"),
        (dxl2_frame.SYNC_READ, b"\x84\x00\x04\x00\x01\x01"),
    ],
)
def test_a_checked_frame_that_makes_no_sense_is_refused(code, data):
    with pytest.raises(ProtocolError):
        dxl2.decode_to_servo(dxl2_frame.frame_bytes(1, code, data))


def test_an_instruction_is_no_status():
    with pytest.raises(ProtocolError, match="no status"):
        dxl2.decode_from_servo(dxl2.encode(dxl2.Ping(1)))


def test_a_move_rounds_speeds_up_and_never_to_unlimited():
    targets = [ServoTarget(1, 2048, 1), ServoTarget(2, 100, 500), ServoTarget(3, 5)]
    (frame,) = Dxl2().move(targets, 300)
    items = dxl2.decode_to_servo(frame).items
    velocities = [int.from_bytes(data[:4], "little") for _, data in items]
    assert velocities == [1, 32, 0]
    assert 500 <= velocities[1] * TICKS_S_PER_VELOCITY < 500 + TICKS_S_PER_VELOCITY
    assert [int.from_bytes(data[4:], "little") for _, data in items] == [2048, 100, 5]


def ask(quantity, servo_ids):
    (query,) = Dxl2().query(quantity, servo_ids)
    return query


@pytest.mark.parametrize(
    ("quantity", "data", "values"),
    [
        (Quantity.POSITION, "FB FF FF FF", (-5,)),
        (Quantity.SPEED, "F6 FF FF FF", (-156,)),
        (Quantity.LOAD, "9C FF", (-100,)),
        (Quantity.VOLTAGE, "78 00", (12000,)),
        (Quantity.LIMITS, "20 03 00 00 C8 00 00 00", (200, 800)),
        (Quantity.FLAGS, "24", (int(ServoFlag.OVERHEAT | ServoFlag.STALL),)),
    ],
)
def test_an_answer_is_told_in_the_unit_of_the_quantity(quantity, data, values):
    answer = dxl2.encode(dxl2.Status(1, 0, bytes.fromhex(data)))
    (reply,) = Dxl2().match(ask(quantity, [1]), answer)
    assert reply.values == values
    assert ask(quantity, [1]).n_reply == len(answer)


def test_a_refusal_is_an_answer_that_is_not_ok():
    (reply,) = Dxl2().match(ask(Quantity.POSITION, [1]), dxl2.encode(dxl2.Status(1, 7)))
    assert not reply.is_ok


def test_an_alert_comes_with_the_answer():
    answer = dxl2.encode(dxl2.Status(1, 0x80, bytes(4)))
    (reply,) = Dxl2().match(ask(Quantity.POSITION, [1]), answer)
    assert reply.is_ok
    assert reply.flags == ServoFlag.HARDWARE


@pytest.mark.parametrize(
    "status", [dxl2.Status(2, 0, bytes(4)), dxl2.Status(1, 0, bytes(3)), dxl2.Status(1, 0)]
)
def test_a_foreign_or_misshapen_answer_is_none(status):
    assert Dxl2().match(ask(Quantity.POSITION, [1]), dxl2.encode(status)) == ()
