"""Raspberry Pi cameras on the ribbon cable, through picamera2 and libcamera: plain colour.

``SensorTimestamp`` is the end of the first row's exposure, in nanoseconds since boot; the stamp is
the middle of that exposure. Pictures begun before the camera was opened are left out.
"""

import time
from concurrent.futures import TimeoutError as LateError
from contextlib import suppress
from typing import Any, Callable, Optional

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.grabbing import WAIT_S, Clock, GrabbingCamera, Shot, Source
from apex_edge.cameras.sdk import Sdk, load
from apex_edge.errors import CameraError

SDK = Sdk(
    module="picamera2",
    install="sudo apt-get install -y python3-picamera2 (in a virtual environment made with "
    "--system-site-packages)",
    machines=("aarch64", "armv7l", "armv6l"),
    least_python=(3, 9),
    otherwise="it comes with Raspberry Pi OS Bullseye or newer, on a Raspberry Pi only; before "
    'that, use camera type "live" with path "0" and the legacy camera stack',
)
N_BUFFERS = 4


def boot_time() -> float:
    """Return the seconds since boot, suspend included, that libcamera stamps with."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class Picamera2Source(Source):
    """Grab colour with its metadata."""

    def __init__(
        self, config: CameraConfig, clock: Clock, since_boot: Callable[[], float] = boot_time
    ) -> None:
        """Remember the settings; the SDK is imported by ``open``."""
        self._config, self._clock, self._since_boot = config, clock, since_boot
        self._camera: Any = None
        self._opened_s = 0.0

    def open(self) -> None:
        """Start the camera.

        Raises
        ------
        CameraError : picamera2 is not installed, no such camera, or it is in use.
        """
        picamera2, config = load(SDK, "picamera2"), self._config
        if config.path and not config.path.isdecimal():
            raise CameraError(f"camera.path = {config.path!r}: a Pi camera goes by number, as '0'")
        try:
            self._camera = picamera2.Picamera2(int(config.path or "0"))
            self._camera.configure(
                self._camera.create_video_configuration(
                    # picamera2 calls it RGB888, but its bytes are blue, green, red
                    main={"size": (config.width, config.height), "format": "RGB888"},
                    controls={"FrameRate": config.fps},
                    buffer_count=N_BUFFERS,
                    # no picture is kept for the next request: it would be an old one
                    queue=False,
                )
            )
            self._camera.start()
        except (RuntimeError, IndexError) as error:
            raise CameraError(
                f"Pi camera {config.path or '0'} cannot be opened: {error}"
            ) from error
        self._opened_s = self._since_boot()

    def grab(self) -> Optional[Shot]:
        """Wait for the next picture.

        Raises
        ------
        CameraError : the camera is gone.
        """
        try:
            request = self._camera.capture_request(wait=WAIT_S)
        except LateError:
            # otherwise the next picture would go to a request that nobody waits for
            self._camera.cancel_all_and_flush()
            return None
        except RuntimeError as error:
            raise CameraError(f"Pi camera: {error}") from error
        try:
            metadata = request.get_metadata()
            exposure_s = metadata.get("ExposureTime", 0) / 1e6
            end_s = metadata["SensorTimestamp"] / 1e9
            if end_s - exposure_s < self._opened_s:
                return None
            taken_s = end_s - 0.5 * exposure_s - (self._since_boot() - self._clock())
            return Shot(taken_s, request.make_array("main"))
        finally:
            request.release()

    def close(self) -> None:
        """Stop the camera and let others have it."""
        camera, self._camera = self._camera, None
        if camera is not None:
            with suppress(RuntimeError):  # gone: nothing is left to close
                camera.close()


class Picamera2Camera(GrabbingCamera):
    """Read a Raspberry Pi camera; ``path`` is its number, or empty for the first one."""

    type = "picamera2"
    sdk = SDK

    def __init__(self, config: CameraConfig, clock: Clock = time.monotonic) -> None:
        super().__init__(config, lambda: Picamera2Source(config, clock), clock)
