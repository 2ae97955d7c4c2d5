"""The wire between a host and a simulated firmware: a byte arrives when a real one would.

Pure: time is handed in. The firmware's own time goes in whole steps of ``TICK_S``, so that a log of
what it was fed, and at which step, replays to the same motion. Source: 8N1, ten bits per byte.
"""

import random
from collections import deque
from typing import Deque, NamedTuple, Optional

from firmware_bridge.simulator.base import Firmware

TICK_S = 0.001
_BITS_PER_BYTE = 10.0
_N_ALERT = 100  # steps after a byte arrived in which the firmware may still answer it
_SLACK_S = 1e-9


class WireOptions(NamedTuple):
    """How the line behaves.

    ``is_half_duplex``: one wire for both ways, bytes that overlap garble each other;
    ``is_echo``: the adapter loops the host's own bytes back; ``is_paced``: bytes take their time;
    ``grain_s``: bytes of a longer run are handed over in groups no longer than this.
    """

    is_half_duplex: bool = False
    is_echo: bool = False
    is_paced: bool = True
    grain_s: float = 0.001
    seed: int = 0


class Tap:
    """Hear what passes; a log overrides this."""

    def fed(self, n_steps: int, data: bytes) -> None:
        """Bytes reach the firmware after that many steps of ``TICK_S``."""

    def sent(self, n_steps: int, data: bytes) -> None:
        """The firmware sent bytes."""

    def heard(self, n_steps: int, baud: int) -> None:
        """The line changed to another baud rate."""


class _Byte:
    """One byte on the wire, from its start bit to the end of its stop bit."""

    __slots__ = ("end_s", "start_s", "value")

    def __init__(self, start_s: float, end_s: float, value: int) -> None:
        self.start_s, self.end_s, self.value = start_s, end_s, value


class Wire:
    """Carry bytes both ways. ``n_collisions`` counts pairs of bytes that garbled each other.

    Parameters
    ----------
    firmware : what is at the other end.
    options : how the line behaves.
    tap : hears what passes.
    """

    def __init__(self, firmware: Firmware, options: WireOptions, tap: Optional[Tap] = None) -> None:
        self.firmware = firmware
        self.options = options
        self.line_baud = firmware.baud
        self.n_collisions = 0
        self.n_steps = 0
        self._alert_until = 0
        self._tap = Tap() if tap is None else tap
        self._rng = random.Random(options.seed)
        self._zero_s: Optional[float] = None
        self._going: Deque[_Byte] = deque()
        self._coming: Deque[_Byte] = deque()
        self._echo: Deque[_Byte] = deque()
        self._host_free_s = self._firmware_free_s = float("-inf")

    def set_line_baud(self, baud: int) -> None:
        """Take the host's side to be at ``baud``; what does not match arrives as garbage."""
        if baud != self.line_baud:
            self.line_baud = baud
            self.firmware.listen(baud)
            self._tap.heard(self.n_steps, baud)

    def host_sent(self, data: bytes, now_s: float) -> None:
        """Take bytes that left the host now; they queue behind those still on the wire."""
        is_understood = self.firmware.listen(self.line_baud)
        byte_s = self._byte_s()
        start_s = max(now_s, self._host_free_s)
        for value in data:
            byte = _Byte(start_s, start_s + byte_s, value)
            start_s = byte.end_s
            if self.options.is_half_duplex:
                self._collide(byte, self._coming)
            if self.options.is_echo:
                self._echo.append(byte if is_understood else _Byte(start_s, start_s, value))
            if not is_understood:
                byte.value = self._rng.randrange(256)
            self._going.append(byte)
        self._host_free_s = start_s

    def advance(self, now_s: float) -> bytes:
        """Let time pass until ``now_s`` and return the bytes that have reached the host by then."""
        if self._zero_s is None:
            self._zero_s = now_s
        going, feed = self._going, self.firmware.feed
        while going and going[0].end_s <= now_s + _SLACK_S:
            end_s = going[0].end_s
            self._pass_until(end_s)
            data = bytes((going.popleft().value,))
            if not self.options.is_paced:
                data += bytes(byte.value for byte in going)
                going.clear()
            self._alert_until = self.n_steps + _N_ALERT
            self._tap.fed(self.n_steps, data)  # before what it leads to
            feed(data)
            self._collect(end_s)
        self._pass_until(now_s)
        return self._arrived(now_s)

    def next_s(self) -> float:
        """Return when ``advance`` has something to do; infinite when only time passes.

        A firmware may take its time to answer, so for 0.1 s after a byte that is every step.
        """
        times = [
            min(queue[-1].end_s, queue[0].end_s + self.options.grain_s)
            for queue in (self._going, self._coming, self._echo)
            if queue
        ]
        if self._zero_s is not None and self.n_steps < self._alert_until:
            times.append(self._zero_s + (self.n_steps + 1) * TICK_S)
        return min(times, default=float("inf"))

    def cut(self) -> None:
        """Lose what is on the wire: it was unplugged."""
        for queue in (self._going, self._coming, self._echo):
            queue.clear()
        self._host_free_s = self._firmware_free_s = float("-inf")

    def _byte_s(self) -> float:
        return _BITS_PER_BYTE / max(self.line_baud, 1) if self.options.is_paced else 0.0

    def _pass_until(self, now_s: float) -> None:
        zero_s = now_s if self._zero_s is None else self._zero_s
        n_wanted = int((now_s - zero_s) / TICK_S + _SLACK_S)
        while self.n_steps < n_wanted:
            self.firmware.step(TICK_S)
            self.n_steps += 1
            self._collect(zero_s + self.n_steps * TICK_S)

    def _collect(self, at_s: float) -> None:
        """Put what the firmware sent by ``at_s`` on the wire."""
        data = self.firmware.replies()
        if not data:
            return
        self._tap.sent(self.n_steps, data)
        is_understood = self.firmware.listen(self.line_baud)
        byte_s = self._byte_s()
        start_s = max(at_s, self._firmware_free_s)
        for value in data:
            byte = _Byte(start_s, start_s + byte_s, value)
            start_s = byte.end_s
            if self.options.is_half_duplex:
                self._collide(byte, self._going)
            if not is_understood:
                byte.value = self._rng.randrange(256)
            self._coming.append(byte)
        self._firmware_free_s = start_s

    def _collide(self, byte: _Byte, others: Deque[_Byte]) -> None:
        """Garble a byte and those of the other side that are on the wire at the same time."""
        for other in others:
            if other.start_s + _SLACK_S < byte.end_s and byte.start_s + _SLACK_S < other.end_s:
                self.n_collisions += 1
                byte.value ^= self._rng.randrange(1, 256)
                other.value ^= self._rng.randrange(1, 256)

    def _arrived(self, now_s: float) -> bytes:
        out = bytearray()
        coming, echo = self._coming, self._echo
        while True:
            first = _earlier(echo, coming)
            if first is None or first[0].end_s > now_s + _SLACK_S:
                return bytes(out)
            out.append(first.popleft().value)


def _earlier(one: Deque[_Byte], other: Deque[_Byte]) -> Optional[Deque[_Byte]]:
    """Return the queue whose first byte ends first, or None when both are empty."""
    if not one or not other:
        return one or other or None
    return one if one[0].end_s <= other[0].end_s else other
