"""Orbbec depth cameras, through pyorbbecsdk 2 (pip package pyorbbecsdk2).

Depth is aligned to the colour picture by the SDK. The stamp is the SDK's global one (the device's
clock in the host's time of day) where the camera has it, else the arrival, and then the calibrated
latency counts.
"""

import time
from contextlib import suppress
from dataclasses import replace
from typing import Any, Callable, Optional, Tuple

import cv2
import numpy as np

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.depth_unit import MM_M, to_mm
from apex_edge.cameras.grabbing import WAIT_S, Clock, GrabbingCamera, Shot, Source
from apex_edge.cameras.lens import from_opencv, plain_lens
from apex_edge.cameras.sdk import Sdk, load
from apex_edge.cameras.stamps import CaptureClock
from apex_edge.errors import CameraError
from apex_edge.types import Array, Intrinsics

SDK = Sdk(
    module="pyorbbecsdk",
    install="pyorbbecsdk2>=2.0",
    machines=("x86_64", "aarch64"),
    least_python=(3, 8),
    otherwise="use a 64-bit system with Python 3.8 or newer, or an OAK-D",
)
FORMATS = ("BGR", "RGB", "MJPG", "YUYV")
"""Colour formats this reads, best first."""


class OrbbecSource(Source):
    """Grab colour and aligned depth."""

    def __init__(
        self, config: CameraConfig, clock: Clock, wall: Callable[[], float] = time.time
    ) -> None:
        """Remember the settings; the SDK is imported by ``open``."""
        self._config, self._clock = config, clock
        self._stamps = CaptureClock(config.latency_s, wall)
        self._ob: Any = None
        self._pipeline: Any = None
        self._align: Any = None
        self._lens: Optional[Intrinsics] = None
        self._is_global = False

    def open(self) -> None:
        """Start colour and depth.

        Raises
        ------
        CameraError : pyorbbecsdk2 is not installed, no such camera, or not this size and rate.
        """
        ob = self._ob = load(SDK, "orbbec")
        if not hasattr(ob, "AlignFilter"):
            raise CameraError(
                f"pyorbbecsdk {ob.get_version()} is installed, but camera type 'orbbec' needs "
                f"{SDK.install}"
            )
        try:
            self._start(ob)
        except (RuntimeError, ob.OBError) as error:
            raise CameraError(
                f"Orbbec camera {self._config.path!r} cannot be opened: {error}"
            ) from error

    def _start(self, ob: Any) -> None:
        config = self._config
        # else the SDK leaves a folder "Log" wherever the program was started
        ob.Context.set_logger_to_file(ob.OBLogLevel.NONE, "")
        devices = ob.Context().query_devices()
        if devices.get_count() == 0:
            raise CameraError("no Orbbec camera is plugged in, or this user may not open it")
        if config.path:
            device = devices.get_device_by_serial_number(config.path)
        else:
            device = devices.get_device_by_index(0)
        self._is_global = device.is_global_timestamp_supported()
        if self._is_global:
            device.enable_global_timestamp(True)
        pipeline = ob.Pipeline(device)
        colour = _colour_profile(ob, pipeline, config)
        depths = pipeline.get_stream_profile_list(ob.OBSensorType.DEPTH_SENSOR)
        streams = ob.Config()
        streams.enable_stream(colour)
        streams.enable_stream(depths.get_default_video_stream_profile())
        streams.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        pipeline.enable_frame_sync()
        pipeline.start(streams)
        self._pipeline = pipeline
        self._align = ob.AlignFilter(ob.OBStreamType.COLOR_STREAM)
        self._lens = _lens(colour)

    @property
    def intrinsics(self) -> Optional[Intrinsics]:
        """Return the colour camera's lens."""
        return self._lens

    def grab(self) -> Optional[Shot]:
        """Wait for the next pair.

        Raises
        ------
        CameraError : the SDK gave up.
        """
        try:
            frames = self._pipeline.wait_for_frames(int(WAIT_S * 1000))
            now_s = self._clock()
            aligned = None if frames is None else self._align.process(frames)
            if aligned is None:
                return None
            return self._shot(aligned.as_frame_set(), now_s)
        except (RuntimeError, self._ob.OBError) as error:
            raise CameraError(f"Orbbec: {error}") from error

    def _shot(self, frames: Any, now_s: float) -> Optional[Shot]:
        colour, depth = frames.get_color_frame(), frames.get_depth_frame()
        if colour is None:
            return None
        if self._is_global:
            stamp_us = colour.get_global_timestamp_us()
        else:
            stamp_us = colour.get_system_timestamp_us()
        taken_s = self._stamps.from_wall(stamp_us / 1e6, now_s, is_arrival=not self._is_global)
        depth_mm = None if depth is None else depth_picture(depth)
        return Shot(taken_s, colour_picture(self._ob, colour), depth_mm)

    def close(self) -> None:
        """Stop the streams."""
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            with suppress(RuntimeError, self._ob.OBError):  # unplugged: nothing is left to stop
                pipeline.stop()


