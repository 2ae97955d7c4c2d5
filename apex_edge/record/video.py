"""Write a video of annotated frames."""

import logging
import os
from contextlib import contextmanager
from pathlib import Path
from typing import Dict, Iterator, Optional, Tuple, Union

import cv2

from apex_edge.errors import RecordingError
from apex_edge.record.draw import annotate
from apex_edge.record.whole import WholeFile
from apex_edge.types import Array, Step

LOG = logging.getLogger(__name__)

CODECS: Dict[str, str] = {".webm": "VP80", ".mp4": "mp4v", ".avi": "MJPG"}
"""By suffix. Of what OpenCV's wheels can encode, only VP8 plays in browsers (11 ms a frame of
640x480 here); mp4v is the fastest and smallest (1.5 ms); MJPG needs no FFmpeg at all."""


class AnnotatedVideo(WholeFile):
    """A video that appears under its name when closed.

    Where OpenCV lacks the codec, the video becomes an ``.avi`` of JPEGs: ``path`` says where it
    really is. Without a single frame no file appears.

    Parameters
    ----------
    path : ``*.webm``, ``*.mp4`` or ``*.avi``.
    fps : frames per second of play-back, one per ``write``.
    t_zero_s : capture time at which the clock in the pictures shows zero; None: the first frame.

    Raises
    ------
    RecordingError : another suffix, or the file cannot be written.
    """

    def __init__(
        self, path: Union[str, Path], fps: float, t_zero_s: Optional[float] = None
    ) -> None:
        """Check the name; the file is opened with the first frame, whose size it needs."""
        place = Path(path)
        if place.suffix not in CODECS:
            raise RecordingError(f"{place}: a video ends in one of {', '.join(CODECS)}")
        if not place.parent.is_dir():
            raise RecordingError(f"{place}: no such folder")
        super().__init__(place, _part_of(place))
        self.n_written = 0
        self._fps = fps
        self._t_zero_s = t_zero_s
        self._size: Tuple[int, int] = (0, 0)
        self._writer: Optional[cv2.VideoWriter] = None

    def write(self, step: Step) -> None:
        """Annotate and append one frame.

        Raises
        ------
        RecordingError : no codec works, or the picture size changed.
        """
        if self._t_zero_s is None:
            self._t_zero_s = step.frame.t_s
        self.write_picture(annotate(step, self._t_zero_s))

    def write_picture(self, picture: Array) -> None:
        """Append a picture (h, w, 3) uint8 BGR as it is; an odd last row or column is cut off.

        Raises
        ------
        RecordingError : no codec works, or the picture size changed.
        """
        height, width = picture.shape[0] // 2 * 2, picture.shape[1] // 2 * 2
        if self._writer is None:
            self._size = (width, height)
            self._writer = self._open()
        if (width, height) != self._size:
            raise RecordingError(
                f"{self.path}: a picture of {width}x{height} in a video of "
                f"{self._size[0]}x{self._size[1]}"
            )
        self._writer.write(picture[:height, :width])
        self.n_written += 1

    def close(self) -> None:
        """Finish the video and publish it under its name.

        Raises
        ------
        RecordingError : it could not be written.
        """
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        try:
            # OpenCV reports no write error; an empty file is the sign it leaves
            if self.part.stat().st_size == 0:
                raise OSError("the encoder wrote nothing; is the disk full?")
            self.part.replace(self.path)
        except OSError as error:
            raise RecordingError(f"{self.path}: cannot write the video: {error}") from error

    def abandon(self) -> None:
        """Remove what was written so far."""
        if self._writer is None:
            return
        self._writer.release()
        self._writer = None
        self.part.unlink()

    def _open(self) -> "cv2.VideoWriter":
        for path in (self.path, self.path.with_suffix(".avi")):
            part = _part_of(path)
            code = cv2.VideoWriter.fourcc(*CODECS[path.suffix])
            with _silenced():
                writer = cv2.VideoWriter(str(part), code, self._fps, self._size)
            if writer.isOpened():
                if path != self.path:
                    LOG.warning("%s: no codec here, writing %s", self.path, path.name)
                self.path, self.part = path, part
                return writer
        raise RecordingError(f"{self.path}: OpenCV cannot write a video here")


@contextmanager
def _silenced() -> Iterator[None]:
    """Keep FFmpeg's own note off the terminal: WebM has no tag for VP8, which is harmless."""
    kept = os.dup(2)
    nothing = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


def _part_of(path: Path) -> Path:
    # the encoder goes by the suffix, so ".part" stands before it
    return path.with_suffix(f".part{path.suffix}")
