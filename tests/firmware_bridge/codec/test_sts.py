import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import protocol, sts
from firmware_bridge.codec.protocol import Quantity, Query, ServoFlag, ServoTarget
from firmware_bridge.codec.registers import TWOS, Register
from firmware_bridge.codec.sts import Sts
from firmware_bridge.codec.sts_table import N_REGISTERS, REGISTERS
from firmware_bridge.errors import ProtocolError
from offline_train.benchmarks.firmware import kit_sts

ids = st.integers(0, sts.MAX_ID)
KINDS = ("ping", "read", "write", "reg", "action", "sync-read", "sync-write")
id_lists = st.lists(ids, min_size=1, max_size=12, unique=True).map(tuple)


@st.composite
def spans(draw):
    address = draw(st.integers(0, N_REGISTERS - 1))
    return address, draw(st.integers(1, min(N_REGISTERS - address, 16)))


@st.composite
def to_servo(draw):
    (address, n_bytes), servo_id = draw(spans()), draw(ids)
    content = st.binary(min_size=n_bytes, max_size=n_bytes)
    kind = draw(
        st.sampled_from(["ping", "read", "write", "reg", "action", "sync-read", "sync-write"])
    )
    if kind == "ping":
        return sts.Ping(servo_id)
    if kind == "read":
        return sts.Read(servo_id, address, n_bytes)
    if kind == "write":
        return sts.Write(draw(st.sampled_from((servo_id, 0xFE))), address, draw(content))
    if kind == "reg":
        return sts.RegWrite(servo_id, address, draw(content))
    if kind == "action":
        return sts.Action()
    if kind == "sync-read":
        return sts.SyncRead(address, n_bytes, draw(id_lists))
    return sts.SyncWrite(address, tuple((one, draw(content)) for one in draw(id_lists)))


statuses = st.builds(sts.Status, ids, st.integers(0, 0x7F), st.binary(max_size=10))


@pytest.mark.parametrize("vector", kit_sts.vectors(), ids=lambda vector: vector.what)
def test_frame_is_byte_for_byte_the_published_one(vector):
    assert vector.ours == vector.expected


@pytest.mark.parametrize(("what", "message", "text"), kit_sts._FACTS)
def test_published_frame_is_understood(what, message, text):
    (frame,) = sts.servo_parser().feed(bytes.fromhex(text))
    assert sts.decode_to_servo(frame) == message


def test_random_commands_equal_those_of_both_vendor_libraries():
    if len(kit_sts.sdks()) < 2:
        pytest.skip("feetech-servo-sdk and ftservo-python-sdk are not set up")
    rng = random.Random(5)
    for _ in range(300):
        message = kit_sts.random_message(rng)
        for sdk in kit_sts.sdks():
            assert kit_sts.by_sdk(sdk, message) == sts.encode(message)


@given(to_servo())
def test_any_command_comes_back_as_it_was_sent(message):
    (frame,) = sts.servo_parser().feed(sts.encode(message))
    decoded = sts.decode_to_servo(frame)
    assert decoded == message
    assert type(decoded) is type(message)


@given(statuses)
def test_any_status_comes_back_as_it_was_sent(status):
    (frame,) = sts.host_parser().feed(sts.encode(status))
    assert sts.decode_from_servo(frame) == status


@given(st.lists(statuses, max_size=6), st.lists(st.integers(1, 7), min_size=1))
def test_any_chunking_gives_the_same_frames(sent, sizes):
    stream = b"".join(sts.encode(status) for status in sent)
    parser, got, at = sts.host_parser(), [], 0
    for size in sizes * (len(stream) + 1):
        got += parser.feed(stream[at : at + size])
        at += size
        if at >= len(stream):
            break
    assert [sts.decode_from_servo(frame) for frame in got + parser.flush()] == sent


@pytest.mark.parametrize(
    "message",
    [
        sts.Ping(255),
        sts.Read(254, 56, 2),
        sts.Read(1, 70, 2),
        sts.Read(1, 56, 0),
        sts.Write(1, 40, b""),
        sts.Write(1, 71, b"\x00"),
        sts.SyncRead(56, 2, ()),
        sts.SyncRead(56, 2, (1, 1)),
        sts.SyncRead(56, 2, (254,)),
        sts.SyncWrite(42, ((1, b"\x00\x08"), (2, b"\x00"))),
        sts.SyncWrite(42, ()),
        sts.SyncWrite(42, tuple((one, bytes(8)) for one in range(40))),
        sts.Status(1, 0x80),
        sts.Status(1, 0, bytes(11)),
    ],
)
def test_what_no_frame_can_carry_is_refused(message):
    with pytest.raises(ProtocolError):
        sts.encode(message)


