"""Cameras that deliver now: V4L2 devices and HTTP-MJPEG streams, through OpenCV.

The capture time is when the grab returned, less the calibrated latency, never when somebody came
to read the frame.
"""

import time
from pathlib import Path
from typing import Any, Callable, Optional

import cv2

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.grabbing import Clock, GrabbingCamera, Shot, Source
from apex_edge.errors import CameraError

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


class CaptureSource(Source):
    """Grab through OpenCV."""

    def __init__(
        self, config: CameraConfig, clock: Clock, opener: Callable[[CameraConfig], Capture]
    ) -> None:
        """Remember the settings; ``opener`` opens the capture."""
        self._config, self._clock, self._opener = config, clock, opener
        self._capture: Optional[Capture] = None

    def open(self) -> None:
        """Open the device.

        Raises
        ------
        CameraError : it cannot be opened (the message names it and what there is).
        """
        self._capture = self._opener(self._config)
        if not self._capture.isOpened():
            raise CameraError(
                f"camera {self._config.path!r} cannot be opened{_advice(self._config.path)}"
            )

    def grab(self) -> Optional[Shot]:
        """Wait for the next picture.

        Raises
        ------
        CameraError : the device is gone.
        """
        assert self._capture is not None
        try:
            if not self._capture.grab():
                raise CameraError("no more pictures come")
            t_s = self._clock() - self._config.latency_s
            is_decoded, picture = self._capture.retrieve()
        except cv2.error as error:
            raise CameraError(str(error)) from error
        return Shot(t_s, picture if is_decoded else None)

    def close(self) -> None:
        """Release the device."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.release()


class LiveCamera(GrabbingCamera):
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
        clock: Clock = time.monotonic,
        opener: Callable[[CameraConfig], Capture] = open_capture,
    ) -> None:
        """Remember the settings; nothing is opened yet."""
        super().__init__(config, lambda: CaptureSource(config, clock, opener), clock)


def _advice(path: str) -> str:
    if "://" in path:
        return "; is the stream reachable?"
    devices = sorted(str(device) for device in Path("/dev").glob("video*"))
    return f"; devices found: {', '.join(devices)}" if devices else "; no /dev/video* is there"
