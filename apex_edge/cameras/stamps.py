"""Device time stamps -> the capture clock (``time.monotonic``); ours."""

import math
import time
from typing import Callable

MAX_DELAY_S = 1.0
WINDOW_S = 10.0


class CaptureClock:
    """Map the stamps of one device onto the clock that all frames are stamped with.

    Parameters
    ----------
    latency_s : calibrated time from exposure to arrival, taken off where the stamp does not
        already say when the picture was taken.
    wall : the host's time of day, which some SDKs stamp with.
    """

    def __init__(self, latency_s: float, wall: Callable[[], float] = time.time) -> None:
        """Know nothing yet of the device's clock."""
        self._latency_s, self._wall = latency_s, wall
        self._last_s = self._window_end_s = -math.inf
        self._offset_s = self._older_offset_s = math.inf

    def from_wall(self, stamp_s: float, now_s: float, is_arrival: bool) -> float:
        """Map a stamp in the host's time of day.

        Parameters
        ----------
        stamp_s : seconds since the epoch.
        now_s : the capture clock, now.
        is_arrival : the stamp says when the picture came, not when it was taken.
        """
        by_offset_s = self.from_device(stamp_s, now_s)
        delay_s = self._wall() - stamp_s
        # the time of day can be set at any moment, and a recording's is long past
        if not 0.0 <= delay_s <= MAX_DELAY_S:
            return by_offset_s
        return now_s - delay_s - (self._latency_s if is_arrival else 0.0)

    def from_device(self, stamp_s: float, now_s: float) -> float:
        """Map a stamp in the device's own seconds.

        The smallest difference to the arrival seen lately is the offset of the clocks plus the
        least transport time, which the calibrated latency stands for. Ten seconds are short enough
        for two quartzes to agree within a millisecond. A picture that was held up is known by it:
        it does not look fresh.
        """
        offset_s = now_s - stamp_s
        if stamp_s < self._last_s:  # the device's clock started anew
            self._offset_s = self._older_offset_s = math.inf
        elif now_s > self._window_end_s:
            self._older_offset_s, self._offset_s = self._offset_s, math.inf
            self._window_end_s = now_s + WINDOW_S
        self._last_s = stamp_s
        self._offset_s = min(self._offset_s, offset_s)
        return stamp_s + min(self._offset_s, self._older_offset_s) - self._latency_s
