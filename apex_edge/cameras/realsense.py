"""Intel RealSense depth cameras, through pyrealsense2.

Depth is aligned to the colour picture by the SDK. A stamp is the start of the picture's transfer,
right after its exposure, on the device's clock ("global time" is that clock in the host's time of
day); without kernel support for metadata it is the arrival, and then the calibrated latency counts.
"""

import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Callable, Optional

import numpy as np

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.depth_unit import to_mm
from apex_edge.cameras.grabbing import WAIT_S, Clock, GrabbingCamera, Shot, Source
from apex_edge.cameras.lens import fit, grid, plain_lens
from apex_edge.cameras.sdk import Sdk, load
from apex_edge.cameras.stamps import CaptureClock
from apex_edge.errors import CameraError
from apex_edge.types import Array, Intrinsics

SDK = Sdk(
    module="pyrealsense2",
    install="pyrealsense2",
    machines=("x86_64", "aarch64"),
    least_python=(3, 7),
    otherwise="build librealsense from source with -DBUILD_PYTHON_BINDINGS=true, or use an OAK-D, "
    "which has packages for 32-bit ARM",
    library="install it with: sudo apt-get install -y libusb-1.0-0",
)


class RealSenseSource(Source):
    """Grab colour and aligned depth; ``path`` is a serial number, or a recording of the SDK."""

    def __init__(
        self, config: CameraConfig, clock: Clock, wall: Callable[[], float] = time.time
    ) -> None:
        """Remember the settings; the SDK is imported by ``open``."""
        self._config, self._clock = config, clock
        self._stamps = CaptureClock(config.latency_s, wall)
        self._rs: Any = None
        self._pipeline: Any = None
        self._align: Any = None
        self._lens: Optional[Intrinsics] = None
        self._unit_m = 0.001
        self._last_number = -1

    def open(self) -> None:
        """Start colour and depth.

        Raises
        ------
        CameraError : pyrealsense2 is not installed, no such camera, or not this size and rate.
        """
        rs, config = load(SDK, "realsense"), self._config
        wanted = rs.config()
        if Path(config.path).is_file():
            wanted.enable_device_from_file(config.path, False)
        elif len(rs.context().query_devices()) == 0:
            # asked first: the pipeline waits fifteen seconds for one
            raise CameraError("no RealSense camera is plugged in, or this user may not open it")
        elif config.path:
            wanted.enable_device(config.path)
        size, fps = (config.width, config.height), int(round(config.fps))
        wanted.enable_stream(rs.stream.color, *size, rs.format.bgr8, fps)
        wanted.enable_stream(rs.stream.depth, *size, rs.format.z16, fps)
        pipeline = rs.pipeline()
        try:
            profile = pipeline.start(wanted)
            self._pipeline = pipeline
            self._unit_m = profile.get_device().first_depth_sensor().get_depth_scale()
            stream = profile.get_stream(rs.stream.color).as_video_stream_profile()
        except RuntimeError as error:
            raise CameraError(
                f"RealSense camera {config.path!r} cannot be opened: {error} "
                f"(asked for {size[0]}x{size[1]} at {fps} Hz)"
            ) from error
        self._lens = _lens(rs, stream.get_intrinsics())
        self._align, self._rs = rs.align(rs.stream.color), rs

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
            is_there, frames = self._pipeline.try_wait_for_frames(int(WAIT_S * 1000))
            now_s = self._clock()
            return self._shot(frames, now_s) if is_there else None
        except RuntimeError as error:
            raise CameraError(f"RealSense: {error}") from error

    def _shot(self, frames: Any, now_s: float) -> Optional[Shot]:
        colour, depth = frames.get_color_frame(), frames.get_depth_frame()
        if not colour or colour.get_frame_number() == self._last_number:
            # the same picture again, beside a depth picture that belongs to the next one
            return None
        self._last_number = colour.get_frame_number()
        depth_mm: Optional[Array] = None
        half_period_ms = 500.0 / self._config.fps
        if depth and abs(depth.get_timestamp() - colour.get_timestamp()) < half_period_ms:
            aligned = self._align.process(frames).get_depth_frame()
            # copied: the SDK's buffers are few, and are used again
            depth_mm = to_mm(np.array(aligned.get_data()), self._unit_m)
        return Shot(self._taken_s(colour, now_s), np.array(colour.get_data()), depth_mm)

    def _taken_s(self, frame: Any, now_s: float) -> float:
        domain, kinds = frame.get_frame_timestamp_domain(), self._rs.timestamp_domain
        stamp_s = frame.get_timestamp() / 1000.0
        if domain == kinds.hardware_clock:
            return self._stamps.from_device(stamp_s, now_s)
        return self._stamps.from_wall(stamp_s, now_s, is_arrival=domain == kinds.system_time)

    def close(self) -> None:
        """Stop the streams."""
        pipeline, self._pipeline = self._pipeline, None
        if pipeline is not None:
            with suppress(RuntimeError):  # unplugged: there is nothing left to stop
                pipeline.stop()


class RealSenseCamera(GrabbingCamera):
    """Read an Intel RealSense camera; ``path`` is its serial number, or empty for the first one."""

    type = "realsense"
    sdk = SDK

    def __init__(self, config: CameraConfig, clock: Clock = time.monotonic) -> None:
        super().__init__(config, lambda: RealSenseSource(config, clock), clock)


def _lens(rs: Any, found: Any) -> Intrinsics:
    lens = plain_lens((found.width, found.height), (found.fx, found.fy), (found.ppx, found.ppy))
    if not any(found.coeffs):
        return lens
    # The SDK knows several polynomials, and what it does for one of them has changed over time:
    # its own function is the reference.
    bent = grid(lens)
    pixels = bent * (found.fx, found.fy) + (found.ppx, found.ppy)
    ideal = [rs.rs2_deproject_pixel_to_point(found, list(pixel), 1.0)[:2] for pixel in pixels]
    return replace(lens, dist=fit(np.array(ideal), bent))
