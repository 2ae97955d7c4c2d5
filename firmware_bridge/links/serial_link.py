"""A serial line that is either there or lost: bytes out, waiting bytes in, one error for all.

pyserial reports a vanished port in three ways (SerialException, plain OSError, termios.error);
here all of them are LinkLost, and the port is closed. Everything that pyserial opens by URL works
the same way (socket://, rfc2217://, loop://, spy://, alt://).
"""

import contextlib
import errno
import select
import threading
import time
from dataclasses import dataclass
from typing import Any

import serial

from firmware_bridge.errors import LinkLost, NoSuchPort, PortBusy, PortError
from firmware_bridge.links.base import Link
from firmware_bridge.links.echo import EchoFilter
from firmware_bridge.links.ports import ports

try:
    from termios import error as _TermiosError  # noqa: N812
except ImportError:  # not a POSIX system
    _TermiosError = OSError  # type: ignore[assignment,misc]

__all__ = ["SerialLink", "SerialStats"]

# SerialException derives from OSError; both are named since pyserial says either. TypeError and
# ValueError come from a port that another thread closes at this moment (no descriptor any more).
_LOST = (serial.SerialException, OSError, _TermiosError, TypeError, ValueError)
# 17 bytes take 0.2 ms at 1 Mbaud, and a blocked line is as good as lost. But pyserial also raises
# when the bytes are out and this process was kept from the CPU meanwhile: 0.1 s of that was seen.
_WRITE_TIMEOUT_S = 1.0
_POLL_S = 0.0005
_CHUNK = 4096
_OWN_DEVICE = ("spy://", "alt://")  # URLs of a local device: it can be had for oneself


@dataclass
class SerialStats:
    """Counts since the link was made: frames written, times opened again, times lost."""

    n_frames_out: int = 0
    n_reopened: int = 0
    n_lost: int = 0


