import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.codec import i2c, protocol
from firmware_bridge.codec.i2c import I2cPwm
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.errors import ProtocolError
from offline_train.benchmarks.firmware import kit_i2c

moves = st.lists(
    st.tuples(st.integers(1, 6), st.integers(500, 2500)),
    min_size=1,
    max_size=6,
    unique_by=lambda target: target[0],
).map(tuple)
to_board = st.one_of(
    st.builds(i2c.Move, st.integers(0, 30000), moves),
    st.builds(i2c.Angle, st.integers(1, 6), st.integers(0, 180)),
    st.builds(i2c.Motor, st.integers(1, 4), st.integers(-100, 100)),
    st.just(i2c.BatteryRequest()),
)


@pytest.mark.parametrize("vector", kit_i2c.vectors(), ids=lambda vector: vector.what)
def test_bytes_are_the_published_ones(vector):
    assert vector.ours == vector.expected


@given(to_board)
def test_any_command_comes_back_as_it_was_sent(message):
    (frame,) = i2c.board_parser().feed(i2c.encode(message))
    decoded = i2c.decode_to_board(frame)
    assert decoded == message
    assert type(decoded) is type(message)


@given(st.integers(0, 0xFFFF))
def test_any_voltage_comes_back_as_it_was_sent(millivolt):
    (frame,) = i2c.host_parser().feed(i2c.encode(i2c.Battery(millivolt)))
    assert i2c.decode_from_board(frame) == i2c.Battery(millivolt)


@given(st.lists(to_board, max_size=5))
def test_commands_one_behind_the_other_are_told_apart(sent):
    parser = i2c.board_parser()
    frames = parser.feed(b"".join(i2c.encode(message) for message in sent))
    assert [i2c.decode_to_board(frame) for frame in frames] == sent
    assert parser.flush() == []
    assert parser.n_skipped == 0


@pytest.mark.parametrize(
    "message",
    [
        i2c.Move(800, ()),
        i2c.Move(800, ((0, 1500),)),
        i2c.Move(800, ((7, 1500),)),
        i2c.Move(800, ((1, 499),)),
        i2c.Move(800, ((1, 2501),)),
        i2c.Move(800, ((1, 1500), (1, 1500))),
        i2c.Move(30001, ((1, 1500),)),
        i2c.Move(-1, ((1, 1500),)),
        i2c.Angle(0, 90),
        i2c.Angle(1, 181),
        i2c.Motor(5, 0),
        i2c.Motor(1, -101),
        i2c.Battery(70000),
    ],
)
def test_what_the_board_cannot_take_is_refused(message):
    with pytest.raises(ProtocolError):
        i2c.encode(message)


@pytest.mark.parametrize(
    "text", ["", "28", "28 01 20 03 01 DC", "28 02 20 03 01 DC 05", "15", "63 01"]
)
def test_what_is_no_command_is_refused(text):
    with pytest.raises(ProtocolError):
        i2c.decode_to_board(bytes.fromhex(text))


def test_nothing_but_the_voltage_can_be_asked():
    speaks = protocol("i2c")
    assert speaks.quantities == {Quantity.VOLTAGE}
    assert not speaks.has_feedback
    assert not speaks.is_checked
    with pytest.raises(ProtocolError, match="voltage"):
        speaks.query(Quantity.POSITION, [1])


@pytest.mark.parametrize(
    ("millivolt", "is_believed"), [(12220, True), (65470, False), (231, False)]
)
def test_a_voltage_that_no_supply_has_is_no_answer(millivolt, is_believed):
    speaks = I2cPwm()
    (query,) = speaks.query(Quantity.VOLTAGE, [])
    replies = speaks.match(query, i2c.encode(i2c.Battery(millivolt)))
    assert [reply.values for reply in replies] == ([(millivolt,)] if is_believed else [])


def test_a_stop_commands_where_the_servos_are_within_what_they_take():
    (frame,) = I2cPwm().stop([ServoTarget(1, 1500), ServoTarget(3, 2600)])
    assert i2c.decode_to_board(frame) == i2c.Move(0, ((1, 1500), (3, 2500)))


def test_the_board_has_no_torque_switch_and_keeps_no_limits():
    assert I2cPwm().torque([1], False) == ()
    assert I2cPwm().set_limits(1, 600, 2000) == ()
