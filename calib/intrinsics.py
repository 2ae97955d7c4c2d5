"""The lens: focal lengths, principal point and distortion from views of a flat board.

One view that was located badly spoils a fit (a real one of 0.89 px moved fx by 1 %), so views are
judged by their own error and the worst is left out, one at a time. How far the focal length can
be trusted is said twice: by the fit's own standard deviation, which takes every corner's error as
independent, and by a jackknife over the views, which does not. Source: ours; the fit is OpenCV's
``calibrateCameraExtended`` (Zhang 2000).
"""

from dataclasses import dataclass, replace
from typing import Any, Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.geometry import camera_matrix
from apex_edge.types import Array, Intrinsics
from calib.boards import Board
from calib.detect import View, check_view, is_flat_board
from calib.rigid import turn_from_vector
from calib.spread import jackknife_sd
from calib.verdict import Limit, Verdict, judge

WANTED_VIEWS, MIN_VIEWS = 15, 6
WANTED_RMS_PX, MAX_RMS_PX = 0.30, 1.0
WANTED_COVERAGE, MIN_COVERAGE = 0.80, 0.40
WANTED_FOCAL_SD, MAX_FOCAL_SD = 0.005, 0.03  # of the focal length
WANTED_JACKKNIFE, MAX_JACKKNIFE = 0.01, 0.05
WANTED_TURN_DEG, MIN_TURN_DEG = 30.0, 12.0
MAX_ASPECT, REFUSED_ASPECT = 0.03, 0.5
GRID = 5
BAD_RATIO = 2.0  # times the median view error
GOOD_PX = 0.15  # a view this good is never left out
MAX_BAD_SHARE = 1.0 / 3.0
SAME_PLACE = 0.1  # of the distance: what a board held in one pose wanders
K3_SDS = 4.0  # k3 is used only when it is this many standard deviations from 0
N_GROUPS = 12


@dataclass(frozen=True)
class Rejected:
    """A view that was left out, and why."""

    name: str
    reason: str


@dataclass(frozen=True)
class _Fit:
    """A solution: lens, its sds (9,), per view rms (n,), rotations and shifts (n, 3)."""

    lens: Intrinsics
    rms_px: float
    sd: Array
    view_rms_px: Array
    turns: Array
    shifts_m: Array


@dataclass(frozen=True)
class IntrinsicsResult:
    """A lens and how well it is known, from n kept views.

    ``sd_px`` of fx, fy, cx, cy; ``sd_dist (5,)``; ``jackknife_px`` sd of fx over groups of views;
    ``view_rms_px``, ``tilt_deg (n,)`` between board and picture plane; ``turn_spread_deg`` the
    largest angle between two of the boards; ``coverage (5, 5)`` corners per cell of the picture.
    """

    lens: Intrinsics
    verdict: Verdict
    rms_px: float
    sd_px: Array
    sd_dist: Array
    jackknife_px: float
    views: Tuple[View, ...]
    residuals_px: Tuple[Array, ...]
    view_rms_px: Array
    tilt_deg: Array
    turn_spread_deg: float
    rejected: Tuple[Rejected, ...]
    coverage: Array

    def figures(self) -> Dict[str, Any]:
        """Return all figures as plain values, for the file and for ``--json``."""
        lens = self.lens
        names = ("fx_px", "fy_px", "cx_px", "cy_px")
        return {
            **self.verdict.plain(),
            "rms_px": self.rms_px,
            "n_views": len(self.views),
            "size_px": [lens.width_px, lens.height_px],
            **{name: float(getattr(lens, name)) for name in names},
            "dist": lens.dist.tolist(),
            "sd_px": dict(zip(names, self.sd_px.tolist())),
            "sd_dist": self.sd_dist.tolist(),
            "sd_focal_share": float(max(self.sd_px[:2] / (lens.fx_px, lens.fy_px))),
            "jackknife_focal_share": self.jackknife_px / lens.fx_px,
            "tilt_spread_deg": self.turn_spread_deg,
            "coverage": self.coverage.tolist(),
            "coverage_share": coverage_share(self.coverage),
            "views": [
                {"name": view.name, "n_corners": len(view.ids), "rms_px": rms, "tilt_deg": tilt}
                for view, rms, tilt in zip(
                    self.views, self.view_rms_px.tolist(), self.tilt_deg.tolist()
                )
            ],
            "rejected": [{"name": bad.name, "reason": bad.reason} for bad in self.rejected],
        }


