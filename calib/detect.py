"""Find a board in a picture: which corners, and where to a fraction of a pixel.

Chessboards: OpenCV's classic finder first, its sector based one (SB) where that fails, and in
both cases ``cornerSubPix`` with half a window of 0.4 squares. On 14 real pictures (640x512) this
gave an RMS of 0.123 px, SB's own corners 0.151 px, and half a window of 11 px always 0.124 px.
ChArUco: OpenCV's detector, then ``cornerSubPix`` with a window that ends before the markers; the
detector's own window reaches into them (worst corner of simulated views: 0.59 px, with this 0.15).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Optional, Tuple

import cv2
import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array
from calib.boards import CHARUCO, Board, charuco_board, load_dictionary

MIN_CORNERS = 6
MIN_SIDE_PX = 32
FIND_SIDE_PX = 1280  # larger pictures are searched at reduced size; corners come from the full one
WINDOW_SHARE = 0.4  # half a window, of the distance to the next corner; from 0.5 on it is seen too
MARKER_GAP_SHARE = 0.9  # half a window, of the white gap between a corner and the next marker
EAGER_SCALE = 2.0  # markers of 14 px are found far more often in a picture enlarged by this
MIN_STRAY_PX, STRAY_SHARE = 0.7, 0.005  # of the extent: eager corners farther off are left out
MAX_MISFIT = 0.06  # of the board's extent in the picture, off a flat board without distortion


@dataclass(frozen=True)
class View:
    """A board as one picture shows it, n corners.

    ``ids (n,)``, ``corners_px (n, 2)`` and ``points_m (n, 3)`` in the board's frame;
    ``size_px`` is the picture's width and height.
    """

    name: str
    size_px: Tuple[int, int]
    ids: Array
    corners_px: Array
    points_m: Array


def detect(picture: Array, board: Board, name: str = "", is_quick: bool = False) -> Optional[View]:
    """Return the board's corners in a picture; None when it is not seen.

    Parameters
    ----------
    picture : shape (h, w, 3) BGR or (h, w) grey, uint8.
    board : what to look for.
    name : of the picture, for messages.
    is_quick : give up where the fast finder fails, as a live view should; the next frame comes.

    Raises
    ------
    CalibrationError : not a picture, or this OpenCV cannot find ChArUco boards.
    """
    if picture.dtype != np.uint8 or picture.ndim not in (2, 3):
        raise CalibrationError(f"{name or 'picture'}: expected uint8 (h, w) or (h, w, 3)")
    grey = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    if min(grey.shape) < MIN_SIDE_PX:
        return None
    find = _charuco if board.kind == CHARUCO else _chessboard
    found = find(grey, board, is_quick)
    if found is None:
        return None
    ids, corners = found
    size_px = (int(grey.shape[1]), int(grey.shape[0]))
    return View(name, size_px, ids, corners, board.corners_m()[ids])


def check_view(view: View) -> None:
    """Refuse a view whose numbers cannot be a board.

    Raises
    ------
    CalibrationError : corners that are not finite, too few, or of the wrong shape.
    """
    n = len(view.ids)
    if view.corners_px.shape != (n, 2) or view.points_m.shape != (n, 3):
        raise CalibrationError(f"{view.name}: {n} ids, but corners {view.corners_px.shape}")
    if n < 4:
        raise CalibrationError(f"{view.name}: {n} corners, at least 4 needed")
    if not (np.isfinite(view.corners_px).all() and np.isfinite(view.points_m).all()):
        raise CalibrationError(f"{view.name}: corners that are not finite")


def is_flat_board(view: View) -> bool:
    """Say whether a view's corners can be one flat board; corners of two pictures cannot."""
    return _is_flat(view.corners_px, view.points_m[:, :2])


def _chessboard(grey: Array, board: Board, is_quick: bool) -> Optional[Tuple[Array, Array]]:
    scale = min(1.0, FIND_SIDE_PX / max(grey.shape))
    small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale)
    # the fast check costs nothing where there is no board; what it misses in bad light, SB finds
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    is_found, corners = cv2.findChessboardCorners(small, board.inner, None, flags)
    if not is_found and not is_quick and hasattr(cv2, "findChessboardCornersSB"):
        is_found, corners = cv2.findChessboardCornersSB(small, board.inner)
    if not is_found or len(corners) != board.inner[0] * board.inner[1]:
        return None
    rough = (corners.reshape(-1, 2) + 0.5) / scale - 0.5
    n_x, n_y = board.inner
    grid = _upright(grey, _sharpen(grey, rough, WINDOW_SHARE).reshape(n_y, n_x, 2), board)
    return np.arange(n_x * n_y), grid.reshape(-1, 2)


