"""Make a screen blink in front of a camera and note when; what the camera saw becomes a series.

The time noted is when the terminal was given the picture. How long the terminal and the display
take to show it is not known here, so a latency from a screen includes both. Source: ours.
"""

import sys
from typing import Callable, List, TextIO, Tuple

import cv2
import numpy as np

from apex_edge.cameras.base import Camera
from apex_edge.errors import CalibrationError
from apex_edge.types import Array

Clock = Callable[[], float]
Series = Tuple[Array, Array]
_SMALL_PX = (48, 36)
_SHARE = 0.1  # of the picture's cells, the ones that change most: the screen need not fill it
_CLEAR, _WHITE, _BLACK, _RESET = "\x1b[2J\x1b[H", "\x1b[107m", "\x1b[40m", "\x1b[0m"


class Terminal:
    """A terminal whose whole window turns white or black."""

    def __init__(self, stream: TextIO = sys.stdout) -> None:
        self._stream = stream

    def show(self, is_white: bool) -> None:
        """Fill the window."""
        self._stream.write((_WHITE if is_white else _BLACK) + _CLEAR)
        self._stream.flush()

    def restore(self) -> None:
        """Give the window its own colours back."""
        self._stream.write(_RESET + _CLEAR)
        self._stream.flush()


def watch(
    camera: Camera,
    show: Callable[[bool], None],
    rng: np.random.RandomState,
    clock: Clock,
    sleep: Callable[[float], None],
    seconds: float,
    patience_s: float = 2.0,
) -> Tuple[Series, Series]:
    """Blink at random intervals and watch; returns the signal and the response for ``solve``.

    Parameters
    ----------
    camera : open; its frames must be stamped on ``clock``.
    show : makes the blinker white or black.
    rng : of the intervals, 0.3 to 0.8 s.

    Raises
    ------
    CameraError : no picture. CalibrationError : the camera ended before the time was up.
    """
    events: List[Tuple[float, float]] = []
    stamps, small = [], []
    start_s = due_s = clock()
    is_white = False
    while clock() - start_s < seconds:
        frame = camera.read(patience_s)
        if frame is None:
            raise CalibrationError("the camera's pictures ended before the time was up")
        stamps.append(frame.t_s)
        grey = cv2.cvtColor(frame.colour_bgr, cv2.COLOR_BGR2GRAY)
        small.append(cv2.resize(grey, _SMALL_PX, interpolation=cv2.INTER_AREA).ravel())
        if clock() >= due_s:
            # not always just after a picture: within a frame period every moment must occur
            sleep(float(rng.uniform(0.0, 0.03)))
            is_white = not is_white
            events.append((clock(), float(is_white)))
            show(is_white)
            due_s = clock() + float(rng.uniform(0.3, 0.8))
    signal = np.array(events, dtype=np.float64).reshape(-1, 2)
    return (signal[:, 0], signal[:, 1]), (np.array(stamps), brightness(np.array(small)))


def brightness(cells: Array) -> Array:
    """Return the mean (n,) of the cells (n, c) that change most and change together."""
    values = np.asarray(cells, dtype=np.float64)
    swing = values.std(axis=0)
    chosen = swing >= np.quantile(swing, 1.0 - _SHARE)
    result: Array = values[:, chosen].mean(axis=1)
    return result