def solve(views: Sequence[View], size_px: Tuple[int, int], board: Board) -> IntrinsicsResult:
    """Calibrate a lens and judge the result.

    Parameters
    ----------
    views : the board in pictures of one camera at one zoom and focus.
    size_px : width and height of every picture.
    board : what was shown.

    Raises
    ------
    CalibrationError : fewer than 6 usable views, pictures of several sizes, corners that are not
        finite, or views that no lens explains. Data that can be solved but not trusted gives a
        result with the verdict ``refuse``.
    """
    _check(views, size_px, board)
    flat = [view for view in views if is_flat_board(view)]
    rejected = [
        Rejected(view.name, "its corners are not those of one flat board")
        for view in views
        if not is_flat_board(view)
    ]
    kept, fit, bad = _without_bad_views(flat, size_px, rejected)
    fit = _with_k3_if_seen(kept, size_px, fit)
    residuals = tuple(_residual(view, fit, i) for i, view in enumerate(kept))
    normals = turn_from_vector(fit.turns)[:, :, 2]
    coverage = coverage_of([view.corners_px for view in kept], size_px)
    result = IntrinsicsResult(
        lens=fit.lens,
        verdict=Verdict("", ()),
        rms_px=fit.rms_px,
        sd_px=fit.sd[:4],
        sd_dist=fit.sd[4:9],
        jackknife_px=_jackknife(kept, fit),
        views=tuple(kept),
        residuals_px=residuals,
        view_rms_px=fit.view_rms_px,
        tilt_deg=np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0.0, 1.0))),
        turn_spread_deg=spread_deg(normals),
        rejected=tuple(bad),
        coverage=coverage,
    )
    return replace(result, verdict=_judge(result, fit, len(views)))


def coverage_of(corners_px: Sequence[Array], size_px: Tuple[int, int]) -> Array:
    """Return how many corners (n, 2) lie in each cell of a 5 x 5 grid, rows from the top."""
    counts = np.zeros((GRID, GRID), dtype=np.int64)
    for corners in corners_px:
        cells = np.floor(corners / np.asarray(size_px) * GRID).astype(int).clip(0, GRID - 1)
        np.add.at(counts, (cells[:, 1], cells[:, 0]), 1)
    return counts


def coverage_share(coverage: Array) -> float:
    """Return the share of cells with a corner in them."""
    return float(np.mean(coverage > 0))


def spread_deg(normals: Array) -> float:
    """Return the largest angle between any two unit vectors (n, 3)."""
    return float(np.degrees(np.arccos(np.clip(normals @ normals.T, -1.0, 1.0)).max()))


def _check(views: Sequence[View], size_px: Tuple[int, int], board: Board) -> None:
    if not views:
        raise CalibrationError(
            f"the board {board.name} was found in no picture; a chessboard's name counts inner "
            "corners, a ChArUco board's name counts squares"
        )
    for view in views:
        check_view(view)
        if view.size_px != tuple(size_px):
            raise CalibrationError(
                f"{view.name}: {view.size_px[0]}x{view.size_px[1]} px, but other pictures are "
                f"{size_px[0]}x{size_px[1]}; all must come from one camera in one mode"
            )
    if len(views) < MIN_VIEWS:
        raise CalibrationError(_too_few(len(views), board.name))


def _too_few(n_views: int, name: str) -> str:
    return (
        f"too few views: the board {name} was found in {n_views} pictures, at least {MIN_VIEWS} "
        f"are needed and {WANTED_VIEWS} wanted"
    )


