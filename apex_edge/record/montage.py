"""A few frames at the key moments side by side, as in the paper's deployment figure."""

import math
from typing import List, NamedTuple, Sequence

import cv2
import numpy as np

from apex_edge.errors import RecordingError
from apex_edge.record.canvas import AMBER, DANGER, INK, SAFE, Bgr, Canvas
from apex_edge.types import Array

BACKGROUND: Bgr = (28, 23, 20)
GAP_PX = 6
CAPTION_SHARE = 0.09
ACCENTS = {"hazard": AMBER, "simulated": AMBER, "intervention": DANGER, "arm there": SAFE}


class Moment(NamedTuple):
    """A picture worth keeping: what it shows and when, on the scene's clock."""

    label: str
    t_s: float
    picture: Array


def montage(moments: Sequence[Moment], width_px: int = 1280, n_columns: int = 3) -> Array:
    """Set pictures side by side with their label and time below.

    Parameters
    ----------
    moments : at least one; all are scaled to one width, the first gives the shape.
    width_px : width of the whole.
    n_columns : most in a row.

    Returns
    -------
    (h, width_px, 3) uint8 BGR.

    Raises
    ------
    RecordingError : there is no moment.
    """
    if not moments:
        raise RecordingError("a montage needs at least one frame")
    n_columns = min(n_columns, len(moments))
    cell_w = (width_px - GAP_PX * (n_columns + 1)) // n_columns
    shape = moments[0].picture.shape
    cell_h = max(1, round(cell_w * shape[0] / shape[1]))
    caption_h = max(20, round(cell_w * CAPTION_SHARE))
    n_rows = math.ceil(len(moments) / n_columns)
    height = n_rows * (cell_h + caption_h + GAP_PX) + GAP_PX
    sheet = np.empty((height, width_px, 3), dtype=np.uint8)
    sheet[:] = BACKGROUND
    for i, moment in enumerate(moments):
        row, column = divmod(i, n_columns)
        left = GAP_PX + column * (cell_w + GAP_PX)
        top = GAP_PX + row * (cell_h + caption_h + GAP_PX)
        scaled = cv2.resize(moment.picture, (cell_w, cell_h), interpolation=cv2.INTER_AREA)
        sheet[top : top + cell_h, left : left + cell_w] = scaled
        _caption(sheet[top + cell_h : top + cell_h + caption_h, left : left + cell_w], i, moment)
    return sheet


def _caption(strip: Array, i: int, moment: Moment) -> None:
    picture = np.ascontiguousarray(strip)
    canvas = Canvas(picture)
    canvas.scale = picture.shape[0] / 26.0
    middle, unit = picture.shape[0] / 2.0, canvas.scale
    accent = ACCENTS.get(moment.label, (120, 112, 104))
    used = canvas.pill((2.0 * unit, middle), str(i + 1), accent, INK, 13.0)
    canvas.text((used + 9.0 * unit, middle), moment.label, INK, 14.0)
    clock = f"{moment.t_s:.2f} s"
    right = picture.shape[1] - canvas.text_width(clock, 14.0) - 4.0 * unit
    canvas.text((right, middle), clock, INK, 14.0)
    strip[:] = picture


def spread(moments: Sequence[Moment], n: int) -> List[Moment]:
    """Return at most ``n`` moments, evenly spread, the first and the last among them."""
    if len(moments) <= n:
        return list(moments)
    return [moments[round(i * (len(moments) - 1) / (n - 1))] for i in range(n)]
