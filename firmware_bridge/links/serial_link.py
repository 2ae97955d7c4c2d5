"""A serial line that is either there or lost: bytes out, waiting bytes in, one error for all.

pyserial reports a vanished port in three ways (SerialException, plain OSError, termios.error);
here all of them are LinkLost, and the port is closed.
"""

import contextlib
import errno
import select
import time
from typing import Any, List

import serial
from serial.tools import list_ports

from firmware_bridge.errors import LinkLost, NoSuchPort, PortBusy, PortError
from firmware_bridge.links.base import Link

try:
    from termios import error as _TermiosError  # noqa: N812
except ImportError:  # not a POSIX system
    _TermiosError = OSError  # type: ignore[assignment,misc]

# SerialException derives from OSError; both are named since pyserial says either.
_LOST = (serial.SerialException, OSError, _TermiosError)
# 17 bytes take 0.2 ms at 1 Mbaud, and a blocked line is as good as lost. But pyserial also raises
# when the bytes are out and this process was kept from the CPU meanwhile: 0.1 s of that was seen.
_WRITE_TIMEOUT_S = 1.0
_POLL_S = 0.0005


class SerialLink(Link):
    """One serial port, by path or pyserial URL."""

    def __init__(self, port: str, baud: int = 1_000_000) -> None:
        super().__init__(port, baud)
        self._serial: Any = None

    @property
    def is_open(self) -> bool:
        """Say whether the port is open and has not been lost."""
        return self._serial is not None

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
            device.write_timeout = _WRITE_TIMEOUT_S
            if "://" not in self.port:
                device.exclusive = True
            device.open()
        except ValueError as error:
            raise PortError(f"{self.port}: not a port that can be opened: {error}") from error
        except _LOST as error:
            raise self._why(error) from error
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
        try:
            n_written = device.write(data)
        except _LOST as error:
            raise self._lost("write", error) from error
        self.n_bytes_out += n_written
        if n_written != len(data):
            raise self._lost("write", OSError(f"took {n_written} of {len(data)} bytes"))

    def read_available(self) -> bytes:
        """Return the bytes that wait, without blocking.

        Raises
        ------
        LinkLost : the port is closed or went away.
        """
        device = self._device()
        try:
            data = bytes(device.read(max(int(device.in_waiting), 1)))
        except _LOST as error:
            raise self._lost("read", error) from error
        self.n_bytes_in += len(data)
        return data

    def wait_readable(self, timeout_s: float) -> None:
        """Return when bytes wait or the time is over.

        Raises
        ------
        LinkLost : the port is closed or went away.
        """
        device = self._device()
        end_s = time.monotonic() + timeout_s
        try:
            descriptor = device.fileno()
        except (OSError, AttributeError):  # sockets of a URL, loop://: no descriptor to wait on
            descriptor = None
        try:
            if descriptor is not None:
                select.select([descriptor], [], [], timeout_s)
                return
            while not device.in_waiting and time.monotonic() < end_s:
                time.sleep(_POLL_S)
        except (*_LOST, ValueError) as error:
            raise self._lost("wait", error) from error

    def _device(self) -> Any:
        if self._serial is None:
            raise LinkLost(f"{self.port}: the link is not open")
        return self._serial

    def _lost(self, action: str, error: BaseException) -> LinkLost:
        self.close()
        return LinkLost(f"{self.port}: {action} failed, the board is gone: {error}")

    def _why(self, error: BaseException) -> PortError:
        number = getattr(error, "errno", None)
        if number in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
            found = ", ".join(ports()) or "none"
            return NoSuchPort(f"{self.port}: no such port; ports found: {found}")
        if number in (errno.EBUSY, errno.EACCES, errno.EAGAIN, errno.EPERM):
            return PortBusy(
                f"{self.port}: held by another program, or this user may not open it: {error}"
            )
        if "exclusively lock" in str(error):
            return PortBusy(f"{self.port}: held by another program: {error}")
        return PortError(f"{self.port}: cannot be opened: {error}")


def ports() -> List[str]:
    """List the serial ports this machine has."""
    return sorted(port.device for port in list_ports.comports())