def _without_bad_views(
    views: List[View], size_px: Tuple[int, int], rejected: List[Rejected]
) -> Tuple[List[View], _Fit, List[Rejected]]:
    """Leave out the worst view as long as it is far worse than the others."""
    kept, bad = list(views), list(rejected)
    n_start = len(kept) + len(bad)
    while len(kept) >= MIN_VIEWS and len(bad) <= MAX_BAD_SHARE * n_start:
        fit = _best_fit(kept, size_px)
        errors = fit.view_rms_px
        median = float(np.median(errors))
        worst = int(np.argmax(errors))
        if errors[worst] <= max(GOOD_PX, BAD_RATIO * median):
            return kept, fit, bad
        reason = f"its error of {errors[worst]:.2f} px is beyond twice the median, {median:.2f} px"
        bad.append(Rejected(kept.pop(worst).name, reason))
    told = "; ".join(f"{one.name}: {one.reason}" for one in bad)
    raise CalibrationError(
        f"{len(bad)} of {n_start} views disagree with the others, too many to leave out: {told}"
    )


def _best_fit(views: Sequence[View], size_px: Tuple[int, int]) -> _Fit:
    """Return the better of two starts: OpenCV's own, which runs away on little tilt, and ours."""
    fits = []
    for start in (None, nominal_lens(size_px)):
        try:
            fits.append(_fit(views, size_px, cv2.CALIB_FIX_K3, start))
        except CalibrationError:
            continue
    if not fits:
        raise CalibrationError("no lens explains these views; vary the tilt of the board")
    return min(fits, key=lambda fit: fit.rms_px)


def nominal_lens(size_px: Tuple[int, int]) -> Intrinsics:
    """Return a lens as many cameras have it: 58 degrees across, no distortion."""
    width, height = size_px
    centre = 0.5 * (width - 1), 0.5 * (height - 1)
    return Intrinsics(width, height, 0.9 * width, 0.9 * width, *centre, dist=np.zeros(5))


def _fit(
    views: Sequence[View],
    size_px: Tuple[int, int],
    flags: int,
    start: Optional[Intrinsics] = None,
) -> _Fit:
    guess: Tuple[Any, Any] = (None, None)
    if start is not None:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        guess = (camera_matrix(start), start.dist.copy())
    try:
        rms, matrix, dist, turns, shifts, sd, _, errors = cv2.calibrateCameraExtended(
            [view.points_m.astype(np.float32) for view in views],
            [view.corners_px.astype(np.float32) for view in views],
            size_px,
            *guess,
            flags=flags,
        )
    except cv2.error as error:
        raise CalibrationError(f"no lens explains these views: {error.err}") from error
    if not (np.isfinite(matrix).all() and np.isfinite(dist).all() and np.isfinite(rms)):
        raise CalibrationError("no lens explains these views: the fit ran away; vary the tilt")
    lens = Intrinsics(
        width_px=size_px[0],
        height_px=size_px[1],
        fx_px=float(matrix[0, 0]),
        fy_px=float(matrix[1, 1]),
        cx_px=float(matrix[0, 2]),
        cy_px=float(matrix[1, 2]),
        dist=np.asarray(dist, dtype=np.float64).ravel()[:5],
    )
    poses = [np.asarray(part, dtype=np.float64).reshape(-1, 3) for part in (turns, shifts)]
    flat_sd = np.asarray(sd, dtype=np.float64).ravel()
    return _Fit(lens, float(rms), flat_sd, np.asarray(errors).ravel(), poses[0], poses[1])


def _with_k3_if_seen(views: Sequence[View], size_px: Tuple[int, int], fit: _Fit) -> _Fit:
    """Free k3 only where the data show it; elsewhere it bends what lies beyond the corners.

    On 14 real pictures k3 came out as 0.045 +- 0.069: nothing.
    """
    free = _fit(views, size_px, 0, fit.lens)
    return free if abs(free.lens.dist[4]) > K3_SDS * free.sd[8] > 0.0 else fit