class SerialLink(Link):
    """One serial port, by path or pyserial URL.

    Own bytes that the adapter loops back are taken out (``has_echo`` says whether it does, None
    until known). Bytes read may come from another thread than bytes written.
    """

    def __init__(self, port: str, baud: int = 1_000_000) -> None:
        super().__init__(port, baud)
        self.stats = SerialStats()
        self._serial: Any = None
        self._descriptor = -1  # -1: nothing that the system can wait for
        self._echo = EchoFilter()
        self._guard = threading.RLock()  # of the echo filter and of what the line still carries
        self._busy_until_s = float("-inf")
        self._was_open = False

    @property
    def is_open(self) -> bool:
        """Say whether the port is open and has not been lost."""
        return self._serial is not None

    @property
    def has_echo(self) -> Any:
        """Whether own bytes come back: True, False, or None while that is not known."""
        return self._echo.has_echo

    @property
    def descriptor(self) -> int:
        """The open file behind the port; -1 when closed, or for a URL that has none."""
        return self._descriptor if self._serial is not None else -1

    def set_baud(self, baud: int) -> bool:
        """Go on at another baud rate; say whether the port can.

        Raises
        ------
        LinkLost : the port is closed or went away.
        """
        device = self._device()
        try:
            device.baudrate = baud
        except (ValueError, NotImplementedError):
            return False
        except _LOST as error:
            raise self._lost("set baud rate", error) from error
        self.baud = baud
        self.mark_idle()
        return True

    def open(self) -> None:
        """Open the port, for this program alone where the system can do that.

        Raises
        ------
        NoSuchPort, PortBusy, PortError : it cannot be opened, and why.
        """
        self.close()
        try:
            device = serial.serial_for_url(self.port, do_not_open=True)
            device.baudrate = self.baud
            device.timeout = 0
            if not self.port.startswith("rfc2217://"):  # which knows none
                device.write_timeout = _WRITE_TIMEOUT_S
            if "://" not in self.port or self.port.startswith(_OWN_DEVICE):
                device.exclusive = True
            device.open()
        except (ValueError, KeyError, NotImplementedError) as error:
            raise PortError(f"{self.port}: not a port that can be opened: {error}") from error
        except _LOST as error:
            raise self._why(error) from error
        _ask_for_low_latency(device)
        self._descriptor = _descriptor(device)
        self._echo = EchoFilter()
        self._busy_until_s = float("-inf")
        self.stats.n_reopened += self._was_open
        self._was_open = True
        self._serial = device

    def close(self) -> None:
        """Close the port; safe to call at any time."""
        device, self._serial = self._serial, None
        if device is not None:
            with contextlib.suppress(*_LOST):  # gone already is what closing wants
                device.close()

    def write(self, data: bytes, n_reply: int = 0) -> None:
        """Send all of ``data``; replies come by themselves, so ``n_reply`` is of no use here.

        Raises
        ------
        LinkLost : the port is closed, went away, or took no byte within the time-out.
        """
        device = self._device()
        with self._guard:
            self._echo.sent(data)
            free_s = max(self._busy_until_s, time.monotonic())
            self._busy_until_s = free_s + 10.0 * len(data) / self.baud
        try:
            n_written = device.write(data)
        except _LOST as error:
            raise self._lost("write", error) from error
        # rfc2217 says nothing about how many
        n_written = len(data) if n_written is None else n_written
        self.n_bytes_out += n_written
        self.stats.n_frames_out += 1
        if n_written != len(data):
            raise self._lost("write", OSError(f"took {n_written} of {len(data)} bytes"))

    def idle_in_s(self) -> float:
        """Return how long the bytes written still need at this baud rate, 0 when they are out."""
        return max(self._busy_until_s - time.monotonic(), 0.0)

    def mark_idle(self) -> None:
        """Say that all bytes written have arrived; a pseudo-terminal is faster than its baud."""
        self._busy_until_s = float("-inf")

    def read_available(self) -> bytes:
        """Return the bytes that wait, echoes taken out, without blocking.

        Raises
        ------
        LinkLost : the port is closed or went away.
        """
        device = self._device()
        try:
            data = bytes(device.read(_CHUNK))
            while self._descriptor < 0 and device.in_waiting:  # rfc2217 gives single bytes
                data += bytes(device.read(_CHUNK))
        except _LOST as error:
            raise self._lost("read", error) from error
        self.n_bytes_in += len(data)
        with self._guard:
            return self._echo.strip(data)

    def wait_readable(self, timeout_s: float) -> None:
        """Return when bytes wait or the time is over.

        Raises
        ------
        LinkLost : the port is closed or went away.
        """
        device = self._device()
        try:
            if self._descriptor >= 0:
                select.select([self._descriptor], [], [], timeout_s)
                return
            end_s = time.monotonic() + timeout_s
            while not device.in_waiting and time.monotonic() < end_s:
                time.sleep(_POLL_S)
        except _LOST as error:
            raise self._lost("wait", error) from error

    def _device(self) -> Any:
        device = self._serial
        if device is None:
            raise LinkLost(f"{self.port}: the link is not open")
        return device

    def _lost(self, action: str, error: BaseException) -> LinkLost:
        self.stats.n_lost += self._serial is not None
        self.close()
        return LinkLost(f"{self.port}: {action} failed, the board is gone: {error}")

    def _why(self, error: BaseException) -> PortError:
        number = getattr(error, "errno", None)
        if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
            found = ", ".join(str(port) for port in ports()) or "none"
            return NoSuchPort(f"{self.port}: no such port; ports found: {found}")
        if number in (errno.EBUSY, errno.EACCES, errno.EAGAIN, errno.EPERM):
            return PortBusy(
                f"{self.port}: held by another program, or this user may not open it: {error}"
            )
        if "exclusively lock" in str(error):
            return PortBusy(f"{self.port}: held by another program: {error}")
        return PortError(f"{self.port}: cannot be opened: {error}")


def _descriptor(device: Any) -> int:
    """Return what the system can wait on, -1 for ports that have nothing like it."""
    try:
        return int(device.fileno())
    except (OSError, AttributeError, ValueError):
        return -1


def _ask_for_low_latency(device: Any) -> None:
    """Ask an FTDI adapter to hand bytes over at once instead of after 16 ms, if it can."""
    ask = getattr(device, "set_low_latency_mode", None)
    if ask is not None:
        with contextlib.suppress(OSError, ValueError, NotImplementedError):
            ask(True)
