"""A simulated board at the end of a pseudo-terminal, so that the host uses its real serial code.

Either ``pump`` moves the waiting bytes at once, for a caller whose clock is simulated, or ``serve``
runs the board in real time and paces the bytes to the baud rate.
"""

import contextlib
import os
import select
import threading
import time
import tty
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Callable, Iterator, Optional

from firmware_bridge.errors import PortError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.line_speed import line_baud, set_line_baud
from firmware_bridge.simulator.log import BoardLog
from firmware_bridge.simulator.timer_slack import wake_on_time
from firmware_bridge.simulator.wire import Wire, WireOptions

_CHUNK = 65536
_HANDOVER_S = 0.005
_IDLE_S = 0.01
_DEVICES = "/dev/"


class PtyBoard:
    """Open a pseudo-terminal for ``firmware``; give ``port`` to a SerialLink.

    Nothing happens by itself. ``n_bytes_in`` counts what has reached the board; with ``pump`` the
    wire is idle when it equals the link's ``n_bytes_out``. ``n_dropped`` counts bytes nobody read.

    Parameters
    ----------
    firmware : what answers.
    link : a symbolic link to keep pointing at the port, for a name that survives a replug.
    options : how the wire behaves under ``serve``.
    log : where ``serve`` writes all bytes and commands.
    clock : seconds; what ``serve`` paces by.

    Raises
    ------
    PortError : ``link`` exists and is not a link to a device.
    """

    def __init__(
        self,
        firmware: Firmware,
        link: Optional[Path] = None,
        options: WireOptions = WireOptions(),  # noqa: B008 - an immutable value
        log: Optional[BoardLog] = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.firmware = firmware
        self.n_bytes_in = self.n_dropped = 0
        self.wire = Wire(firmware, options, log)
        self._log, self._clock = log, clock
        self._link = None if link is None else Path(link)
        self._lock = threading.RLock()
        self._pending = bytearray()
        self._was_plugged = True
        self._master = self._slave = -1
        self.port = ""
        self.replug()

    @property
    def is_open(self) -> bool:
        """Say whether the board is plugged in."""
        return self._master >= 0

    def replug(self) -> None:
        """Plug it in again, under another device but the same link; nothing if it is plugged in.

        Raises
        ------
        PortError : the link's name is taken by something else.
        """
        with self._lock:
            if self.is_open:
                return
            self._check_link()
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            set_line_baud(self._slave, self.firmware.baud)
            os.set_blocking(self._master, False)
            self._point(os.ttyname(self._slave))
            self._remark("plugged in")

    def unplug(self) -> None:
        """Pull the plug: the host's port hangs up, the link is gone, bytes under way are lost."""
        with self._lock:
            if not self.is_open:
                return
            self._remark("unplugged")
            self._remove_link()
            os.close(self._master)
            os.close(self._slave)
            self._master = self._slave = -1
            self._pending.clear()
            self.wire.cut()

    def close(self) -> None:
        """Unplug for good. Safe to call twice."""
        self.unplug()

    def pump(self) -> int:
        """Move all waiting bytes into the firmware and its replies back; return bytes moved in."""
        if not self.is_open:
            return 0
        data = self._read()
        if data:
            self.firmware.feed(data)
        self._pending += self.firmware.replies()
        if self._pending:
            self._write()
            # The kernel hands the bytes over a little later; without this a run in simulated time
            # would depend on when. A host that has read them already costs the full wait.
            select.select([self._slave], [], [], _HANDOVER_S)
        return len(data)

    def serve(self, stop: threading.Event) -> None:
        """Run in real time until ``stop``: read, let time pass, answer when the wire has.

        Measured at 115200 baud with 14 bytes to and fro: never early, 0.2 ms late in the middle.
        """
        wake_on_time()
        try:
            while not stop.is_set():
                self._wait(self._serve_once())
        finally:
            if self._log is not None:
                self._log.end(self.wire.n_steps)

    def _serve_once(self) -> float:
        """Do what is due and return when there will be more, in seconds from now."""
        with self._lock:
            self._follow_plug()
            if self.is_open:
                self.wire.set_line_baud(line_baud(self._slave))
                data = self._read()
                now_s = self._clock()
                if data:
                    self.wire.host_sent(data, now_s)
            else:
                now_s = self._clock()
            arrived = self.wire.advance(now_s)
            if arrived and self.is_open:
                self._pending += arrived
                self._write()
                self.n_dropped += len(self._pending)  # the host has not read for 4096 bytes
                self._pending.clear()
            return min(max(self.wire.next_s() - self._clock(), 0.0), _IDLE_S)

    def _wait(self, timeout_s: float) -> None:
        """Wait until the host has written or the time is over."""
        master = self._master
        if master < 0:
            time.sleep(timeout_s)
            return
        with contextlib.suppress(OSError, ValueError):  # unplugged meanwhile by another thread
            select.select([master], [], [], timeout_s)

    def _follow_plug(self) -> None:
        """Do what a fault script did to the plug."""
        is_plugged = self.firmware.is_plugged
        if is_plugged != self._was_plugged:
            self._was_plugged = is_plugged
            if is_plugged:
                self.replug()
            else:
                self.unplug()

    def _read(self) -> bytes:
        data = bytearray()
        with contextlib.suppress(BlockingIOError):
            while True:
                data += os.read(self._master, _CHUNK)
        self.n_bytes_in += len(data)
        return bytes(data)

    def _write(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while self._pending:
                del self._pending[: os.write(self._master, self._pending)]

    def _point(self, device: str) -> None:
        if self._link is None:
            self.port = device
            return
        new = self._link.with_name(f".{self._link.name}.{os.getpid()}")
        with contextlib.suppress(FileNotFoundError):
            new.unlink()
        new.symlink_to(device)
        new.replace(self._link)  # in one step: the name never points nowhere
        self.port = str(self._link)

    def _check_link(self) -> None:
        link = self._link
        if link is None or not (link.is_symlink() or link.exists()):
            return
        if not link.is_symlink() or not os.readlink(link).startswith(_DEVICES):
            raise PortError(f"{link}: exists and is no link to a device; choose another name")

    def _remove_link(self) -> None:
        link = self._link
        if link is None:
            return
        with contextlib.suppress(OSError):  # somebody removed or replaced it: theirs now
            if os.readlink(str(link)) == os.ttyname(self._slave):
                link.unlink()

    def _remark(self, text: str) -> None:
        if self._log is not None:
            self._log.note(self.wire.n_steps, text)

    def __enter__(self) -> "PtyBoard":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextlib.contextmanager
def serving(board: PtyBoard) -> Iterator[PtyBoard]:
    """Run a board in a thread of its own; closed at the end, and what it raised is raised here."""
    stop = threading.Event()
    with board, ThreadPoolExecutor(1, thread_name_prefix="sim-board") as pool:
        future = pool.submit(board.serve, stop)
        try:
            yield board
        finally:
            stop.set()
            future.result()
