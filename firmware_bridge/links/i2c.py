"""An I2C board that is either there or lost, behind the same interface as a serial line.

A frame is one write transaction; an answer has to be fetched, so ``write`` does that when it is
told how many bytes to expect. A board that is busy does not acknowledge (121) or breaks off (5) now
and then: once is forgiven, twice is LinkLost. Source: failures that users of the board report.
"""

import contextlib
import errno
import time
from pathlib import Path
from typing import Any, Callable, List, NamedTuple, Tuple, Union
from urllib.parse import parse_qsl, urlsplit

from firmware_bridge.codec.i2c import ADDRESS
from firmware_bridge.errors import LinkLost, NoSuchPort, PortBusy, PortError
from firmware_bridge.links.base import Link

Opener = Callable[[Union[int, str]], Tuple[Any, Any]]
"""Bus number or path -> (bus with ``i2c_rdwr(*messages)`` and ``close()``, its message type)."""

_FORGIVEN = (errno.EREMOTEIO, errno.EIO)
_ADDRESSES = (0x03, 0x7F)  # seven bits; the board uses one that the standard keeps for itself
_EXAMPLE = "i2c://1?address=0x7a"


class I2cPort(NamedTuple):
    """Where a board is: bus number or device path, and its 7-bit address."""

    bus: Union[int, str]
    address: int


def parse_port(port: str) -> I2cPort:
    """Read ``i2c://1?address=0x7a`` or ``i2c:///dev/i2c-1``; 0x7A is the address by default.

    Raises
    ------
    PortError : it is not of that form, or the address out of range.
    """
    parts = urlsplit(port)
    place = parts.path if parts.path else parts.netloc
    options = dict(parse_qsl(parts.query, keep_blank_values=True))
    text = options.pop("address", hex(ADDRESS))
    is_place = place.isdigit() != place.startswith("/") and not (parts.path and parts.netloc)
    if parts.scheme != "i2c" or not is_place or options:
        raise PortError(f"{port}: not an I2C port; expected something like {_EXAMPLE}")
    try:
        address = int(text, 0)
    except ValueError:
        address = -1
    if not _ADDRESSES[0] <= address <= _ADDRESSES[1]:
        low, high = (hex(limit) for limit in _ADDRESSES)
        raise PortError(f"{port}: address {text!r} is not a number in {low}..{high}")
    return I2cPort(int(place) if place.isdigit() else place, address)


def open_smbus(bus: Union[int, str]) -> Tuple[Any, Any]:
    """Open a bus of this machine.

    Raises
    ------
    PortError : smbus2 is not installed.
    OSError : the system refuses.
    """
    try:
        import smbus2
    except ImportError as error:
        raise PortError("I2C needs smbus2: pip install 'apex-edge[i2c]'") from error
    return smbus2.SMBus(bus), smbus2.i2c_msg


class I2cLink(Link):
    """One board on an I2C bus.

    Parameters
    ----------
    port : see ``parse_port``.
    opener : opens the bus; a simulated one is handed in here.
    """

    def __init__(self, port: str, opener: Opener = open_smbus) -> None:
        super().__init__(port, 0)
        self._where = parse_port(port)
        self._opener = opener
        self._bus: Any = None
        self._message: Any = None
        self._waiting = bytearray()
        self.n_retries = 0

    @property
    def is_open(self) -> bool:
        """Say whether the bus is open and the board has not been lost."""
        return self._bus is not None

    def open(self) -> None:
        """Open the bus; whether a board is there shows when it is asked.

        Raises
        ------
        NoSuchPort, PortBusy, PortError : it cannot be opened, and why.
        """
        self.close()
        try:
            self._bus, self._message = self._opener(self._where.bus)
        except OSError as error:
            raise self._why(error) from error

    def close(self) -> None:
        """Close the bus; safe to call at any time."""
        bus, self._bus = self._bus, None
        self._waiting.clear()
        if bus is not None:
            with contextlib.suppress(OSError):  # gone already is what closing wants
                bus.close()

    def write(self, data: bytes, n_reply: int = 0) -> None:
        """Send one transaction and fetch the ``n_reply`` bytes of its answer.

        Raises
        ------
        LinkLost : the bus is closed or went away, or the board failed twice.
        """
        address = self._where.address
        self._transfer(lambda: self._message.write(address, list(data)), "write")
        self.n_bytes_out += len(data)
        if n_reply:
            answer = self._transfer(lambda: self._message.read(address, n_reply), "read")
            self._waiting += bytes(list(answer))

    def read_available(self) -> bytes:
        """Return the bytes that were fetched.

        Raises
        ------
        LinkLost : the bus is closed.
        """
        self._check()
        data = bytes(self._waiting)
        self._waiting.clear()
        self.n_bytes_in += len(data)
        return data

    def wait_readable(self, timeout_s: float) -> None:
        """Return at once when bytes wait; otherwise none will come, and the time is waited out.

        Raises
        ------
        LinkLost : the bus is closed.
        """
        self._check()
        if not self._waiting:
            time.sleep(timeout_s)

    def _transfer(self, make: Callable[[], Any], action: str) -> Any:
        self._check()
        for is_last in (False, True):
            message = make()
            try:
                self._bus.i2c_rdwr(message)
            except OSError as error:
                if is_last or error.errno not in _FORGIVEN:
                    self.close()
                    raise LinkLost(f"{self.port}: {action} failed: {error}") from error
                self.n_retries += 1
            else:
                return message
        return None

    def _check(self) -> None:
        if self._bus is None:
            raise LinkLost(f"{self.port}: the link is not open")

    def _why(self, error: OSError) -> PortError:
        if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
            found = ", ".join(buses()) or "none"
            return NoSuchPort(f"{self.port}: no such I2C bus; buses found: {found}")
        if error.errno in (errno.EBUSY, errno.EACCES, errno.EPERM):
            return PortBusy(f"{self.port}: in use, or this user may not open it: {error}")
        return PortError(f"{self.port}: cannot be opened: {error}")


def buses() -> List[str]:
    """List the I2C buses this machine has."""
    return sorted(str(path) for path in Path("/dev").glob("i2c-*"))
