"""Cut a stream of bytes where its frames end, without judging or losing any byte.

Line faults hit frames, so they need to know where a frame starts and ends; unlike a parser this
also passes on what is no frame.
"""

from typing import Dict, List, NamedTuple


class Shape(NamedTuple):
    """Where a protocol's frames keep their length and, in answers, the servo's id.

    A frame has ``length + n_around`` bytes; ``id_at`` counts from its first byte.
    """

    header: bytes
    length_at: int
    n_length: int
    n_around: int
    id_at: int


SHAPES: Dict[str, Shape] = {
    "lx16a": Shape(b"\x55\x55", 3, 1, 3, 2),
    "lsc": Shape(b"\x55\x55", 2, 1, 2, 5),
    "lsc-pwm": Shape(b"\x55\x55", 2, 1, 2, 5),
    "rrc": Shape(b"\xaa\x55", 3, 1, 5, 4),
    "rrc-bus": Shape(b"\xaa\x55", 3, 1, 5, 4),
    "sts": Shape(b"\xff\xff", 3, 1, 4, 2),
    "dxl2": Shape(b"\xff\xff\xfd\x00", 5, 2, 7, 4),
}


class Cutter:
    """Take bytes in any chunks, give pieces: whole frames, or bytes that belong to none."""

    def __init__(self, shape: Shape) -> None:
        self._shape = shape
        self._held = bytearray()

    def feed(self, data: bytes) -> List[bytes]:
        """Take bytes and return the pieces they complete; all pieces together are the stream."""
        self._held += data
        pieces: List[bytes] = []
        while self._held:
            n_bytes = self._n_first()
            if n_bytes == 0:
                break
            pieces.append(bytes(self._held[:n_bytes]))
            del self._held[:n_bytes]
        return pieces

    def flush(self) -> bytes:
        """Return the unfinished frame: the line fell silent."""
        rest = bytes(self._held)
        self._held.clear()
        return rest

    def _n_first(self) -> int:
        """Return the length of the first piece, 0 while it is not complete."""
        held, shape = self._held, self._shape
        start = held.find(shape.header)
        if start > 0:
            return start
        if start < 0:
            n_kept = len(shape.header) - 1
            while n_kept and not held.endswith(shape.header[:n_kept]):
                n_kept -= 1
            return len(held) - n_kept
        length_end = shape.length_at + shape.n_length
        if len(held) < length_end:
            return 0
        length = int.from_bytes(held[shape.length_at : length_end], "little")
        n_bytes = max(length + shape.n_around, length_end)
        return n_bytes if n_bytes <= len(held) else 0