@pytest.mark.parametrize(
    ("servo_id", "code", "data"),
    [
        (1, 9, b""),
        (1, sts.PING, b"\x00"),
        (1, sts.READ, b"\x46\x02"),
        (254, sts.SYNC_WRITE, b"\x2a\x02\x01\x00\x08\x02\x00"),
        (254, sts.SYNC_WRITE, b"\x2a\x02\x01\x00\x08\x01\x00\x08"),
        (254, sts.SYNC_READ, b"\x38\x02\x01\x01"),
        (254, sts.SYNC_READ, b"\x38\x00\x01"),
    ],
)
def test_a_checked_frame_that_makes_no_sense_is_refused(servo_id, code, data):
    with pytest.raises(ProtocolError):
        sts.decode_to_servo(sts.frame_bytes(servo_id, code, data))


@pytest.mark.parametrize("start", [b"\xff\xff\x01\xff", b"\xff\xff\xff\xff", b"\xff\xff\xfe\x04"])
def test_an_impossible_start_holds_nothing_back(start):
    answer = sts.encode(sts.Status(3, 0, b"\x00\x08"))
    assert sts.host_parser().feed(start + answer) == [answer]


def test_the_host_never_waits_for_more_than_the_longest_answer():
    parser = sts.host_parser()
    rng = random.Random(2)
    for _ in range(2000):
        parser.feed(bytes(rng.choice((0xFF, rng.randrange(256))) for _ in range(8)))
        assert parser.n_held <= 2 * sts.MAX_REPLY


@pytest.mark.parametrize(
    ("register", "value", "data"),
    [
        (REGISTERS["goal_position"], -5, b"\x05\x80"),
        (REGISTERS["goal_position"], 2048, b"\x00\x08"),
        (REGISTERS["homing_offset"], -85, b"\x55\x08"),
        (REGISTERS["homing_offset"], 85, b"\x55\x00"),
        (REGISTERS["present_load"], -1000, b"\xe8\x07"),
        (Register(0, 4, TWOS), -2, b"\xfe\xff\xff\xff"),
    ],
)
def test_signs_are_where_the_register_has_them(register, value, data):
    assert register.pack(value) == data
    assert register.unpack(data) == value


@pytest.mark.parametrize("value", [-2048, 2048, 1.0, True, None])
def test_an_offset_that_the_register_cannot_hold_is_refused(value):
    with pytest.raises(ProtocolError, match="31"):
        REGISTERS["homing_offset"].pack(value)


def test_a_move_is_one_sync_write_of_goal_and_speed():
    (frame,) = Sts().move([ServoTarget(1, 2048, 1500), ServoTarget(2, 100, 10)], 300)
    items = ((1, bytes.fromhex("00 00 08 00 00 DC 05")), (2, bytes.fromhex("00 64 00 00 00 0A 00")))
    assert sts.decode_to_servo(frame) == sts.SyncWrite(41, items)


def test_more_servos_than_a_frame_holds_go_into_several():
    frames = Sts().move([ServoTarget(one, 2048) for one in range(70)], 0)
    moved = [item[0] for frame in frames for item in sts.decode_to_servo(frame).items]
    assert moved == list(range(70))
    assert max(len(frame) for frame in frames) <= sts.MAX_FRAME


def test_a_stop_holds_a_servo_beyond_its_range_at_the_end():
    (frame,) = Sts().stop([ServoTarget(1, -7), ServoTarget(2, 3000)])
    goals = {one: data[1:3] for one, data in sts.decode_to_servo(frame).items}
    assert goals == {1: b"\x00\x00", 2: (3000).to_bytes(2, "little")}


