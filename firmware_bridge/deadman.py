"""The host's side of the supervisor process: start it, send signs of life, hear when it acted."""

import contextlib
import logging
import select
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path
from typing import Callable, Optional, Sequence

from firmware_bridge import supervisor
from firmware_bridge.supervisor import Beat, StopBytes

_LOG = logging.getLogger(__name__)

SILENCE_S = 0.12
_START_S = 5.0  # 20 ms on an idle machine
_END_S = 1.0


class Deadman:
    """A supervisor process for one open link; off until ``start``.

    ``trouble`` is why the arm can no longer be taken to be supervised, empty while it is.

    Parameters
    ----------
    silence_s : how long a moving arm's host may be silent.
    now_s : the system's monotonic clock, which the other process reads as well.
    """

    def __init__(
        self, silence_s: float = SILENCE_S, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.silence_s = silence_s
        self.trouble = ""
        self.n_beats = 0
        self.n_trips = 0
        self._now_s = now_s
        self._process: Optional[subprocess.Popen[bytes]] = None
        self._channel: Optional[socket.socket] = None
        self._beat_s: Optional[float] = None  # of the last WATCH beat

    @property
    def is_on(self) -> bool:
        """Say whether a supervisor was started and not stopped."""
        return self._channel is not None

    @property
    def pid(self) -> int:
        """Id of the supervisor's process, 0 when there is none."""
        return self._process.pid if self._process is not None else 0

    def start(self, descriptor: int) -> None:
        """Start a supervisor that shares the open file behind ``descriptor``; wait until it is up.

        When it does not come up ``trouble`` says so.
        """
        self.stop()
        self.trouble = ""
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            command = [sys.executable, "-I", "-S", str(Path(supervisor.__file__))]
            # its own session: Ctrl-C and Ctrl-Z at the terminal are for the host alone
            self._process = subprocess.Popen(
                [*command, str(descriptor), str(theirs.fileno())],
                pass_fds=(descriptor, theirs.fileno()),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                start_new_session=True,
            )
        self._channel = ours
        ours.setblocking(False)
        select.select([ours], [], [], _START_S)
        if self._hear() != supervisor.READY:
            self._fail("the supervisor process did not start")

    def stop(self) -> None:
        """End the supervisor without a stop of the arm; leaves no process and no descriptor."""
        channel, self._channel = self._channel, None
        process, self._process = self._process, None
        self._beat_s = None
        if channel is not None:
            with channel, contextlib.suppress(OSError):
                channel.send(Beat(supervisor.BYE, self._now_s(), self.silence_s).pack())
        if process is not None:
            try:
                process.wait(_END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def beat(self, stops: Sequence[StopBytes], is_moving: bool) -> None:
        """Send a sign of life, with what stops the arm from now on; never waits."""
        channel = self._channel
        if channel is None:
            return
        kind = supervisor.WATCH if is_moving else supervisor.IDLE
        t_s = self._now_s()
        try:
            channel.send(Beat(kind, t_s, self.silence_s, tuple(stops)).pack())
            self.n_beats += 1
        except OSError as error:
            self._fail(f"the supervisor process does not listen: {error}")
        self._beat_s = t_s if is_moving else None

    def check(self) -> str:
        """Return ``trouble``: a supervisor that acted or died, or a beat that is overdue."""
        if self._channel is None:
            return self.trouble
        answer = self._hear()
        if answer[:1] == supervisor.TRIPPED:
            self._trip(struct.unpack("<d", answer[1:9])[0])
        elif self._beat_s is not None and self._now_s() - self._beat_s >= self.silence_s:
            self._trip(self._now_s() - self._beat_s)
        return self.trouble

    def clear(self) -> None:
        """Forget the trouble of a supervisor that is still there."""
        self._hear()
        self._beat_s = None
        if self._channel is not None:
            self.trouble = ""

    def _trip(self, silent_s: float) -> None:
        if not self.trouble:
            self.n_trips += 1
            self.trouble = (
                f"stalled: the host was silent for {silent_s * 1000.0:.0f} ms while the arm moved, "
                f"{self.silence_s * 1000.0:.0f} ms are allowed; the supervisor stopped the arm"
            )

    def _fail(self, why: str) -> None:
        self.stop()
        self.trouble = why
        _LOG.warning("%s", why)

    def _hear(self) -> bytes:
        """Return the newest packet of the supervisor, empty when there is none."""
        newest = b""
        while self._channel is not None:
            try:
                packet = self._channel.recv(64)
            except BlockingIOError:
                break
            except OSError as error:
                self._fail(f"the supervisor process is gone: {error}")
                break
            if not packet:
                self._fail("the supervisor process ended")
                break
            newest = packet
        return newest
