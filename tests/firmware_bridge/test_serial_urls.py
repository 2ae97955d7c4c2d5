"""Every kind of port that pyserial opens by URL, each against the real thing on this machine."""

import os
import socket
import threading
import time
import tty

import pytest
import serial
from plain_bus import Plain
from serial import rfc2217

from firmware_bridge.errors import LinkLost, PortError
from firmware_bridge.links.opening import open_link
from firmware_bridge.links.ports import PortInfo, ports
from firmware_bridge.links.serial_link import SerialLink

_PATIENCE_S = 10.0


def read_until(link, n_bytes):
    data = bytearray()
    give_up_s = time.monotonic() + _PATIENCE_S
    while len(data) < n_bytes and time.monotonic() < give_up_s:
        link.wait_readable(0.05)
        data += link.read_available()
    return bytes(data)


def until_lost(link):
    with pytest.raises(LinkLost):
        give_up_s = time.monotonic() + _PATIENCE_S
        while time.monotonic() < give_up_s:
            link.wait_readable(0.01)
            link.read_available()
    assert not link.is_open
    assert link.stats.n_lost == 1


class Pty:
    """A terminal whose other end answers each byte with its complement."""

    def __init__(self):
        self.master, slave = os.openpty()
        tty.setraw(slave)
        self.port = os.ttyname(slave)
        self._slave = slave

    def answer(self):
        data = os.read(self.master, 4096)
        os.write(self.master, bytes(255 - value for value in data))

    def close(self):
        for descriptor in (self.master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self.master = self._slave = -1


@pytest.fixture
def pty():
    made = Pty()
    yield made
    made.close()


@pytest.fixture
def server():
    with (
        socket.create_server(("127.0.0.1", 0)) if hasattr(socket, "create_server") else _old()
    ) as s:
        s.settimeout(_PATIENCE_S)
        yield s


def _old():
    made = socket.socket()
    made.bind(("127.0.0.1", 0))
    made.listen()
    return made


@pytest.mark.parametrize("scheme", ["{}", "spy://{}?file={}", "alt://{}?class=PosixPollSerial"])
def test_a_device_by_any_local_name_talks_and_is_lost_when_unplugged(scheme, pty, tmp_path):
    link = SerialLink(scheme.format(pty.port, tmp_path / "log"))
    link.open()
    link.write(b"abc")
    pty.answer()
    assert read_until(link, 3) == bytes(255 - value for value in b"abc")
    assert (link.n_bytes_out, link.n_bytes_in, link.stats.n_frames_out) == (3, 3, 1)
    pty.close()
    until_lost(link)


def test_a_tcp_port_talks_and_is_lost_when_the_other_side_hangs_up(server):
    link = SerialLink(f"socket://127.0.0.1:{server.getsockname()[1]}")
    link.open()
    peer, _ = server.accept()
    link.write(b"abc")
    assert peer.recv(3) == b"abc"
    peer.sendall(b"defg")
    assert read_until(link, 4) == b"defg"
    peer.close()
    until_lost(link)


def test_a_tcp_port_that_nobody_serves_cannot_be_opened(server):
    port = server.getsockname()[1]
    server.close()
    with pytest.raises(PortError):
        SerialLink(f"socket://127.0.0.1:{port}").open()


def test_a_loop_is_an_adapter_that_echoes_everything():
    link = SerialLink("loop://")
    link.open()
    for _ in range(3):
        link.write(b"abc")
        link.wait_readable(0.01)
        assert link.read_available() == b""
    assert link.has_echo is True
    assert link.n_bytes_in == 9
    link.close()


class BarePort(serial.Serial):
    """A terminal has none of the modem lines that the server reports and sets."""

    cts = dsr = ri = cd = dtr = rts = False


class Rfc2217Server(threading.Thread):
    """Serve one client a serial port of this machine by RFC 2217."""

    def __init__(self, server, device):
        super().__init__(daemon=True)
        self._server = server
        self.port = BarePort(device, baudrate=9600, timeout=0.01)
        self.peer = None

    def write(self, data):
        self.peer.sendall(data)

    def run(self):
        self.peer, _ = self._server.accept()
        self.peer.settimeout(0.01)
        manager = rfc2217.PortManager(self.port, self)
        while True:
            try:
                data = self.peer.recv(1024)
                if not data:
                    break
                self.port.write(b"".join(manager.filter(data)))
            except socket.timeout:
                pass
            except OSError:
                break
            self.write(b"".join(manager.escape(self.port.read(self.port.in_waiting))))
        self.peer.close()
        self.port.close()


def test_a_port_of_another_machine_talks_and_is_lost_when_that_goes(server, pty):
    thread = Rfc2217Server(server, pty.port)
    thread.start()
    link = SerialLink(f"rfc2217://127.0.0.1:{server.getsockname()[1]}", 115200)
    link.open()
    data = bytes(range(250, 256)) + b"abc"  # 255 is special there
    link.write(data)
    n_there = 0
    while n_there < len(data):
        chunk = os.read(pty.master, 100)
        n_there += len(chunk)
        os.write(pty.master, bytes(255 - value for value in chunk))
    assert read_until(link, len(data)) == bytes(255 - value for value in data)
    assert thread.port.baudrate == 115200  # the other machine's port was told
    thread.peer.shutdown(socket.SHUT_RDWR)
    until_lost(link)
    thread.join(_PATIENCE_S)


@pytest.mark.parametrize("action", ["write", "read_available", "wait"])
@pytest.mark.parametrize("error", [serial.SerialException("x"), OSError(5, "x"), TypeError("x")])
def test_whatever_a_driver_raises_is_one_error(pty, action, error, monkeypatch):
    import termios

    for raised in (error, termios.error(5, "x")):
        link = SerialLink(pty.port)
        link.open()

        def fail(*_, raised=raised):
            raise raised

        monkeypatch.setattr(link._serial, "write", fail)
        monkeypatch.setattr(link._serial, "read", fail)
        monkeypatch.setattr("select.select", fail)
        with pytest.raises(LinkLost, match="the board is gone"):
            if action == "write":
                link.write(b"x")
            elif action == "wait":
                link.wait_readable(0.1)
            else:
                link.read_available()
        monkeypatch.undo()
        assert not link.is_open
        assert (link.stats.n_lost, link.n_bytes_out) == (1, 0)


def test_a_port_lost_and_opened_again_is_counted(pty):
    link = SerialLink(pty.port)
    link.open()
    assert link.stats.n_reopened == 0
    link.close()
    link.open()
    assert link.stats.n_reopened == 1
    link.close()


def test_the_line_is_busy_as_long_as_the_bytes_need(pty, monkeypatch):
    now = [100.0]
    monkeypatch.setattr("firmware_bridge.links.serial_link.time.monotonic", lambda: now[0])
    link = SerialLink(pty.port, 115200)
    link.open()
    assert link.idle_in_s() == 0.0
    link.write(bytes(10))
    assert link.idle_in_s() == pytest.approx(100 / 115200)
    link.write(bytes(10))
    assert link.idle_in_s() == pytest.approx(200 / 115200)
    now[0] += 150 / 115200
    assert link.idle_in_s() == pytest.approx(50 / 115200)
    link.mark_idle()
    assert link.idle_in_s() == 0.0
    link.close()


def test_an_address_gives_the_link_that_fits():
    assert isinstance(open_link("/dev/ttyUSB0", Plain()), SerialLink)
    assert open_link("/dev/ttyUSB0", Plain()).baud == Plain.baud
    assert not open_link("loop://", Plain()).is_open


def test_ports_carry_their_stable_names(tmp_path, monkeypatch):
    device = tmp_path / "ttyUSB0"
    device.write_text("")
    by_id = tmp_path / "by-id"
    by_id.mkdir()
    (by_id / "usb-arm").symlink_to(device)

    class Usb:
        vid, pid, description = 0x1A86, 0x7523, "USB Serial"

    Usb.device = str(device)
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [Usb()])
    stable = str(by_id / "usb-arm")
    assert ports(by_id) == [PortInfo(str(device), "USB Serial", "1a86:7523", stable)]
    assert ports(tmp_path / "none")[0].stable == ""
