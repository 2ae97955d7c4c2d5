"""Where a calibration's pictures come from: files, or a live camera with advice on what to show."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Callable, Iterator, List, Sequence, Tuple

import cv2

from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from apex_edge.verbs.progress import Progress
from calib import plot
from calib.boards import Board
from calib.collect import KEPT, Advice, Collector
from calib.detect import View, detect
from calib.files import encode_png, read_picture, write_whole
from calib.lens_picture import coverage_picture
from calib.made import Data, file_data, raw_data
from calib.settings import Bench

PREVIEW_S = 0.5
Tell = Callable[[str], None]


@dataclass(frozen=True)
class Source:
    """Views of a board, the pictures' size, the raw data, and the pictures without a board."""

    views: Tuple[View, ...]
    size_px: Tuple[int, int]
    data: Data
    not_found: Tuple[str, ...] = ()
    paths: Tuple[Path, ...] = ()


def from_files(paths: Sequence[Path], board: Board) -> Source:
    """Look for the board in pictures.

    Raises
    ------
    RecordingError : a picture that cannot be read.
    """
    views: List[View] = []
    sizes: List[Tuple[int, int]] = []
    with Progress("pictures", len(paths)) as progress:
        for path in paths:
            picture = read_picture(path)
            sizes.append((picture.shape[1], picture.shape[0]))
            view = detect(picture, board, path.name)
            if view is not None:
                views.append(view)
            progress.advance()
    found = {view.name for view in views}
    return Source(
        views=tuple(views),
        size_px=max(sizes, key=sizes.count),  # so that the odd one out is named
        data=file_data(paths),
        not_found=tuple(path.name for path in paths if path.name not in found),
        paths=tuple(paths),
    )


def frames(bench: Bench) -> Iterator[Tuple[float, Array]]:
    """Yield capture time and picture (h, w, 3) of a camera until it ends.

    Raises
    ------
    ConfigError : it shows no board. CameraError : it gives no picture.
    """
    with bench.open_camera(is_now=False) as camera:
        while True:
            frame = camera.read(bench.camera.timeout_s)
            if frame is None:
                return
            yield frame.t_s, frame.colour_bgr


def from_camera(bench: Bench, board: Board, preview: Path, tell: Tell) -> Source:
    """Collect views until nothing is missing or the source ends.

    Parameters
    ----------
    preview : picture that shows what the camera sees and what is covered; gone at the end.
    tell : gets a line whenever there is something new to say.
    """
    collector = Collector(board)
    size_px, last_line, next_s = (0, 0), "", float("-inf")
    try:
        for t_s, picture in frames(bench):
            size_px = (picture.shape[1], picture.shape[0])
            advice = collector.step(picture)
            line = f"{advice.n_kept} views; {advice.state}; {advice.hint or 'complete'}"
            if line != last_line:
                tell(grid_text(advice) + line if advice.state == KEPT else line)
                last_line = line
            if advice.state == KEPT or t_s >= next_s:
                write_whole({preview: encode_png(_preview(picture, advice, line))})
                next_s = t_s + PREVIEW_S
            if advice.is_complete:
                break
    finally:
        if preview.is_file():
            preview.unlink()
    if not collector.views:
        raise CalibrationError(f"the camera showed the board {board.name} in no frame, held still")
    corners = (view.corners_px.tobytes() for view in collector.views)
    return Source(tuple(collector.views), size_px, raw_data(corners))


def to_stderr(line: str) -> None:
    """Say a line where ``--json`` does not read."""
    sys.stderr.write(line + "\n")
    sys.stderr.flush()


def grid_text(advice: Advice) -> str:
    """Return the 5 x 5 grid as text, ``#`` where corners were seen."""
    rows = ["".join(" #" if count else " ." for count in row) for row in advice.coverage]
    return "\n".join(rows) + "\n"


def _preview(picture: Array, advice: Advice, line: str) -> Array:
    """Return the frame with the found corners, tinted by what is covered, and the advice."""
    height, width = picture.shape[:2]
    covered = coverage_picture(advice.coverage, (width, height))
    shown: Array = cv2.addWeighted(picture, 0.7, covered, 0.3, 0.0)
    if advice.view is not None:
        for corner in advice.view.corners_px:
            plot.disc(shown, corner, 3.0, plot.FOUND)
    plot.label(shown, line, (8, height - 10), 0.5)
    return shown