class OrbbecCamera(GrabbingCamera):
    """Read an Orbbec camera; ``path`` is its serial number, or empty for the first one."""

    type = "orbbec"
    sdk = SDK

    def __init__(self, config: CameraConfig, clock: Clock = time.monotonic) -> None:
        super().__init__(config, lambda: OrbbecSource(config, clock), clock)


def colour_picture(ob: Any, frame: Any) -> Optional[Array]:
    """Return a colour frame's picture (h, w, 3) uint8 BGR; None when it cannot be read."""
    shape = (frame.get_height(), frame.get_width())
    data, kind = np.asarray(frame.get_data()).view(np.uint8).ravel(), frame.get_format()
    picture: Optional[Array] = None
    if kind == ob.OBFormat.MJPG:
        picture = cv2.imdecode(data, cv2.IMREAD_COLOR)
    elif kind == ob.OBFormat.YUYV and data.size == 2 * shape[0] * shape[1]:
        picture = cv2.cvtColor(data.reshape(*shape, 2), cv2.COLOR_YUV2BGR_YUY2)
    elif data.size == 3 * shape[0] * shape[1]:
        picture = data.reshape(*shape, 3)
        if kind == ob.OBFormat.RGB:
            picture = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
        else:
            # copied: the SDK's buffers are few, and are used again
            picture = picture.copy()
    return picture


def depth_picture(frame: Any) -> Array:
    """Return a depth frame's picture (h, w) uint16 in mm."""
    shape = (frame.get_height(), frame.get_width())
    raw = np.asarray(frame.get_data()).view(np.uint8).ravel().view(np.uint16).reshape(shape)
    return to_mm(raw.copy(), float(frame.get_depth_scale()) * MM_M)


def _colour_profile(ob: Any, pipeline: Any, config: CameraConfig) -> Any:
    profiles = pipeline.get_stream_profile_list(ob.OBSensorType.COLOR_SENSOR)
    size, fps = (config.width, config.height), int(round(config.fps))
    for name in FORMATS:
        with suppress(RuntimeError, ob.OBError):  # raised when the camera has no such stream
            return profiles.get_video_stream_profile(*size, getattr(ob.OBFormat, name), fps)
    raise CameraError(
        f"Orbbec camera {config.path!r} has no colour of {size[0]}x{size[1]} at {fps} Hz as "
        f"{', '.join(FORMATS)}; look up what it offers and set camera.width, height and fps"
    )


def _lens(profile: Any) -> Intrinsics:
    found, bend = profile.get_intrinsic(), profile.get_distortion()
    lens = plain_lens((found.width, found.height), (found.fx, found.fy), (found.cx, found.cy))
    coefficients: Tuple[float, ...] = (
        *(bend.k1, bend.k2, bend.p1, bend.p2),
        *(bend.k3, bend.k4, bend.k5, bend.k6),
    )
    return replace(lens, dist=from_opencv(lens, coefficients))
