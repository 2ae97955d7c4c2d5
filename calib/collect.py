"""Collect views of a board from a live camera: say what is missing, keep what is new.

A view is kept when the board holds still and is seen otherwise than in all views kept so far
(place, size or tilt, as ROS's calibrator compares them). Pure: a picture goes in, advice comes
out. Source: ours.
"""

import math
from dataclasses import dataclass
from typing import List, Optional, Tuple

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from calib.boards import Board
from calib.detect import View, detect
from calib.intrinsics import (
    WANTED_COVERAGE,
    WANTED_TURN_DEG,
    WANTED_VIEWS,
    coverage_of,
    coverage_share,
    nominal_lens,
    spread_deg,
)
from calib.planar_pose import two_poses
from calib.rigid import inverse

NOT_SEEN, MOVING, KNOWN, KEPT = "board not seen", "hold still", "seen before", "kept"
STILL_SHARE = 0.0025  # of the picture's diagonal, between two frames: 2 px at 640x480
NEW_DISTANCE = 0.15  # place, size and direction together, each about 0..1
MAX_VIEWS = 60  # more add nothing
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "centre", "right")


@dataclass(frozen=True)
class Advice:
    """What to tell the person with the board.

    ``state`` is one of the four words above, ``hint`` what is still missing ("" when complete),
    ``view`` what was found in this frame, ``coverage (5, 5)`` corners per cell of kept views.
    """

    state: str
    hint: str
    n_kept: int
    coverage: Array
    is_complete: bool
    view: Optional[View]


class Collector:
    """Keeps the views that a lens calibration needs.

    Parameters
    ----------
    board : what is shown.
    """

    def __init__(self, board: Board) -> None:
        """Start with no views."""
        self.board = board
        self.views: List[View] = []
        self._seen: List[Array] = []
        self._normals: List[Array] = []
        self._last: Optional[View] = None

    def step(self, picture: Array) -> Advice:
        """Look at one frame (h, w, 3) uint8 BGR.

        Raises
        ------
        CalibrationError : not a picture.
        """
        view = detect(picture, self.board, f"view {len(self.views) + 1}", True)
        last, self._last = self._last, view
        if view is None:
            return self._advice(NOT_SEEN, view, picture)
        if last is None or not _is_still(last, view):
            return self._advice(MOVING, view, picture)
        try:
            signature, normal = _signature(view)
        except CalibrationError:  # these corners are those of no board
            return self._advice(NOT_SEEN, view, picture)
        if any(np.abs(signature - seen).sum() < NEW_DISTANCE for seen in self._seen):
            return self._advice(KNOWN, view, picture)
        self.views.append(view)
        self._seen.append(signature)
        self._normals.append(normal)
        return self._advice(KEPT, view, picture)

    def _advice(self, state: str, view: Optional[View], picture: Array) -> Advice:
        size_px = (picture.shape[1], picture.shape[0])
        coverage = coverage_of([kept.corners_px for kept in self.views], size_px)
        hint = self._missing(coverage)
        is_complete = not hint or len(self.views) >= MAX_VIEWS
        return Advice(state, hint, len(self.views), coverage, is_complete, view)

    def _missing(self, coverage: Array) -> str:
        """Return the next thing to do; "" when nothing is missing."""
        if coverage_share(coverage) < WANTED_COVERAGE:
            return f"move it to the {_emptiest(coverage)}"
        if spread_deg(np.array(self._normals)) < WANTED_TURN_DEG:
            return f"tilt it more: {_untilted(np.array(self._normals))} edge towards the camera"
        if len(self.views) < WANTED_VIEWS:
            return f"{WANTED_VIEWS - len(self.views)} to go: another distance, another tilt"
        return ""


def _is_still(last: View, view: View) -> bool:
    _, before, now = np.intersect1d(last.ids, view.ids, return_indices=True)
    if last.size_px != view.size_px or len(now) < 4:
        return False
    moved = np.linalg.norm(view.corners_px[now] - last.corners_px[before], axis=1)
    return float(moved.mean()) <= STILL_SHARE * math.hypot(*view.size_px)


def _signature(view: View) -> Tuple[Array, Array]:
    """Return place, size and direction (5,) and the board's normal (3,), by a nominal lens."""
    lens = nominal_lens(view.size_px)
    board = inverse(two_poses(lens, view.corners_px, view.points_m)[0].camera.table_from_cam)
    normal, shift = board[:3, 2], board[:3, 3]
    centre = view.corners_px.mean(axis=0) / view.size_px
    size = math.log(max(1e-6, float(np.linalg.norm(shift))) / max(1e-6, _extent(view)))
    return np.array([centre[0], centre[1], 0.5 * size, 0.5 * normal[0], 0.5 * normal[1]]), normal


def _extent(view: View) -> float:
    return float(np.linalg.norm(np.ptp(view.points_m, axis=0)))


def _emptiest(coverage: Array) -> str:
    """Return the name of the ninth of the picture with the largest share of empty cells."""
    parts = [(0, 2), (1, 4), (3, 5)]
    best, name = -1.0, ""
    for (top, bottom), row in zip(parts, _ROWS):
        for (left, right), column in zip(parts, _COLUMNS):
            share = float(np.mean(coverage[top:bottom, left:right] == 0))
            if share > best:
                best, name = share, f"{row} {column}"
    return name.replace("middle centre", "middle")


def _untilted(normals: Array) -> str:
    """Return the edge that was nearest to the camera least often."""
    # the board's z points to the camera; its x part is positive when the left edge is near
    reach = {
        "left": normals[:, 0].max(),
        "right": -normals[:, 0].min(),
        "top": normals[:, 1].max(),
        "bottom": -normals[:, 1].min(),
    }
    return min(reach, key=lambda edge: float(reach[edge]))
