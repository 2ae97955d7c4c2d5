"""Luxonis OAK-D depth cameras, through depthai 2.

Colour comes from the ISP at 1080p, scaled down; stereo depth is aligned to it on the device, and
the device pairs the two. The stamp is the middle of the exposure on depthai's host clock, which is
``time.monotonic`` (it counts the same steady clock, and the device is kept in step with it).
"""

import time
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta
from typing import Any, Optional

import numpy as np

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.grabbing import WAIT_S, Clock, GrabbingCamera, Shot, Source
from apex_edge.cameras.lens import from_opencv, plain_lens
from apex_edge.cameras.sdk import Sdk, load
from apex_edge.errors import CameraError
from apex_edge.types import Intrinsics

SDK = Sdk(
    module="depthai",
    install="depthai>=2.24,<3",
    machines=("x86_64", "aarch64", "armv7l"),
    least_python=(3, 7),
    otherwise="build depthai 2 from source, or use Python 3.7 to 3.11",
)
STREAM = "rgbd"
SCALES = ((1, 3), (1, 2), (2, 3), (1, 1))
"""Of 1920x1080: 640x360, 960x540, 1280x720, whole."""


def scale_for(width_px: int) -> Any:
    """Return the scale (numerator, denominator) whose width is nearest to the one asked for."""
    return min(SCALES, key=lambda s: abs(1920 * s[0] // s[1] - width_px))


def build_pipeline(dai: Any, config: CameraConfig) -> Any:
    """Describe to the device what it is to do: colour, stereo aligned to it, pairs."""
    numerator, denominator = scale_for(config.width)
    pipeline = dai.Pipeline()
    colour = pipeline.create(dai.node.ColorCamera)
    colour.setBoardSocket(dai.CameraBoardSocket.CAM_A)
    colour.setResolution(dai.ColorCameraProperties.SensorResolution.THE_1080_P)
    colour.setIspScale(numerator, denominator)
    colour.setFps(config.fps)
    stereo = pipeline.create(dai.node.StereoDepth)
    for socket, entry in (
        (dai.CameraBoardSocket.CAM_B, stereo.left),
        (dai.CameraBoardSocket.CAM_C, stereo.right),
    ):
        mono = pipeline.create(dai.node.MonoCamera)
        mono.setBoardSocket(socket)
        mono.setResolution(dai.MonoCameraProperties.SensorResolution.THE_400_P)
        mono.setFps(config.fps)
        mono.out.link(entry)
    # depth of one eye that the other confirms; the rest are holes
    stereo.setLeftRightCheck(True)
    stereo.setSubpixel(True)
    stereo.setDepthAlign(dai.CameraBoardSocket.CAM_A)
    stereo.setOutputSize(1920 * numerator // denominator, 1080 * numerator // denominator)
    pairs = pipeline.create(dai.node.Sync)
    pairs.setSyncThreshold(timedelta(seconds=0.5 / config.fps))
    colour.isp.link(pairs.inputs["colour"])
    stereo.depth.link(pairs.inputs["depth"])
    out = pipeline.create(dai.node.XLinkOut)
    out.setStreamName(STREAM)
    pairs.out.link(out.input)
    return pipeline


def read_pair(dai: Any, pair: Any) -> Shot:
    """Return the shot in a message group of the pipeline."""
    colour, depth = pair["colour"], pair["depth"]
    taken = colour.getTimestamp(dai.CameraExposureOffset.MIDDLE)
    # depth is in mm already; copied: the buffer belongs to the message
    return Shot(taken.total_seconds(), colour.getCvFrame(), np.array(depth.getFrame()))


class OakSource(Source):
    """Grab pairs from the device's queue."""

    def __init__(self, config: CameraConfig, clock: Clock) -> None:
        """Remember the settings; the SDK is imported by ``open``."""
        self._config, self._clock = config, clock
        self._dai: Any = None
        self._device: Any = None
        self._queue: Any = None
        self._lens: Optional[Intrinsics] = None

    def open(self) -> None:
        """Boot the device, which takes some seconds.

        Raises
        ------
        CameraError : depthai is not installed or not version 2, or no such device.
        """
        dai, path = load(SDK, "oak"), self._config.path
        if not hasattr(dai.node, "XLinkOut") or not hasattr(dai.node, "Sync"):
            raise CameraError(
                f"depthai {dai.__version__} is installed, but camera type 'oak' needs {SDK.install}"
            )
        pipeline = build_pipeline(dai, self._config)
        try:
            which = (dai.DeviceInfo(path),) if path else ()
            self._device = dai.Device(pipeline, *which)
            # one place, never blocking: the newest pair wins on the way out of the device too
            self._queue = self._device.getOutputQueue(STREAM, 1, False)
            self._lens = _lens(dai, self._device, scale_for(self._config.width))
        except RuntimeError as error:
            raise CameraError(f"OAK camera {path!r} cannot be opened: {error}") from error
        self._dai = dai

    @property
    def intrinsics(self) -> Optional[Intrinsics]:
        """Return the colour camera's lens, as the maker stored it on the device."""
        return self._lens

    def grab(self) -> Optional[Shot]:
        """Wait for the next pair.

        Raises
        ------
        CameraError : the device is gone.
        """
        try:
            self._device.getQueueEvent(STREAM, timedelta(seconds=WAIT_S))
            pair = self._queue.tryGet()
        except RuntimeError as error:
            raise CameraError(f"OAK: {error}") from error
        return None if pair is None else read_pair(self._dai, pair)

    def close(self) -> None:
        """Let go of the device."""
        device, self._device = self._device, None
        if device is not None:
            with suppress(RuntimeError):  # unplugged: there is nothing left to close
                device.close()


class OakCamera(GrabbingCamera):
    """Read a Luxonis OAK-D; ``path`` is its MXID, address or USB name, or empty for the first one.

    Pictures are 16:9, the nearest of 640x360, 960x540, 1280x720 and 1920x1080 to ``width``.
    """

    type = "oak"
    sdk = SDK

    def __init__(self, config: CameraConfig, clock: Clock = time.monotonic) -> None:
        super().__init__(config, lambda: OakSource(config, clock), clock)


def _lens(dai: Any, device: Any, scale: Any) -> Optional[Intrinsics]:
    size = (1920 * scale[0] // scale[1], 1080 * scale[0] // scale[1])
    stored, socket = device.readCalibration(), dai.CameraBoardSocket.CAM_A
    if stored.getDistortionModel(socket) != dai.CameraModel.Perspective:
        return None
    matrix = stored.getCameraIntrinsics(socket, *size)
    lens = plain_lens(size, (matrix[0][0], matrix[1][1]), (matrix[0][2], matrix[1][2]))
    return replace(lens, dist=from_opencv(lens, stored.getDistortionCoefficients(socket)))
