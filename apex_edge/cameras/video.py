"""Any video file OpenCV reads, as a camera."""

import math

import cv2

from apex_edge.cameras.playback import Frames, PlaybackCamera
from apex_edge.errors import RecordingError
from apex_edge.types import Frame

MAX_FPS = 1000.0
MIN_SHARE = 0.95
"""Containers without an index only estimate their length; less than this was cut short."""


class VideoCamera(PlaybackCamera):
    """Play a video file.

    Capture time is the container's time stamp; where that does not advance, one frame period
    more than the frame before.
    """

    type = "video"

    def _start(self) -> Frames:
        if not self._path.is_file():
            raise RecordingError(f"{self._path}: no such video file")
        capture = cv2.VideoCapture(str(self._path))
        is_read = capture.isOpened() and capture.grab()
        if not is_read:
            capture.release()
            raise RecordingError(f"{self._path}: not a video that OpenCV can read")
        return self._play(capture)

    def _play(self, capture: "cv2.VideoCapture") -> Frames:
        """Yield the frames; the first one is already grabbed."""
        fps = float(capture.get(cv2.CAP_PROP_FPS))
        period_s = 1.0 / (fps if 0.0 < fps <= MAX_FPS else self._config.fps)
        seq, t_s, is_grabbed = 0, -period_s, True
        try:
            while is_grabbed:
                stamp_s = float(capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000.0
                is_advancing = math.isfinite(stamp_s) and stamp_s > t_s
                t_s = stamp_s if is_advancing else t_s + period_s
                is_decoded, picture = capture.retrieve()
                # a damaged picture can count as decoded and still not be there
                if not is_decoded or picture is None:
                    break
                yield Frame(seq=seq, t_s=t_s, colour_bgr=picture)
                seq += 1
                is_grabbed = capture.grab()
            self._check_length(capture, seq)
        finally:
            capture.release()

    def _check_length(self, capture: "cv2.VideoCapture", n_read: int) -> None:
        n_promised = float(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if math.isfinite(n_promised) and n_read < MIN_SHARE * n_promised - 1.0:
            raise RecordingError(
                f"{self._path}: cut short or damaged; {n_read} of {n_promised:.0f} frames "
                "could be read"
            )
        if n_read == 0:
            raise RecordingError(f"{self._path}: holds no frame that can be decoded")
