"""Pictures in, results out: one picture of a file or video; files written whole or not at all."""

from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import cv2

from apex_edge.errors import InputError, RecordingError
from apex_edge.pictures import decode
from apex_edge.types import Array

_PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".ppm", ".pgm", ".tif", ".tiff", ".webp"}


def read_picture(path: Path, frame: int = 0) -> Array:
    """Return a picture (h, w, 3) uint8 BGR; of a video the given frame, 0-based.

    Raises
    ------
    RecordingError : missing, unreadable, or a video with fewer frames.
    """
    if not path.is_file():
        raise RecordingError(f"{path}: no such file")
    if path.suffix.lower() in _PICTURES:
        picture = decode(path.read_bytes())
        if picture is None:
            raise RecordingError(f"{path}: not a picture that OpenCV can read")
        if frame:
            raise RecordingError(f"{path}: frame {frame} asked for, but this is a single picture")
        return picture
    return _read_frame(path, frame)


def _read_frame(path: Path, frame: int) -> Array:
    video = cv2.VideoCapture(str(path))
    try:
        if not video.isOpened():
            raise RecordingError(f"{path}: neither a picture nor a video that OpenCV can read")
        picture: Optional[Array] = None
        # Decoded in order: seeking lands on the wrong frame in many compressed files.
        for index in range(frame + 1):
            is_read, picture = video.read()
            if not is_read or picture is None:
                raise RecordingError(f"{path}: frame {frame} asked for, the video has {index}")
        assert picture is not None  # at least one frame was read
        return picture
    finally:
        video.release()


def write_whole(files: Dict[Path, bytes]) -> None:
    """Write several files so that each appears complete or not at all.

    All contents are first written beside their names and then renamed.

    Raises
    ------
    InputError : a file cannot be written.
    """
    parts: List[Tuple[Path, Path]] = []
    try:
        for path, content in files.items():
            part = path.with_name(path.name + ".part")
            parts.append((part, path))
            part.write_bytes(content)
        for part, path in parts:
            part.replace(path)
    except OSError as error:
        raise InputError(f"{error.filename or path}: cannot write: {error.strerror}") from error
    finally:
        for part, _ in parts:
            _remove(part)


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError:
        return


def encode_png(picture: Any) -> bytes:
    """Return a picture (h, w, 3) uint8 as PNG."""
    _, data = cv2.imencode(".png", picture)
    result: bytes = data.tobytes()
    return result
