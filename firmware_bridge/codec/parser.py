"""Find intact frames in a byte stream with garbage, cuts and flipped bits in it.

Every header in the stream is judged by itself, whether or not it stands inside a frame that was
accepted already. So an intact frame is always delivered, whatever stands around it: no byte before
it can swallow it, neither a bad length (vendors' byte machines lose up to 57 % of the intact frames
then) nor a cut frame that passes its checksum together with the start of the next (once in 256).

The price: a cut frame that passes is delivered beside the intact one. Telling them apart is not
decidable from the bytes: both are well formed, and either may be the one that was sent. Who reads
must match frames to questions anyway. In undamaged traffic nothing is added unless a payload holds
header, length and checksum of another frame. Source: ours.
"""

from typing import Callable, List

NEEDS_MORE, IMPOSSIBLE = 0, -1

Measure = Callable[[bytearray, int], int]
"""(buffer, start of a header) -> bytes of the whole frame, NEEDS_MORE or IMPOSSIBLE."""
Check = Callable[[bytes], bool]
"""Whole frame -> is its checksum right (True where there is none)."""


class Parser:
    """Take bytes in any chunks, give whole checked frames.

    Holds back less than one frame. ``n_frames``, ``n_bad`` (failed checks) and ``n_skipped`` (bytes
    that belong to no accepted frame) count what went by.

    Parameters
    ----------
    header : the bytes every frame starts with; where there are none, frames follow one another.
    measure, check : see ``Measure`` and ``Check``.
    """

    def __init__(self, header: bytes, measure: Measure, check: Check) -> None:
        self.header, self.measure, self.check = header, measure, check
        self._buffer = bytearray()
        self._done = 0  # bytes at the front that belong to an accepted frame
        self.n_frames = 0
        self.n_bad = 0
        self.n_skipped = 0

    @property
    def n_held(self) -> int:
        """Bytes held back."""
        return len(self._buffer)

    def feed(self, data: bytes) -> List[bytes]:
        """Take bytes as they come and return the frames they complete."""
        self._buffer += data
        return self._scan(is_final=False)

    def flush(self) -> List[bytes]:
        """Give up on an unfinished frame (the line fell silent); return what stood behind it."""
        return self._scan(is_final=True)

    def _scan(self, is_final: bool) -> List[bytes]:
        buffer, header, measure, check = self._buffer, self.header, self.measure, self.check
        frames: List[bytes] = []
        at, done, n_all = 0, self._done, len(buffer)
        while True:
            start = buffer.find(header, at)
            if start < 0 or start == n_all:  # the latter where frames have no header
                at = max(at, n_all - (0 if is_final else self._n_partial()))
                break
            at = start + 1
            n_frame = measure(buffer, start)
            end = start + n_frame
            if n_frame == NEEDS_MORE or end > n_all:
                if not is_final:
                    at = start
                    break
            elif n_frame > 0:
                frame = bytes(buffer[start:end])
                if check(frame):
                    frames.append(frame)
                    self.n_skipped += max(start - done, 0)
                    done = max(done, end)
                    if not header:  # nothing tells a frame inside from its values
                        at = end
                else:
                    self.n_bad += 1
        self.n_skipped += max(at - done, 0)
        del buffer[:at]
        self._done = max(done - at, 0)
        self.n_frames += len(frames)
        return frames

    def _n_partial(self) -> int:
        """Return how many bytes at the end may be the start of a header."""
        buffer, header = self._buffer, self.header
        for n in range(min(len(header) - 1, len(buffer)), 0, -1):
            if buffer.endswith(header[:n]):
                return n
        return 0
