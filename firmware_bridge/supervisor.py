"""A process of its own that stops the arm when the host dies or falls silent.

``python supervisor.py LINK_FD HOST_FD`` inherits the descriptor of the open link and one end of a
packet socket. Each packet is a ``Beat``: when it was sent and the bytes that stop the arm. When
the socket ends (the host is dead) or no beat comes for the time that the beats name (the host
hangs) those bytes are written to the link, and it says so. Nothing but the standard library, so
that it starts in some 20 ms. Source: ours; docs/decisions/011.
"""

import contextlib
import os
import select
import socket
import struct
import sys
import time
from typing import NamedTuple, Optional, Sequence, Tuple

IDLE, WATCH, BYE = 0, 1, 2
READY, TRIPPED = b"R", b"T"
MAX_BEAT = 60000  # well under the socket's buffer
_HEAD = struct.Struct("<BddB")
_PART = struct.Struct("<dH")
_N_STOPS = 3  # the host may have died within a frame, or while a servo was answering
_STOP_GAP_S = 0.012
_WRITE_S = 0.05


class StopBytes(NamedTuple):
    """What stops the arm from ``age_s`` after the beat on, until the next one's age."""

    age_s: float
    data: bytes


class Beat(NamedTuple):
    """One sign of life. ``t_s`` is on the system's monotonic clock.

    ``kind`` is WATCH while the arm moves (silence stops it), IDLE while it stands (only the end of
    the host does) or BYE (nothing does any more).
    """

    kind: int
    t_s: float
    silence_s: float
    stops: Tuple[StopBytes, ...] = ()

    def pack(self) -> bytes:
        """Return the packet."""
        parts = [_HEAD.pack(self.kind, self.t_s, self.silence_s, len(self.stops))]
        for age_s, data in self.stops:
            parts += [_PART.pack(age_s, len(data)), data]
        return b"".join(parts)

    @classmethod
    def unpack(cls, packet: bytes) -> "Beat":
        """Return what a packet says.

        Raises
        ------
        struct.error : it is no beat.
        """
        kind, t_s, silence_s, n_stops = _HEAD.unpack_from(packet)
        at = _HEAD.size
        stops = []
        for _ in range(n_stops):
            age_s, n_data = _PART.unpack_from(packet, at)
            at += _PART.size
            stops.append(StopBytes(age_s, packet[at : at + n_data]))
            at += n_data
        return cls(kind, t_s, silence_s, tuple(stops))

    def stop_at(self, t_s: float) -> bytes:
        """Return the bytes that stop the arm at ``t_s``; empty when there is nothing to stop."""
        due = [stop.data for stop in self.stops if stop.age_s <= t_s - self.t_s]
        return due[-1] if due else (self.stops[0].data if self.stops else b"")


class Supervisor:
    """Watch one host over ``host`` and stop its arm over the descriptor ``link``."""

    def __init__(self, link: int, host: socket.socket) -> None:
        self._link = link
        self._host = host
        self._beat = Beat(IDLE, 0.0, 1.0)
        self._is_tripped = False

    def run(self) -> None:
        """Return when the host has said goodbye, or is dead and the arm stopped."""
        self._host.setblocking(False)
        with contextlib.suppress(OSError):
            self._host.send(READY)
        while True:
            select.select([self._host], [], [], self._patience_s())
            is_over = self._listen()
            if self._beat.kind == BYE:
                return
            if is_over:
                self._stop("the host process ended")
                return
            self._judge()

    def _patience_s(self) -> Optional[float]:
        if self._beat.kind != WATCH or self._is_tripped:
            return None
        return max(self._beat.t_s + self._beat.silence_s - time.monotonic(), 0.0)

    def _listen(self) -> bool:
        """Take all beats that wait; return whether the host is gone."""
        while True:
            try:
                packet = self._host.recv(MAX_BEAT + 1024)
            except BlockingIOError:
                return False
            except OSError:
                return True
            if not packet:
                return True
            self._beat = Beat.unpack(packet)
            if self._is_tripped and self._beat.kind == WATCH:
                # a host that woke up in the middle of a command, and has not noticed yet
                self._write(self._beat.stop_at(time.monotonic()))
            elif self._beat.kind == IDLE:
                self._is_tripped = False

    def _judge(self) -> None:
        silent_s = time.monotonic() - self._beat.t_s
        if self._beat.kind == WATCH and not self._is_tripped and silent_s >= self._beat.silence_s:
            self._is_tripped = True
            self._stop(f"the host was silent for {silent_s * 1000.0:.0f} ms")
            with contextlib.suppress(OSError):
                self._host.send(TRIPPED + struct.pack("<d", silent_s))

    def _stop(self, why: str) -> None:
        data = self._beat.stop_at(time.monotonic())
        is_written = bool(data)
        for n in range(_N_STOPS if data else 0):
            if n:
                time.sleep(_STOP_GAP_S)
            is_written = self._write(data) and is_written
        if self._beat.kind == WATCH:
            what = "stopped the arm" if is_written else "found the link gone as well"
            with contextlib.suppress(OSError, ValueError):
                sys.stderr.write(f"arm supervisor: {why}; {what}\n")
                sys.stderr.flush()

    def _write(self, data: bytes) -> bool:
        """Write all of it; the link's file is the host's own, and may be non-blocking."""
        give_up_s = time.monotonic() + _WRITE_S
        left = data
        while left and time.monotonic() < give_up_s:
            try:
                left = left[os.write(self._link, left) :]
            except BlockingIOError:
                select.select([], [self._link], [], _WRITE_S)
            except OSError:
                return False
        return not left


def main(arguments: Sequence[str]) -> int:
    """Supervise over the two descriptors named on the command line."""
    if len(arguments) != 2 or not all(text.isdigit() for text in arguments):
        sys.stderr.write("usage: supervisor.py LINK_FD HOST_FD (started by the arm's session)\n")
        return 2
    link, host = (int(text) for text in arguments)
    with socket.socket(fileno=host) as channel:
        Supervisor(link, channel).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
