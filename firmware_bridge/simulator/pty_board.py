"""A simulated board at the end of a pseudo-terminal, so that the host uses its real serial code."""

import contextlib
import os
import select
import tty

from firmware_bridge.simulator.firmware import RrcFirmware

_CHUNK = 65536
_HANDOVER_S = 0.005


class PtyBoard:
    """Open a pseudo-terminal for ``firmware``; give ``port`` to a SerialLink.

    Nothing happens by itself: ``pump`` moves the waiting bytes. ``n_bytes_in`` counts what has
    reached the firmware; the wire is idle when it equals the link's ``n_bytes_out``.
    """

    def __init__(self, firmware: RrcFirmware) -> None:
        self.firmware = firmware
        self.n_bytes_in = 0
        self._pending = bytearray()
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)

    @property
    def is_open(self) -> bool:
        """Say whether the board is still plugged in."""
        return self._master >= 0

    def pump(self) -> int:
        """Move all waiting bytes into the firmware and its replies back; return bytes moved in."""
        if not self.is_open:
            return 0
        n_moved = 0
        with contextlib.suppress(BlockingIOError):
            while True:
                data = os.read(self._master, _CHUNK)
                n_moved += len(data)
                self.firmware.feed(data)
        self.n_bytes_in += n_moved
        self._answer()
        return n_moved

    def _answer(self) -> None:
        self._pending += self.firmware.replies()
        if not self._pending:
            return
        with contextlib.suppress(BlockingIOError):
            while self._pending:
                del self._pending[: os.write(self._master, self._pending)]
        # The kernel hands the bytes over a little later; without this a run in simulated time
        # would depend on when. A host that has read them already costs the full wait.
        select.select([self._slave], [], [], _HANDOVER_S)

    def close(self) -> None:
        """Unplug: the host sees its port hang up. Safe to call twice."""
        for descriptor in (self._master, self._slave):
            if descriptor >= 0:
                os.close(descriptor)
        self._master = self._slave = -1

    def __enter__(self) -> "PtyBoard":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
