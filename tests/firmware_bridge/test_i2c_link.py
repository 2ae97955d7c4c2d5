import errno
import sys

import pytest

from firmware_bridge.codec.i2c import I2cPwm
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.errors import LinkLost, NoSuchPort, PortBusy, PortError
from firmware_bridge.links.i2c import I2cLink, I2cPort, parse_port
from firmware_bridge.simulator.i2c_board import FakeI2cBus, I2cBoard, I2cFaults, Message
from firmware_bridge.simulator.servo import SimServo
from offline_train.benchmarks.firmware import peers

SPEAKS = I2cPwm()
PORT = "i2c://1?address=0x7a"


@pytest.fixture
def board():
    return I2cBoard([SimServo(one, 1500, (500, 2500), 3300.0) for one in range(1, 7)])


@pytest.fixture
def bus(board):
    return FakeI2cBus(board)


@pytest.fixture
def link(bus):
    made = I2cLink(PORT, bus.opener)
    made.open()
    return made


class Failing:
    """A bus on which the transfers named fail, by their number, with an error number."""

    def __init__(self, inner, failures):
        self.inner, self.failures, self.n = inner, failures, 0

    def opener(self, bus):
        _, message = self.inner.opener(bus)
        return self, message

    def i2c_rdwr(self, *messages):
        self.n += 1
        if self.n in self.failures:
            raise OSError(self.failures[self.n], "failure")
        self.inner.i2c_rdwr(*messages)

    def close(self):
        self.inner.close()


def opened(failing):
    link = I2cLink(PORT, failing.opener)
    link.open()
    return link


def voltage(link):
    (query,) = SPEAKS.query(Quantity.VOLTAGE, [])
    link.write(query.frame, query.n_reply)
    replies = [SPEAKS.match(query, frame) for frame in SPEAKS.parser().feed(link.read_available())]
    return [one.values[0] for reply in replies for one in reply]


@pytest.mark.parametrize(
    ("port", "where"),
    [
        ("i2c://1?address=0x7a", I2cPort(1, 0x7A)),
        ("i2c://0", I2cPort(0, 0x7A)),
        ("i2c:///dev/i2c-3?address=64", I2cPort("/dev/i2c-3", 64)),
    ],
)
def test_a_port_names_bus_and_address(port, where):
    assert parse_port(port) == where


@pytest.mark.parametrize(
    "port",
    [
        "/dev/i2c-1",
        "i2c://",
        "i2c://one",
        "i2c://1?address=0x80",
        "i2c://1?address=x",
        "i2c://1?address=",
        "i2c://1?speed=400000",
        "i2c://1/dev/i2c-1",
        "spi://1",
    ],
)
def test_what_is_no_i2c_port_is_refused_with_its_name(port):
    with pytest.raises(PortError) as caught:
        parse_port(port)
    assert port in str(caught.value)


def test_a_move_reaches_the_servos_byte_for_byte(link, board):
    (frame,) = SPEAKS.move([ServoTarget(1, 1000), ServoTarget(3, 2000)], 800)
    link.write(frame)
    board.step(1.2)
    assert link.n_bytes_out == 10
    assert [servo.measured for servo in board.servos[:3]] == [1000, 1500, 2000]


def test_the_voltage_is_fetched_with_the_question(link, board):
    board.battery_mv = 12220
    assert voltage(link) == [12220]
    assert (link.n_bytes_out, link.n_bytes_in) == (1, 2)
    assert link.read_available() == b""
    link.wait_readable(0.0)


@pytest.mark.parametrize("number", [errno.EREMOTEIO, errno.EIO])
def test_one_failure_is_forgiven_and_the_bytes_arrive_once(bus, board, number):
    link = opened(Failing(bus, {1: number, 3: number}))
    assert voltage(link) == [7400]
    assert link.n_retries == 2
    assert board.n_frames == 1


@pytest.mark.parametrize(
    "failures", [{1: 121, 2: 121}, {1: 5, 2: 121}, {2: 5, 3: 5}, {1: 19}, {1: 110}]
)
def test_a_board_that_fails_twice_or_a_bus_that_is_gone_is_lost(bus, failures):
    link = opened(Failing(bus, failures))
    with pytest.raises(LinkLost, match="i2c://1"):
        voltage(link)
    assert not link.is_open
    assert not bus.is_open
    for action in (lambda: link.write(b"\x00"), link.read_available, lambda: link.wait_readable(0)):
        with pytest.raises(LinkLost, match="not open"):
            action()


def test_an_unplugged_board_is_lost_and_can_be_opened_again(bus, link):
    bus.is_unplugged = True
    with pytest.raises(LinkLost, match="121"):
        link.write(b"\x00", 2)
    bus.is_unplugged = False
    link.open()
    assert voltage(link) == [7400]
    bus.is_gone = True
    with pytest.raises(LinkLost, match=r"19"):
        link.write(b"\x00", 2)
    with pytest.raises(NoSuchPort):
        link.open()


def test_closing_twice_is_fine_and_forgets_what_was_fetched(link):
    link.write(b"\x00", 2)
    link.close()
    link.close()
    link.open()
    assert link.read_available() == b""


@pytest.mark.parametrize(
    ("number", "kind"),
    [(errno.ENOENT, NoSuchPort), (errno.EACCES, PortBusy), (errno.EINVAL, PortError)],
)
def test_why_a_bus_cannot_be_opened_is_told(number, kind):
    def refuse(bus):
        raise OSError(number, "refused")

    with pytest.raises(PortError, match="i2c://1") as caught:
        I2cLink(PORT, refuse).open()
    assert type(caught.value) is kind


def test_without_smbus2_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "smbus2", None)
    with pytest.raises(PortError, match=r"pip install 'apex-edge\[i2c\]'"):
        I2cLink(PORT).open()


def test_smbus2_itself_is_opened_when_it_is_there(monkeypatch):
    module = peers.load("smbus2", "smbus2")
    if module is None:
        pytest.skip("smbus2 is not set up")
    monkeypatch.setitem(sys.modules, "smbus2", module)
    with pytest.raises(NoSuchPort, match="no such I2C bus"):
        I2cLink("i2c:///dev/i2c-no-such-bus").open()


def test_the_messages_of_smbus2_carry_the_same_bytes(bus, board):
    module = peers.load("smbus2", "smbus2")
    if module is None:
        pytest.skip("smbus2 is not set up")
    link = I2cLink(PORT, lambda number: (bus.opener(number)[0], module.i2c_msg))
    link.open()
    link.write(SPEAKS.move([ServoTarget(6, 2000)], 0)[0])
    assert board.commanded == {6: 2000}
    board.battery_mv = 11111
    assert voltage(link) == [11111]


def test_garbled_voltages_are_not_believed_and_the_others_are_right(board):
    link = I2cLink(PORT, FakeI2cBus(board, I2cFaults(garbled=0.3), seed=1).opener)
    link.open()
    seen = [voltage(link) for _ in range(200)]
    assert [] in seen
    assert {one[0] for one in seen if one} == {7400}
    assert 100 < sum(map(bool, seen)) < 180


def test_the_same_seed_gives_the_same_faults(board):
    def failures(seed):
        bus = FakeI2cBus(board, I2cFaults(no_acknowledge=0.2, broken_off=0.1), seed)
        bus.opener(1)
        found = []
        for _ in range(100):
            try:
                bus.i2c_rdwr(Message.write(0x7A, [0]))
                found.append(0)
            except OSError as error:
                found.append(error.errno)
        return found

    assert failures(3) == failures(3)
    assert {0, 5, 121} <= set(failures(3))
