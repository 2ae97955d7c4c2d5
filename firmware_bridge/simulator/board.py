"""What simulated boards and buses of LX servos share: a parser, answers, silence, time.

Pure: no clock, no I/O. A frame left unfinished for 5 ms is given up (the time-outs of real firmware
are not published).
"""

from abc import abstractmethod
from typing import Iterable, List

from firmware_bridge.codec.parser import Parser
from firmware_bridge.errors import ProtocolError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.servo import SimServo

_SILENCE_S = 0.005


class Board(Firmware):
    """Bytes in, checked frames to ``obey``, answers out.

    Counts: ``n_frames`` well formed, ``n_bad`` dropped for their checksum, ``n_rejected`` without
    sense, ``n_clamped`` targets out of range.

    Parameters
    ----------
    servos : all that it moves.
    parser : of what the host sends.
    baud : of the line; at another it hears nothing.
    """

    def __init__(self, servos: Iterable[SimServo], parser: Parser, baud: int) -> None:
        self.servos: List[SimServo] = list(servos)
        self.baud = baud
        self.t_s = 0.0
        self.n_rejected = 0
        self.n_clamped = 0
        self._parser = parser
        self._out = bytearray()
        self._silent_s = 0.0
        self._is_understood = True

    @property
    def n_frames(self) -> int:
        """Well-formed frames taken so far."""
        return self._parser.n_frames

    @property
    def n_bad(self) -> int:
        """Frames dropped for their checksum."""
        return self._parser.n_bad

    def listen(self, baud: int) -> bool:
        """Take the line to be at ``baud`` from now on; say whether it is the own one."""
        self._is_understood = baud == self.baud
        return self._is_understood

    def feed(self, data: bytes) -> None:
        """Take bytes from the wire, in any chunks."""
        self._silent_s = 0.0
        if self._is_understood:
            self._take(self._parser.feed(data))

    def replies(self) -> bytes:
        """Return and forget the bytes that have been sent."""
        data = bytes(self._out)
        self._out.clear()
        return data

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass."""
        self.t_s += dt_s
        for servo in self.servos:
            servo.step(dt_s)
        before = self._silent_s
        self._silent_s += dt_s
        if before < _SILENCE_S <= self._silent_s:
            self._take(self._parser.flush())

    @abstractmethod
    def obey(self, frame: bytes) -> None:
        """Carry out a checked frame.

        Raises
        ------
        ProtocolError : it makes no sense.
        """

    def answer(self, frame: bytes) -> None:
        """Send a frame."""
        self._out += frame

    def _take(self, frames: Iterable[bytes]) -> None:
        for frame in frames:
            try:
                self.obey(frame)
            except ProtocolError:
                self.n_rejected += 1