def _residual(view: View, fit: _Fit, index: int) -> Array:
    """Return found minus expected corners (n, 2)."""
    expected, _ = cv2.projectPoints(
        view.points_m,
        fit.turns[index],
        fit.shifts_m[index],
        camera_matrix(fit.lens),
        fit.lens.dist,
    )
    result: Array = view.corners_px - expected.reshape(-1, 2)
    return result


def _jackknife(views: Sequence[View], fit: _Fit) -> float:
    """Return the sd of fx that leaving out views, a group at a time, suggests."""
    n_groups = min(len(views), N_GROUPS)
    flags = cv2.CALIB_FIX_K3 if fit.lens.dist[4] == 0.0 else 0
    size_px = (fit.lens.width_px, fit.lens.height_px)
    focal = []
    for group in range(n_groups):
        rest = [view for i, view in enumerate(views) if i % n_groups != group]
        focal.append(_fit(rest, size_px, flags, fit.lens).lens.fx_px)
    return float(jackknife_sd(np.array(focal)))


def _judge(result: IntrinsicsResult, fit: _Fit, n_given: int) -> Verdict:
    lens, figures = result.lens, result.figures()
    worst = float(result.view_rms_px.max())
    ratio = worst / float(np.median(result.view_rms_px)) if worst > GOOD_PX else 1.0
    inside = abs(lens.cx_px / lens.width_px - 0.5), abs(lens.cy_px / lens.height_px - 0.5)
    n_kept = len(result.views)
    return judge(
        [
            Limit(result.turn_spread_deg, WANTED_TURN_DEG, MIN_TURN_DEG, _tilt_text(fit), True),
            Limit(result.rms_px, WANTED_RMS_PX, MAX_RMS_PX, "the corners fit to {:.2f} px only"),
            Limit(n_kept, WANTED_VIEWS, MIN_VIEWS, "only {:.0f} views", True),
            Limit(n_kept / n_given, 0.8, 1.0 - MAX_BAD_SHARE, "kept {:.0%} of the views", True),
            Limit(
                figures["coverage_share"],
                WANTED_COVERAGE,
                MIN_COVERAGE,
                "the corners reach {:.0%} of the picture's 5 x 5 cells",
                True,
            ),
            Limit(
                figures["sd_focal_share"],
                WANTED_FOCAL_SD,
                MAX_FOCAL_SD,
                "the focal length is known to {:.2%} only: tilt the board more, fill the picture",
            ),
            Limit(
                figures["jackknife_focal_share"],
                WANTED_JACKKNIFE,
                MAX_JACKKNIFE,
                "the focal length changes by {:.2%} with the choice of views: tilt the board more",
            ),
            Limit(ratio, BAD_RATIO, 2.0 * BAD_RATIO, "the worst view has {:.1f} times the median"),
            Limit(max(inside), 0.15, 0.5, "the optical axis is {:.0%} off the picture's middle"),
            Limit(
                abs(lens.fx_px / lens.fy_px - 1.0),
                MAX_ASPECT,
                REFUSED_ASPECT,
                "pixels or printed squares are {:.1%} from square",
            ),
        ]
    )


def _tilt_text(fit: _Fit) -> str:
    """Return what is wrong when no two boards differ much in direction."""
    normals = turn_from_vector(fit.turns)[:, :, 2]
    wander = np.ptp(fit.shifts_m, axis=0) / float(np.median(fit.shifts_m[:, 2]))
    if np.abs(wander).max() < SAME_PLACE:
        what = "all views show the board in the same pose"
    elif np.degrees(np.arccos(np.abs(normals[:, 2]).clip(0.0, 1.0)).max()) < WANTED_TURN_DEG:
        what = "the board was seen only head-on"
    else:
        what = "the board always had the same tilt"
    return what + " (directions differ by {:.0f} deg), which leaves the focal length open: tilt it"
