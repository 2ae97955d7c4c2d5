"""Read a stream as vendors' hosts and boards do: byte by byte, trusting the length.

Ours, written after the description of such readers, to be measured beside the parser: it waits for
the header, believes the length byte and collects that many bytes; when the checksum is wrong then,
all of them are gone. Source: behaviour described for the vendors' packet handlers.
"""

from typing import Callable, Dict, List, NamedTuple

_HEADER, _LENGTH, _REST = 0, 1, 2
_MAX_FRAME = 1024  # longer ones are taken for damage at once


class Framing(NamedTuple):
    """Where the length stands, how many bytes it has, and what the whole frame has on top of it."""

    length_at: int
    n_length: int
    n_more: int


FRAMINGS: Dict[str, Framing] = {
    "lx16a": Framing(3, 1, 3),
    "lsc": Framing(2, 1, 2),
    "rrc": Framing(3, 1, 5),
    "sts": Framing(3, 1, 4),
    "dxl2": Framing(5, 2, 7),
}


class ByteMachine:
    """Take bytes in any chunks, give frames whose checksum is right."""

    def __init__(self, header: bytes, framing: Framing, check: Callable[[bytes], bool]) -> None:
        self._header, self._framing, self._check = header, framing, check
        self._state = _HEADER
        self._frame = bytearray()
        self._n_whole = 0

    def feed(self, data: bytes) -> List[bytes]:
        """Take bytes as they come and return the frames they complete."""
        frames: List[bytes] = []
        for byte in data:
            if self._take(byte):
                frame = bytes(self._frame)
                if self._check(frame):
                    frames.append(frame)
                self._frame.clear()
                self._state = _HEADER
        return frames

    def _take(self, byte: int) -> bool:
        """Take one byte; say whether it completes a frame."""
        frame, framing = self._frame, self._framing
        frame.append(byte)
        if self._state == _HEADER:
            if byte != self._header[len(frame) - 1]:
                frame.clear()
            elif len(frame) == len(self._header):
                self._state = _LENGTH
        elif self._state == _LENGTH:
            end = framing.length_at + framing.n_length
            if len(frame) == end:
                length = int.from_bytes(frame[framing.length_at : end], "little")
                self._n_whole = max(length + framing.n_more, end + 1)
                self._state = _REST
                if self._n_whole > _MAX_FRAME:
                    frame.clear()
                    self._state = _HEADER
        return self._state == _REST and len(frame) >= self._n_whole
