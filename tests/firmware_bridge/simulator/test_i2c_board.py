import pytest

from firmware_bridge.codec import i2c
from firmware_bridge.simulator.i2c_board import FakeI2cBus, I2cBoard, Message
from firmware_bridge.simulator.servo import SimServo


@pytest.fixture
def board():
    return I2cBoard([SimServo(one, 1500, (500, 2500), 3300.0) for one in (1, 3, 4, 5, 6)])


def test_a_move_takes_as_long_as_it_says(board):
    board.feed(i2c.encode(i2c.Move(1000, ((3, 2500),))))
    board.step(0.5)
    assert board.servos[1].measured == pytest.approx(2000, abs=40)
    board.step(0.6)
    assert board.servos[1].measured == 2500


def test_pulses_and_durations_are_kept_in_bounds(board):
    board.feed(bytes.fromhex("28 01 FF FF 03 FF FF"))
    assert board.commanded == {3: 2500}
    assert board.n_clamped == 1
    board.step(15.0)
    assert board.servos[1].measured == pytest.approx(2000, abs=60)  # 30 s at most, not 65


def test_servos_it_does_not_have_are_ignored(board):
    board.feed(i2c.encode(i2c.Move(0, ((2, 2000), (1, 2000)))))
    assert board.commanded == {1: 2000}


def test_an_angle_is_a_pulse_at_once(board):
    board.feed(i2c.encode(i2c.Angle(6, 180)))
    board.step(1.0)
    assert board.servos[4].measured == 2500


def test_what_makes_no_sense_moves_nothing(board):
    for text in ("28 02 20 03 01 DC 05", "63", ""):
        board.feed(bytes.fromhex(text))
    assert board.n_rejected == 3
    assert board.commanded == {}


def test_another_address_is_not_acknowledged(board):
    bus = FakeI2cBus(board)
    bus.opener("/dev/i2c-1")
    with pytest.raises(OSError, match="121"):
        bus.i2c_rdwr(Message.write(0x40, [0]))
    with pytest.raises(OSError, match=r"\[Errno 2\]"):
        bus.opener(7)


def test_a_board_that_was_asked_nothing_leaves_the_line_high(board):
    bus = FakeI2cBus(board)
    bus.opener(1)
    answer = Message.read(0x7A, 2)
    bus.i2c_rdwr(answer)
    assert bytes(answer) == b"\xff\xff"
