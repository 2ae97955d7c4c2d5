"""What every frame source has in common: the interface, its counters and the newest-wins slot."""

import math
import threading
import time
from abc import ABC, abstractmethod
from dataclasses import dataclass
from types import TracebackType
from typing import Callable, ClassVar, Optional, Type, TypeVar

from apex_edge.config import setting
from apex_edge.types import Frame, Intrinsics

Self = TypeVar("Self", bound="Camera")


@dataclass(frozen=True)
class CameraConfig:
    """Section ``[camera]`` of the settings file."""

    type: str = setting(
        "twin",
        "name of a registered camera: twin; mcap, video, folder (recordings); live (V4L2 or HTTP), "
        "realsense, oak, orbbec, picamera2; board (simulated, for calibration)",
    )
    path: str = setting(
        "",
        "file or folder; V4L2 index, device or HTTP-MJPEG URL; serial number of a depth camera "
        "(empty: the first found); number of a Pi camera",
    )
    calibration: str = setting("", "camera calibration JSON; empty means what the source carries")
    width: int = setting(640, "requested picture width (px), live cameras", 16, 8192)
    height: int = setting(480, "requested picture height (px), live cameras", 16, 8192)
    fps: float = setting(30.0, "requested or assumed frame rate (Hz)", 0.1, 1000.0)
    latency_s: float = setting(
        0.0, "calibrated time from exposure to arrival (s), for stamps of arrival", 0.0, 2.0
    )
    max_age_s: float = setting(0.2, "a live frame older than this is stale (s)", 0.001, 10.0)
    timeout_s: float = setting(
        2.0, "a live camera silent for this long has stalled (s)", 0.05, 60.0
    )


@dataclass
class CameraStats:
    """Count what became of the frames.

    ``grabbed`` came from the source, ``delivered`` went to the reader, ``dropped`` were replaced
    by a newer one before anyone read them (or could not be decoded), ``repeated`` had exactly
    the pixels of the frame before, ``stale`` were too old to be handed out.
    """

    grabbed: int = 0
    delivered: int = 0
    dropped: int = 0
    repeated: int = 0
    stale: int = 0


class Camera(ABC):
    """A source of frames; ours.

    Use it as a context manager or call ``open`` and ``close``. ``close`` may be called twice.
    """

    type: ClassVar[str] = ""
    is_live: ClassVar[bool] = False
    """Shows what is there now, so that a real arm may move for it."""

    def __init__(self) -> None:
        """Start with all counters at zero."""
        self._stats = CameraStats()

    @property
    def stats(self) -> CameraStats:
        """Return the counters so far (a live object, not a copy)."""
        return self._stats

    @property
    def intrinsics(self) -> Optional[Intrinsics]:
        """Return the lens as the maker measured it; None when the source does not say."""
        return None

    @abstractmethod
    def open(self) -> None:
        """Make the source ready to read.

        Raises
        ------
        CameraError : a live device cannot be opened.
        RecordingError : a file or folder cannot be read.
        """

    @abstractmethod
    def read(self, timeout_s: float) -> Optional[Frame]:
        """Return the next frame, or None at the end of a finite source.

        Raises
        ------
        CameraError : a live source delivered nothing for ``timeout_s``.
        RecordingError : a recording is damaged from here on.
        """

    @abstractmethod
    def close(self) -> None:
        """Release the source."""

    def __enter__(self: Self) -> Self:
        """Open the source."""
        self.open()
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """Close the source whatever happened."""
        self.close()


def is_stale(frame: Frame, now_s: float, max_age_s: float) -> bool:
    """Say whether a frame is too old to act on; times on the capture clock."""
    # written so that a NaN time counts as stale
    return not now_s - frame.t_s <= max_age_s


class NewestSlot:
    """Hand the newest frame from one thread to another.

    A frame put while the last one is unread replaces it (counted as dropped); a frame is handed
    out once, and never when it is older than ``max_age_s`` (counted as stale). Both ends may wait
    and close at any time.
    """

    def __init__(
        self,
        stats: Optional[CameraStats] = None,
        max_age_s: float = math.inf,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Count into ``stats`` (its own when none is given); ``clock`` is the capture clock."""
        self.stats = stats if stats is not None else CameraStats()
        self._max_age_s, self._clock = max_age_s, clock
        self._ready = threading.Condition()
        self._frame: Optional[Frame] = None
        self._is_closed = False

    @property
    def is_closed(self) -> bool:
        """Say whether no frame will come any more."""
        with self._ready:
            return self._is_closed

    def put(self, frame: Frame) -> None:
        """Offer a frame; after ``close`` it is ignored."""
        with self._ready:
            if self._is_closed:
                return
            self.stats.grabbed += 1
            self.stats.repeated += int(frame.is_repeated)
            if self._frame is not None:
                self.stats.dropped += 1
            self._frame = frame
            self._ready.notify()

    def get(self, timeout_s: float) -> Optional[Frame]:
        """Take the newest frame; None after waiting ``timeout_s``, or when closed and empty."""
        with self._ready:
            self._ready.wait_for(lambda: self._has_fresh() or self._is_closed, timeout_s)
            frame, self._frame = self._frame, None
            if frame is not None:
                self.stats.delivered += 1
            return frame

    def close(self) -> None:
        """Wake every waiter; an unread frame can still be taken."""
        with self._ready:
            self._is_closed = True
            self._ready.notify_all()

    def _has_fresh(self) -> bool:
        if self._frame is None:
            return False
        if is_stale(self._frame, self._clock(), self._max_age_s):
            self.stats.stale += 1
            self._frame = None
        return self._frame is not None
