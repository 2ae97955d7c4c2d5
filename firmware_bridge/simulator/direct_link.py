"""A link that ends in a simulated firmware in the same process: no pty, no threads, no waiting.

Simulated time passes by the bytes that go over the wire and by ``wait_readable``, so that a
million commands take seconds and every run is the same.
"""

from typing import Callable

from firmware_bridge.errors import LinkLost, NoSuchPort
from firmware_bridge.links.base import Link
from firmware_bridge.simulator.base import Firmware

Wire = Callable[[bytes], bytes]
_STEP_S = 0.001


def _clean(data: bytes) -> bytes:
    return data


class DirectLink(Link):
    """Connect a host to ``firmware``.

    Parameters
    ----------
    to_firmware, to_host : what the line does to the bytes of one write, or of one answer.
    """

    def __init__(
        self, firmware: Firmware, to_firmware: Wire = _clean, to_host: Wire = _clean
    ) -> None:
        super().__init__("direct", 0)
        self._firmware = firmware
        self._to_firmware, self._to_host = to_firmware, to_host
        self._is_open = False
        self._waiting = bytearray()

    @property
    def is_open(self) -> bool:
        """Say whether the link is open."""
        return self._is_open

    def open(self) -> None:
        """Open it; what was sent before is gone.

        Raises
        ------
        NoSuchPort : a fault has pulled the plug.
        """
        if not self._firmware.is_plugged:
            raise NoSuchPort("direct: no such port while it is unplugged")
        self._waiting.clear()
        self._is_open = True

    def close(self) -> None:
        """Close it."""
        self._is_open = False

    def write(self, data: bytes, n_reply: int = 0) -> None:
        """Hand the bytes to the firmware and fetch its answer.

        Raises
        ------
        LinkLost : the link is closed or unplugged.
        """
        self._check()
        self.n_bytes_out += len(data)
        self._firmware.feed(self._to_firmware(data))
        self._pass(10.0 * len(data) / self._firmware.baud)

    def read_available(self) -> bytes:
        """Return the bytes that wait.

        Raises
        ------
        LinkLost : the link is closed or unplugged.
        """
        self._check()
        data = bytes(self._waiting)
        self._waiting.clear()
        self.n_bytes_in += len(data)
        return data

    def wait_readable(self, timeout_s: float) -> None:
        """Let simulated time pass until bytes wait or it is over.

        Raises
        ------
        LinkLost : the link is closed or unplugged.
        """
        self._check()
        end_s = self._firmware.t_s + timeout_s
        while not self._waiting and self._firmware.t_s < end_s - 1e-9:
            self._pass(min(_STEP_S, end_s - self._firmware.t_s))

    def _pass(self, dt_s: float) -> None:
        self._firmware.step(dt_s)
        answer = self._firmware.replies()
        if answer:
            self._waiting += self._to_host(answer)

    def _check(self) -> None:
        if self._is_open and not self._firmware.is_plugged:
            self._is_open = False
            raise LinkLost("direct: the board was unplugged")
        if not self._is_open:
            raise LinkLost("direct: the link is not open")
