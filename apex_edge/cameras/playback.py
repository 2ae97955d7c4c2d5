"""What all recorded sources share: calibration, repeated frames, counters."""

from abc import abstractmethod
from dataclasses import replace
from pathlib import Path
from typing import Generator, Optional, Union

import numpy as np

from apex_edge.cameras.base import Camera, CameraConfig
from apex_edge.cameras.calibration import check_size, load_camera
from apex_edge.errors import RecordingError
from apex_edge.types import Array, CameraModel, Frame

Frames = Generator[Frame, None, None]


def config_for(path: Union[str, Path], calibration: str = "") -> CameraConfig:
    """Return the camera settings that play a file or folder, by what it is."""
    where = Path(path)
    kind = "video"
    if where.is_dir():
        kind = "folder"
    elif where.suffix == ".mcap" or where.suffixes[-2:] == [".mcap", ".part"]:
        kind = "mcap"
    return CameraConfig(type=kind, path=str(path), calibration=calibration)


def is_same_picture(older: Optional[Array], newer: Array) -> bool:
    """Say whether two pictures hold exactly the same pixels."""
    if older is None or older.shape != newer.shape:
        return False
    # a few rows tell almost all pairs apart at a sixteenth of the cost
    return np.array_equal(older[::16], newer[::16]) and np.array_equal(older, newer)


class PlaybackCamera(Camera):
    """Play recorded frames as fast as they are read; ``read`` never waits.

    Parameters
    ----------
    config : ``path`` says what to play; ``calibration``, when given, replaces what it carries.
    """

    def __init__(self, config: CameraConfig) -> None:
        """Remember the settings; nothing is opened yet."""
        super().__init__()
        self._config = config
        self._path = Path(config.path)
        self._model: Optional[CameraModel] = None
        self._frames: Optional[Frames] = None
        self._last: Optional[Array] = None

    @abstractmethod
    def _start(self) -> Frames:
        """Check the source and return its frames; raise RecordingError at once if unusable."""

    def open(self) -> None:
        """Open the recording from its start.

        Raises
        ------
        RecordingError : the source cannot be read.
        CalibrationError : the calibration file cannot be used.
        """
        self.close()
        self._model = load_camera(self._config.calibration) if self._config.calibration else None
        self._last = None
        self._frames = self._start()

    def read(self, timeout_s: float) -> Optional[Frame]:
        """Return the next frame, or None at the end.

        Raises
        ------
        RecordingError : damaged from here on, or not open.
        CalibrationError : the calibration is for another picture size.
        """
        if self._frames is None:
            raise RecordingError(f"{self._path}: not open")
        frame = next(self._frames, None)
        if frame is None:
            return None
        self._stats.grabbed += 1
        is_repeated = frame.is_repeated or is_same_picture(self._last, frame.colour_bgr)
        self._last = frame.colour_bgr
        frame = replace(frame, camera=self._model or frame.camera, is_repeated=is_repeated)
        if frame.camera is not None:
            check_size(frame.camera, frame.colour_bgr, str(self._path))
        self._stats.repeated += int(is_repeated)
        self._stats.delivered += 1
        return frame

    def close(self) -> None:
        """Release the files."""
        if self._frames is not None:
            self._frames.close()
            self._frames = None
