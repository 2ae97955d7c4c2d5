"""A folder of pictures, with or without depth, as a camera.

::

    FOLDER/*.png|jpg|...     colour, in order of name
    FOLDER/depth/STEM.png    optional, 16-bit grey, millimetres (0 hole, 65535 saturated)
    FOLDER/depth/unit_m.txt  optional, metres per count where that is not 0.001, as 0.0002
    FOLDER/timestamps.csv    optional (or .txt), lines ``name,t_s``; then the times give the order
    FOLDER/camera.json       optional calibration
"""

import math
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import cv2
import numpy as np

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.calibration import load_camera
from apex_edge.cameras.depth_unit import MM_M, to_mm
from apex_edge.cameras.playback import Frames, PlaybackCamera
from apex_edge.errors import RecordingError
from apex_edge.pictures import decode
from apex_edge.types import Array, Frame

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
UNIT_FILE = "unit_m.txt"
MAX_UNIT_M = 1.0
TIMESTAMP_FILES = ("timestamps.csv", "timestamps.txt")


class FolderCamera(PlaybackCamera):
    """Play a folder of pictures; without a timestamps file at the configured frame rate."""

    type = "folder"

    def __init__(self, config: CameraConfig) -> None:
        """Remember the settings; nothing is opened yet."""
        super().__init__(config)
        self._unit_m = MM_M

    def _start(self) -> Frames:
        if not self._path.is_dir():
            raise RecordingError(f"{self._path}: no such folder")
        try:
            pictures = sorted(p for p in self._path.iterdir() if p.suffix.lower() in SUFFIXES)
        except OSError as error:
            raise RecordingError(f"{self._path}: cannot read: {error}") from error
        if not pictures:
            raise RecordingError(f"{self._path}: holds no pictures ({' '.join(SUFFIXES)})")
        timed = self._with_times(pictures)
        unit_file = self._path / "depth" / UNIT_FILE
        self._unit_m = read_unit(unit_file) if unit_file.is_file() else MM_M
        calibration = self._path / "camera.json"
        if self._model is None and calibration.is_file():
            self._model = load_camera(calibration)
        return self._play(timed)

    def _with_times(self, pictures: List[Path]) -> List[Tuple[float, Path]]:
        for name in TIMESTAMP_FILES:
            file = self._path / name
            if file.is_file():
                times = read_timestamps(file)
                return _in_order(file, pictures, times)
        return [(i / self._config.fps, picture) for i, picture in enumerate(pictures)]

    def _play(self, timed: List[Tuple[float, Path]]) -> Frames:
        for seq, (t_s, path) in enumerate(timed):
            colour = _read_picture(path, cv2.IMREAD_COLOR, seq)
            depth = self._depth_of(path, colour, seq)
            yield Frame(seq=seq, t_s=t_s, colour_bgr=colour, depth_mm=depth)

    def _depth_of(self, path: Path, colour: Array, n_before: int) -> Optional[Array]:
        file = self._path / "depth" / f"{path.stem}.png"
        if not file.is_file():
            return None
        depth = _read_picture(file, cv2.IMREAD_UNCHANGED, n_before)
        if depth.dtype != np.uint16 or depth.shape != colour.shape[:2]:
            raise RecordingError(
                f"{file}: depth is {depth.dtype} {depth.shape}, "
                f"expected uint16 {colour.shape[:2]} as the colour picture"
            )
        return to_mm(depth, self._unit_m)


def read_unit(path: Path) -> float:
    """Read the unit of depth pictures, metres per count.

    Raises
    ------
    RecordingError : the file cannot be read or holds anything but one such number.
    """
    try:
        text = path.read_text(encoding="utf-8-sig").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot read: {error}") from error
    unit_m = _number(text)
    # written so that NaN fails as well
    if not 0.0 < unit_m <= MAX_UNIT_M:
        raise RecordingError(
            f"{path}: expected metres per count of the depth pictures, in (0, {MAX_UNIT_M:g}], "
            f"as 0.0002; found {text[:40]!r}"
        )
    return unit_m


def read_timestamps(path: Path) -> Dict[str, float]:
    """Read lines ``name,t_s`` (or separated by blanks); ``#`` comments and one header are skipped.

    Raises
    ------
    RecordingError : the file cannot be read, or a line is not a name and a finite time.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise RecordingError(f"{path}: cannot read: {error}") from error
    times: Dict[str, float] = {}
    is_header_allowed = True
    for number, line in enumerate(lines, start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        t_s = _number(words[1]) if len(words) == 2 else math.nan
        if math.isfinite(t_s):
            if words[0] in times:
                raise RecordingError(f"{path}:{number}: {words[0]!r} has a second time")
            times[words[0]] = t_s
        elif not is_header_allowed:
            raise RecordingError(f"{path}:{number}: expected name,t_s, found {line!r}")
        is_header_allowed = False
    return times


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _in_order(
    file: Path, pictures: List[Path], times: Dict[str, float]
) -> List[Tuple[float, Path]]:
    timed = []
    for picture in pictures:
        t_s = times.get(picture.name, times.get(picture.stem))
        if t_s is None:
            raise RecordingError(f"{file}: no time for the picture {picture.name}")
        timed.append((t_s, picture))
    timed.sort()
    for (before, _), (after, picture) in zip(timed, timed[1:]):
        if not after > before:
            raise RecordingError(f"{file}: {picture.name} has the same time as another picture")
    return timed


def _read_picture(path: Path, flags: int, n_before: int) -> Array:
    # not cv2.imread: it returns None for a missing permission and a broken file alike
    try:
        picture = decode(path.read_bytes(), flags)
    except OSError as error:
        raise RecordingError(f"{path}: cannot read: {error}") from error
    if picture is None:
        raise RecordingError(
            f"{path}: not a picture that OpenCV can read ({n_before} frames could be read before)"
        )
    return picture