def test_limits_are_written_between_unlock_and_lock():
    messages = [sts.decode_to_servo(frame) for frame in Sts().set_limits(3, 200, 800)]
    assert messages == [
        sts.SyncWrite(55, ((3, b"\x00"),)),
        sts.SyncWrite(9, ((3, b"\xc8\x00\x20\x03"),)),
        sts.SyncWrite(55, ((3, b"\x01"),)),
    ]


@pytest.mark.parametrize(
    "call",
    [
        lambda speaks: speaks.move([ServoTarget(1, 4096)], 0),
        lambda speaks: speaks.move([ServoTarget(1, -1)], 0),
        lambda speaks: speaks.move([ServoTarget(1, 2048.0)], 0),
        lambda speaks: speaks.move([ServoTarget(1, 2048, -1)], 0),
        lambda speaks: speaks.move([ServoTarget(1, 2048, 40000)], 0),
        lambda speaks: speaks.move([ServoTarget(254, 2048)], 0),
        lambda speaks: speaks.move([ServoTarget(1, 2048), ServoTarget(1, 2049)], 0),
        lambda speaks: speaks.move([ServoTarget(1, 2048)], 30001),
        lambda speaks: speaks.move([], 0),
        lambda speaks: speaks.torque([], True),
        lambda speaks: speaks.set_limits(1, 800, 800),
        lambda speaks: speaks.set_limits(1, 0, 4096),
        lambda speaks: speaks.query(Quantity.POSITION, []),
        lambda speaks: speaks.query(Quantity.POSITION, [300]),
    ],
)
@pytest.mark.parametrize("name", ["sts", "dxl2"])
def test_orders_no_servo_can_take_are_refused(name, call):
    with pytest.raises(ProtocolError):
        call(protocol(name))


def ask(quantity, servo_ids):
    (query,) = Sts().query(quantity, servo_ids)
    return query


def test_one_servo_is_read_and_several_are_read_in_turn():
    assert sts.decode_to_servo(ask(Quantity.POSITION, [1]).frame) == sts.Read(1, 56, 2)
    many = ask(Quantity.LIMITS, [1, 2])
    assert sts.decode_to_servo(many.frame) == sts.SyncRead(9, 4, (1, 2))
    assert many.n_reply == 20


@pytest.mark.parametrize(
    ("quantity", "data", "values"),
    [
        (Quantity.POSITION, "05 80", (-5,)),
        (Quantity.SPEED, "64 80", (-100,)),
        (Quantity.LOAD, "64 04", (-100,)),
        (Quantity.CURRENT, "0A 00", (65,)),
        (Quantity.TEMPERATURE, "23", (35,)),
        (Quantity.VOLTAGE, "4A", (7400,)),
        (Quantity.LIMITS, "C8 00 20 03", (200, 800)),
        (Quantity.OFFSET, "55 08", (-85,)),
        (Quantity.MODEL, "09 03", (777,)),
        (Quantity.FLAGS, "24", (int(ServoFlag.OVERHEAT | ServoFlag.STALL),)),
    ],
)
def test_an_answer_is_told_in_the_unit_of_the_quantity(quantity, data, values):
    answer = sts.encode(sts.Status(1, 0, bytes.fromhex(data)))
    (reply,) = Sts().match(ask(quantity, [1]), answer)
    assert reply.values == values


def test_error_bits_come_with_every_answer():
    answer = sts.encode(sts.Status(1, 1 | 8 | 64, b"\x00\x08"))
    (reply,) = Sts().match(ask(Quantity.POSITION, [1]), answer)
    assert reply.flags == ServoFlag.VOLTAGE | ServoFlag.OVERCURRENT | ServoFlag.HARDWARE


@pytest.mark.parametrize(
    "status",
    [
        sts.Status(2, 0, b"\x00\x08"),
        sts.Status(1, 0, b"\x00"),
        sts.Status(1, 0),
        sts.Status(1, 0, b"\x00\x08\x00"),
    ],
)
def test_a_foreign_or_misshapen_answer_is_none(status):
    assert Sts().match(ask(Quantity.POSITION, [1]), sts.encode(status)) == ()


@pytest.mark.parametrize("quantity", sorted(Sts.quantities, key=lambda one: one.value))
def test_every_quantity_fits_into_a_believed_answer(quantity):
    query = ask(quantity, [1])
    assert isinstance(query, Query)
    assert query.n_reply <= sts.MAX_REPLY
