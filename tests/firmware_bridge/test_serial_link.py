from pathlib import Path

import pytest
from serial.tools import list_ports

from firmware_bridge.errors import LinkLost, NoSuchPort, PortBusy, PortError
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.simulator import PtyBoard, RrcFirmware


@pytest.fixture
def board(arm: ArmModel):
    with PtyBoard(RrcFirmware(arm)) as made:
        yield made


@pytest.fixture
def link(board):
    made = SerialLink(board.port)
    made.open()
    yield made
    made.close()


def n_descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


def test_every_written_byte_arrives_and_is_counted(board, link):
    data = bytes(range(256))  # raw mode: no byte is special
    link.write(data)
    while board.n_bytes_in < link.n_bytes_out:
        board.pump()
    assert link.n_bytes_out == 256
    assert board.n_bytes_in == 256


def test_what_the_board_sends_can_be_read_without_waiting(board, link):
    assert link.read_available() == b""
    board.firmware.step(1.01)
    board.pump()
    data = link.read_available()
    assert data == bytes.fromhex("AA 55 00 03 04 E8 1C 2B")
    assert link.n_bytes_in == len(data)


def test_a_missing_port_is_named_with_those_there_are(monkeypatch):
    class Port:
        device = "/dev/ttyACM7"

    monkeypatch.setattr(list_ports, "comports", lambda: [Port()])
    with pytest.raises(NoSuchPort, match=r"/dev/no-such-port.*ports found: /dev/ttyACM7"):
        SerialLink("/dev/no-such-port").open()


def test_a_port_in_use_is_refused(board, link):
    with pytest.raises(PortBusy, match="held by another program"):
        SerialLink(board.port).open()


def test_a_url_of_no_known_kind_is_refused():
    with pytest.raises(PortError, match="nonsense://x"):
        SerialLink("nonsense://x").open()


def test_a_file_that_is_no_port_is_refused(tmp_path):
    path = tmp_path / "file"
    path.write_text("x")
    with pytest.raises(PortError):
        SerialLink(str(path)).open()


@pytest.mark.parametrize("action", ["read_available", "write"])
def test_unplugging_is_one_error_and_closes_the_link(board, link, action):
    board.close()
    with pytest.raises(LinkLost, match="the board is gone"):
        link.write(b"x") if action == "write" else link.read_available()
    assert not link.is_open
    with pytest.raises(LinkLost, match="not open"):
        link.read_available()


def test_a_board_that_takes_no_bytes_counts_as_lost(board, link):
    with pytest.raises(LinkLost):
        for _ in range(100):
            link.write(bytes(4096))  # nobody pumps: the pty's buffer fills up
    assert not link.is_open


def test_opening_and_losing_again_and_again_leaks_nothing(arm):
    before = n_descriptors()
    for _ in range(20):
        board = PtyBoard(RrcFirmware(arm))
        link = SerialLink(board.port)
        link.open()
        board.close()
        with pytest.raises(LinkLost):
            link.read_available()
    assert n_descriptors() == before


def test_a_link_can_be_opened_again_after_closing(board, link):
    link.close()
    link.close()
    link.open()
    link.write(b"abc")
    assert link.is_open
