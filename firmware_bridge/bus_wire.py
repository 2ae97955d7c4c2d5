"""The way onto the line: one frame at a time, and an urgent one before everything else."""

import threading
import time
from typing import Callable, Sequence

from firmware_bridge.links.base import Link

Clock = Callable[[], float]
_GIVE_WAY_S = 0.0001
_TURN_ROUND_S = 0.0005  # a servo's own delay before it answers


class Wire:
    """Write frames to a link in step with its baud rate, from any thread.

    An urgent list goes out from the thread, or the signal handler, that calls: it waits for the
    one frame that is on its way and for nothing else, least of all for another thread to be woken.
    ``n_urgent`` counts them, so that others see that they were overtaken.

    Parameters
    ----------
    byte_s : time of one byte on the line.
    slack_s : how late an answer may be.
    is_half_duplex : an answer and a frame at once destroy each other.
    """

    def __init__(
        self, link: Link, clock: Clock, byte_s: float, slack_s: float, is_half_duplex: bool
    ) -> None:
        self._link = link
        self._clock = clock
        self._byte_s = byte_s
        self._slack_s = slack_s
        self._is_half_duplex = is_half_duplex
        self._lock = threading.RLock()  # a signal handler may stop while its own thread writes
        self._counting = threading.RLock()
        self._n_wanted = 0
        self._answer_in_s = float("-inf")  # when an undisturbed answer is in, if one is due
        self.n_urgent = 0
        self.is_latched = False

    def put(self, frame: bytes, n_reply: int, check: Callable[[], None]) -> float:
        """Write one frame as soon as the line is free; return when an undisturbed answer is in.

        Parameters
        ----------
        n_reply : bytes that are expected back.
        check : called at the last moment; what it raises keeps the frame from going out.
        """
        while True:
            left_s = self._link.idle_in_s()
            if left_s > 0.0 or self._n_wanted:
                check()
                time.sleep(left_s if left_s > 0.0 else _GIVE_WAY_S)
                continue
            with self._lock:
                check()
                if self._link.idle_in_s() <= 0.0 and not self._n_wanted:
                    in_s = self._clock() + (len(frame) + n_reply) * self._byte_s
                    if n_reply:
                        self._answer_in_s = in_s
                    self._link.write(frame, n_reply)
                    return in_s

    def expect_nothing(self) -> None:
        """Say that no answer is due any more."""
        self._answer_in_s = float("-inf")

    def urgent(self, frames: Sequence[bytes], is_latched: bool) -> float:
        """Write frames before everything else; return when their last byte has left.

        Where an answer was due on a half-duplex line the two may have destroyed each other, so
        that the frames go out again when the answer should be over, and once more when it must be;
        the time returned is that of the first.

        Raises
        ------
        LinkLost : the link is closed or went away; a latch is set all the same.
        """
        with self._counting:
            self.is_latched = self.is_latched or is_latched
            self.n_urgent += 1
            self._n_wanted += 1
        try:
            with self._lock:
                in_s = self._answer_in_s
                is_due = in_s + self._slack_s > self._clock() and self._is_half_duplex
                sent_s = self._put_all(frames)
                for over_s in (in_s + _TURN_ROUND_S, in_s + self._slack_s) if is_due else ():
                    time.sleep(max(over_s - self._clock(), 0.0))
                    self._put_all(frames)
                return sent_s
        finally:
            with self._counting:
                self._n_wanted -= 1

    def release(self) -> None:
        """Open the latch."""
        with self._counting:
            self.is_latched = False

    def _put_all(self, frames: Sequence[bytes]) -> float:
        for frame in frames:
            left_s = self._link.idle_in_s()
            while left_s > 0.0:
                time.sleep(left_s)
                left_s = self._link.idle_in_s()
            self._link.write(frame)
        return self._clock() + self._link.idle_in_s()
