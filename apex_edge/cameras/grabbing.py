"""What all live cameras share: a thread that grabs, the newest frame wins, a lost device is said.

A driver is a ``Source``: it opens its device and hands out shots, each with the time at which it
was taken on the capture clock. Everything else (the thread, the slot, counters, calibration) is
here, once.
"""

import logging
import threading
import time
from abc import ABC, abstractmethod
from contextlib import ExitStack
from typing import Callable, ClassVar, NamedTuple, Optional

from apex_edge.cameras.base import Camera, CameraConfig, NewestSlot
from apex_edge.cameras.calibration import check_size, load_camera
from apex_edge.cameras.playback import is_same_picture
from apex_edge.cameras.sdk import Sdk
from apex_edge.errors import CameraError
from apex_edge.types import Array, CameraModel, Frame, Intrinsics

LOG = logging.getLogger(__name__)

Clock = Callable[[], float]
MAX_FOCAL_CHANGE = 0.02
WAIT_S = 0.2
"""A source waits this long for its device before it lets the thread look whether to stop."""


class Shot(NamedTuple):
    """One picture of a device: ``colour_bgr (h, w, 3)`` uint8, ``depth_mm (h, w)`` uint16 on it.

    ``t_s`` is when it was taken, on the capture clock. ``colour_bgr`` is None for a frame that came
    but cannot be used; it is counted as dropped.
    """

    t_s: float
    colour_bgr: Optional[Array]
    depth_mm: Optional[Array] = None


class Source(ABC):
    """One opened device; used by a single thread after ``open``."""

    @abstractmethod
    def open(self) -> None:
        """Open the device.

        Raises
        ------
        CameraError : its driver is not installed, or the device cannot be opened.
        """

    @abstractmethod
    def grab(self) -> Optional[Shot]:
        """Return the newest shot; None when none came within ``WAIT_S``.

        Raises
        ------
        CameraError : the device is gone.
        """

    @property
    def intrinsics(self) -> Optional[Intrinsics]:
        """Return the lens as the maker measured it; None when the device does not know."""
        return None

    @abstractmethod
    def close(self) -> None:
        """Release the device; also after an ``open`` that failed, and twice."""


class GrabbingCamera(Camera):
    """Read a live device through its source.

    Parameters
    ----------
    config : picture, limits and calibration.
    make_source : makes a fresh source for each ``open``.
    clock : the capture clock in seconds.
    """

    is_live = True
    sdk: ClassVar[Optional[Sdk]] = None
    """The maker's package that this type needs."""

    def __init__(
        self,
        config: CameraConfig,
        make_source: Callable[[], Source],
        clock: Clock = time.monotonic,
    ) -> None:
        super().__init__()
        self._config, self._make_source, self._clock = config, make_source, clock
        self._name = f"camera {config.path!r}" if config.path else f"camera of type {config.type!r}"
        self._model: Optional[CameraModel] = None
        self._intrinsics: Optional[Intrinsics] = None
        self._slot = NewestSlot(self._stats)
        self._thread: Optional[threading.Thread] = None
        self._stop = threading.Event()
        self._why_lost = ""

    @property
    def intrinsics(self) -> Optional[Intrinsics]:
        """Return the maker's lens figures once open, where the device knows them."""
        return self._intrinsics

    def open(self) -> None:
        """Open the device and start grabbing.

        Raises
        ------
        CameraError : the driver is not installed or the device cannot be opened.
        CalibrationError : the calibration file cannot be used.
        """
        self.close()
        self._why_lost = ""
        self._model = load_camera(self._config.calibration) if self._config.calibration else None
        source = self._make_source()
        with ExitStack() as undo:
            undo.callback(source.close)
            source.open()
            self._intrinsics = source.intrinsics
            undo.pop_all()
        self._compare_lens()
        self._stop = threading.Event()
        self._slot = NewestSlot(self._stats, self._config.max_age_s, self._clock)
        self._thread = threading.Thread(
            target=self._grab, args=(source, self._slot, self._stop), name="camera", daemon=True
        )
        self._thread.start()

    def read(self, timeout_s: float) -> Optional[Frame]:
        """Return the newest frame that is not stale, waiting for one.

        Raises
        ------
        CameraError : nothing fresh within ``timeout_s``, or the device is gone.
        CalibrationError : the calibration is for another picture size.
        """
        if self._thread is None:
            raise CameraError(f"{self._name} is not open")
        frame = self._slot.get(timeout_s)
        if frame is None:
            why = f"sent no fresh frame for {timeout_s:g} s"
            if self._slot.is_closed:
                why = f"was lost{self._why_lost}"
            raise CameraError(f"{self._name} {why}")
        if self._model is not None:
            check_size(self._model, frame.colour_bgr, self._name)
        return frame

    def close(self) -> None:
        """Stop grabbing and release the device."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._stop.set()
        self._slot.close()
        thread.join(self._config.timeout_s)
        if thread.is_alive():
            LOG.warning("%s does not return from its driver", self._name)

    def _grab(self, source: Source, slot: NewestSlot, stop: threading.Event) -> None:
        """Grab until told to stop or the device is gone; runs in the camera's thread."""
        seq = 0
        last: Optional[Array] = None
        silent_since_s: Optional[float] = None
        try:
            while not stop.is_set():
                shot = source.grab()
                if shot is None:
                    silent_since_s = self._check_silence(silent_since_s)
                    continue
                silent_since_s = None
                if shot.colour_bgr is None:
                    self._stats.grabbed += 1
                    self._stats.dropped += 1
                    continue
                is_repeated = is_same_picture(last, shot.colour_bgr)
                last = shot.colour_bgr
                slot.put(Frame(seq, shot.t_s, last, shot.depth_mm, self._model, is_repeated))
                seq += 1
        except CameraError as error:
            if not stop.is_set():
                self._why_lost = f": {error}"
                LOG.error("%s was lost: %s", self._name, error)
        finally:
            slot.close()
            # here and not in close(): releasing under a running grab crashes some drivers
            source.close()

    def _check_silence(self, since_s: Optional[float]) -> float:
        """Return since when the device has been silent; raise when that is too long."""
        now_s = self._clock()
        if since_s is None:
            return now_s
        if now_s - since_s > self._config.timeout_s:
            raise CameraError(
                f"it sent nothing for {self._config.timeout_s:g} s; is it plugged in?"
            )
        return since_s

    def _compare_lens(self) -> None:
        """Warn when the calibration is for another lens, or another zoom, than the device has."""
        model, lens = self._model, self._intrinsics
        if model is None or lens is None:
            return
        change = max(abs(model.fx_px / lens.fx_px - 1.0), abs(model.fy_px / lens.fy_px - 1.0))
        if change > MAX_FOCAL_CHANGE:
            LOG.warning(
                "%s: the focal length of %s (%.1f px) is %.1f %% off what the device says "
                "(%.1f px); is it the calibration of another camera or picture size?",
                self._name,
                self._config.calibration,
                model.fx_px,
                100.0 * change,
                lens.fx_px,
            )
