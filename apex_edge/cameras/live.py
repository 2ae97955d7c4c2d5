"""Cameras that deliver now: V4L2 devices and HTTP-MJPEG streams, through OpenCV.

A thread grabs; the newest frame wins. The capture time is when the grab returned, less the
calibrated latency, never when somebody came to read the frame.
"""

import logging
import threading
import time
from pathlib import Path
from typing import Any, Callable, Optional

import cv2

from apex_edge.cameras.base import Camera, CameraConfig, NewestSlot
from apex_edge.cameras.calibration import check_size, load_camera
from apex_edge.cameras.playback import is_same_picture
from apex_edge.errors import CameraError
from apex_edge.types import Array, CameraModel, Frame

LOG = logging.getLogger(__name__)

Capture = Any
"""What cv2.VideoCapture offers: isOpened, set, get, grab, retrieve, release."""


def open_capture(config: CameraConfig) -> Capture:
    """Open the V4L2 index or device, or the URL, that the settings name, as OpenCV's capture."""
    if "://" in config.path:
        wait_ms = int(config.timeout_s * 1000)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, wait_ms, cv2.CAP_PROP_READ_TIMEOUT_MSEC, wait_ms]
        return cv2.VideoCapture(config.path, cv2.CAP_FFMPEG, limits)
    if config.path.isdecimal():
        capture = cv2.VideoCapture(int(config.path), cv2.CAP_V4L2)
    else:
        capture = cv2.VideoCapture(config.path, cv2.CAP_V4L2)
    if capture.isOpened():
        # MJPG first: raw YUYV over USB 2 does not reach 30 Hz at 640x480 on many cameras
        capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        capture.set(cv2.CAP_PROP_FRAME_WIDTH, config.width)
        capture.set(cv2.CAP_PROP_FRAME_HEIGHT, config.height)
        capture.set(cv2.CAP_PROP_FPS, config.fps)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
    return capture


class LiveCamera(Camera):
    """Read a live camera.

    Parameters
    ----------
    config : ``path`` is an index ("0"), a device ("/dev/video0") or a URL ("http://...").
    clock : the capture clock in seconds.
    opener : opens the capture; replaced in tests.
    """

    type = "live"

    def __init__(
        self,
        config: CameraConfig,
        clock: Callable[[], float] = time.monotonic,
        opener: Callable[[CameraConfig], Capture] = open_capture,
    ) -> None:
        """Remember the settings; nothing is opened yet."""
        super().__init__()
        self._config, self._clock, self._opener = config, clock, opener
        self._model: Optional[CameraModel] = None
        self._slot = NewestSlot(self._stats)
        self._thread: Optional[threading.Thread] = None
        self._stop = threading.Event()

    def open(self) -> None:
        """Open the device and start grabbing.

        Raises
        ------
        CameraError : the device cannot be opened (the message names it and what there is).
        CalibrationError : the calibration file cannot be used.
        """
        self.close()
        if self._config.calibration:
            self._model = load_camera(self._config.calibration)
        capture = self._opener(self._config)
        if not capture.isOpened():
            capture.release()
            raise CameraError(
                f"camera {self._config.path!r} cannot be opened{_advice(self._config.path)}"
            )
        self._stop = threading.Event()
        self._slot = NewestSlot(self._stats, self._config.max_age_s, self._clock)
        self._thread = threading.Thread(
            target=self._grab, args=(capture, self._slot, self._stop), name="camera", daemon=True
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
            raise CameraError(f"camera {self._config.path!r} is not open")
        frame = self._slot.get(timeout_s)
        if frame is None:
            why = "was lost" if self._slot.is_closed else f"sent no fresh frame for {timeout_s:g} s"
            raise CameraError(f"camera {self._config.path!r} {why}")
        if self._model is not None:
            check_size(self._model, frame.colour_bgr, self._config.path)
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
            LOG.warning("camera %r does not return from its driver", self._config.path)

    def _grab(self, capture: Capture, slot: NewestSlot, stop: threading.Event) -> None:
        """Grab until told to stop or the device is gone; runs in the camera's thread."""
        seq = 0
        last: Optional[Array] = None
        try:
            while not stop.is_set() and capture.grab():
                t_s = self._clock() - self._config.latency_s
                is_decoded, picture = capture.retrieve()
                if not is_decoded or picture is None:
                    self._stats.grabbed += 1
                    self._stats.dropped += 1
                    continue
                is_repeated = is_same_picture(last, picture)
                slot.put(Frame(seq, t_s, picture, None, self._model, is_repeated))
                last = picture
                seq += 1
        except cv2.error as error:
            LOG.error("camera %r: %s", self._config.path, error)
        finally:
            slot.close()
            # here and not in close(): releasing under a running grab crashes some drivers
            capture.release()


def _advice(path: str) -> str:
    if "://" in path:
        return "; is the stream reachable?"
    devices = sorted(str(device) for device in Path("/dev").glob("video*"))
    return f"; devices found: {', '.join(devices)}" if devices else "; no /dev/video* is there"
