"""A link that sends nothing: it keeps the bytes, and shows them to whoever wants to see them.

With a firmware to answer (a simulated one) the whole way up to the session is what it is with a
real arm; without one nothing ever answers.
"""

from typing import Callable, List, Optional, Tuple

from firmware_bridge.errors import LinkLost
from firmware_bridge.links.base import Link
from firmware_bridge.simulator.base import Firmware

_STEP_S = 0.001
Tell = Callable[[float, bytes], None]
"""Called with the time in s and each frame that would have gone out."""


class DryLink(Link):
    """Keep every frame in ``frames`` as (time in s, bytes).

    Parameters
    ----------
    clock : seconds; waiting is left to ``wait``.
    wait : lets time pass on that clock.
    answers : a simulated firmware that hears the frames and answers them.
    tell : called with each frame as it would go out.
    """

    is_dry = True

    def __init__(
        self,
        clock: Callable[[], float],
        wait: Callable[[float], None],
        answers: Optional[Firmware] = None,
        tell: Optional[Tell] = None,
    ) -> None:
        super().__init__("dry run", answers.baud if answers is not None else 0)
        self.frames: List[Tuple[float, bytes]] = []
        self._clock, self._wait = clock, wait
        self._firmware = answers
        self._tell = tell
        self._waiting = bytearray()
        self._is_open = False
        self._t_s = clock()

    @property
    def is_open(self) -> bool:
        """Say whether it is open."""
        return self._is_open

    def open(self) -> None:
        """Open it; there is nothing to fail."""
        self._t_s = self._clock()
        self._is_open = True

    def close(self) -> None:
        """Close it; the frames are kept."""
        self._is_open = False

    def write(self, data: bytes, n_reply: int = 0) -> None:
        """Keep one frame.

        Raises
        ------
        LinkLost : the link is closed.
        """
        self._catch_up()
        self.n_bytes_out += len(data)
        self.frames.append((self._clock(), bytes(data)))
        if self._tell is not None:
            self._tell(self._clock(), bytes(data))
        if self._firmware is not None:
            self._firmware.feed(data)

    def read_available(self) -> bytes:
        """Return what the firmware has answered.

        Raises
        ------
        LinkLost : the link is closed.
        """
        self._catch_up()
        data = bytes(self._waiting)
        self._waiting.clear()
        self.n_bytes_in += len(data)
        return data

    def wait_readable(self, timeout_s: float) -> None:
        """Let time pass until there is an answer or the time is over.

        Raises
        ------
        LinkLost : the link is closed.
        """
        self._catch_up()
        end_s = self._clock() + timeout_s
        while not self._waiting and self._clock() < end_s:
            self._wait(min(_STEP_S, timeout_s))
            self._catch_up()

    def _catch_up(self) -> None:
        if not self._is_open:
            raise LinkLost("dry run: the link is not open")
        now_s = self._clock()
        if self._firmware is not None:
            if now_s > self._t_s:
                self._firmware.step(now_s - self._t_s)
            self._waiting += self._firmware.replies()
        self._t_s = now_s