def _upright(grey: Array, grid: Array, board: Board) -> Array:
    """Return the corner grid (rows, columns, 2) in the order of the printed board.

    Seen from the front, rows run down and columns right; which of the two ends comes first is
    told by the colour of a square (and unknown on a symmetric board).
    """
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0.0:
        grid = grid[::-1]
    if board.is_ambiguous:
        return grid
    centres = 0.25 * (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:])
    x, y = np.rint(centres).astype(int).reshape(-1, 2).T
    height, width = grey.shape
    shade = grey[y.clip(0, height - 1), x.clip(0, width - 1)].astype(np.float64)
    row, column = np.indices(centres.shape[:2]).reshape(2, -1)
    is_black = np.array([board.is_black(c + 1, r + 1) for r, c in zip(row, column)])
    is_turned = shade[is_black].mean() > shade[~is_black].mean()
    result: Array = grid[::-1, ::-1] if is_turned else grid
    return result


def _sharpen(grey: Array, corners: Array, window: float) -> Array:
    """Return the corners (n, 2) float64 moved to where the edges cross.

    ``window`` is half the window's side as a share of the smallest distance between corners.
    """
    gap = np.linalg.norm(corners[:, None] - corners[None], axis=2)
    np.fill_diagonal(gap, np.inf)
    half = int(max(2, min(30, window * float(gap.min()))))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    start = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    moved = cv2.cornerSubPix(grey, start, (half, half), (-1, -1), stop)
    return np.asarray(moved, dtype=np.float64).reshape(-1, 2)


@lru_cache(maxsize=8)
def _detector(board: Board, is_legacy: bool, is_eager: bool) -> "cv2.aruco.CharucoDetector":
    load_dictionary(board.dictionary)  # says what to install where ChArUco is missing
    settings = cv2.aruco.CharucoParameters()
    settings.tryRefineMarkers = is_eager
    return cv2.aruco.CharucoDetector(charuco_board(board, is_legacy), settings)


def _charuco(grey: Array, board: Board, is_quick: bool) -> Optional[Tuple[Array, Array]]:
    """Try the current pattern, then the one before OpenCV 4.6, each plainly and then eagerly."""
    patterns = (False, True) if board.squares_y % 2 == 0 else (False,)
    best: Optional[Tuple[Array, Array]] = None
    # Eager corners are two to three times less exact, so plain ones are enough from half on.
    enough = 0.5 * board.inner[0] * board.inner[1]
    for is_eager in (False,) if is_quick else (False, True):
        for is_legacy in patterns:
            found = _charuco_corners(grey, board, is_legacy, is_eager)
            if found is not None and (best is None or len(found[0]) > len(best[0])):
                best = found
        if best is not None and len(best[0]) >= enough:
            break
    return best


def _charuco_corners(
    grey: Array, board: Board, is_legacy: bool, is_eager: bool
) -> Optional[Tuple[Array, Array]]:
    scale = EAGER_SCALE if is_eager else 1.0
    larger = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    corners, ids, _, _ = _detector(board, is_legacy, is_eager).detectBoard(larger)
    if ids is None or len(ids) < MIN_CORNERS:
        return None
    order = np.asarray(ids).ravel().astype(np.int64)
    place = (np.asarray(corners, dtype=np.float64).reshape(-1, 2) + 0.5) / scale - 0.5
    flat = board.corners_m()[order, :2]
    if not _is_flat(place, flat):
        return None
    window = 0.5 * MARKER_GAP_SHARE * (1.0 - board.marker_m / board.square_m)
    place = _sharpen(grey, place, window)
    if not is_eager:
        return order, place
    fits = _misfit(place, flat, is_robust=True) <= max(MIN_STRAY_PX, STRAY_SHARE * _extent(place))
    return (order[fits], place[fits]) if fits.sum() >= MIN_CORNERS else None


def _is_flat(corners_px: Array, points_m: Array) -> bool:
    """Say whether ids and places belong together; a wrong pattern is off by whole squares."""
    spread = np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        return False  # one row of corners fixes no plane
    return float(_misfit(corners_px, points_m).max()) <= MAX_MISFIT * _extent(corners_px)


def _misfit(corners_px: Array, points_m: Array, is_robust: bool = False) -> Array:
    """Return how far each corner (n,) is in px from a flat board seen without distortion."""
    method = cv2.RANSAC if is_robust else 0
    turn, _ = cv2.findHomography(points_m, corners_px, method, 1.5)
    if turn is None:
        return np.full(len(corners_px), np.inf)
    back = cv2.perspectiveTransform(points_m.reshape(-1, 1, 2), turn).reshape(-1, 2)
    result: Array = np.linalg.norm(back - corners_px, axis=1)
    return result


def _extent(corners_px: Array) -> float:
    return float(np.linalg.norm(np.ptp(corners_px, axis=0)))
