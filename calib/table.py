"""Where the camera stands over the table, from boards or points at stated places on it.

All points lie in one plane, so a view alone allows two poses; both are refined and compared, and
when they fit alike but disagree on the table, the data is refused. How well the pose is known is
said where it counts, on the table: by leaving out a part of the points, predicting where they lie
and how far the map of the whole workspace moves. Source: ours.
"""

import math
from dataclasses import dataclass, replace
from typing import Any, Dict, List, Sequence, Tuple

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.geometry import camera_matrix, on_plane, project
from apex_edge.types import Array, CameraModel, Intrinsics
from calib.boards import Board, require_origin
from calib.detect import View
from calib.planar_pose import refine, two_poses
from calib.rigid import pose, quaternion_from_turn, turn_from_vector
from calib.spread import rms_length
from calib.verdict import Limit, Verdict, judge, known

MIN_POINTS = 4
MIN_THICKNESS = 0.03  # of a set of points: smaller over larger extent; below, they are a line
WANTED_MM, MAX_MM = 2.0, 6.0
WANTED_RMS_PX, MAX_RMS_PX = 1.0, 3.0
WANTED_ELEVATION_DEG, MIN_ELEVATION_DEG = 20.0, 8.0
MIN_HEIGHT_M = 0.02
AMBIGUOUS_RATIO = 1.5  # the second pose must fit worse by this factor
NOISE_FLOOR_PX = 0.05  # below this no picture tells which of two fits is better
WORKSPACE_X_M, WORKSPACE_Y_M = (0.05, 0.35), (-0.25, 0.25)  # what a desktop arm reaches
WORKSPACE_STEP_M = 0.05


@dataclass(frozen=True)
class Placement:
    """Where a board lies: its origin in the table frame, and its x axis' angle to the table's."""

    x_m: float
    y_m: float
    angle_rad: float = 0.0


@dataclass(frozen=True)
class Sighting:
    """Points of the table as one picture shows them, n of them.

    ``pixels (n, 2)``, ``table_m (n, 2)`` x and y, ``groups``: sets of points (index arrays) of
    which each is left out once to see how well the others foretell it.
    """

    name: str
    pixels: Array
    table_m: Array
    groups: Tuple[Array, ...]


@dataclass(frozen=True)
class TableResult:
    """A camera over the table and how well its place is known.

    ``residuals_px (n, 2)`` found minus expected; ``left_out_mm`` the worst rms error of a
    group that was left out (NaN with four points); ``workspace_mm`` how far the map of the
    workspace moved at most meanwhile; ``sd_translation_m (3,)``, ``sd_rotation_rad (3,)``;
    ``elevation_rad`` of the line of sight over the table; ``table_from_px (3, 3)`` homography of
    undistorted pixels to table metres at z = 0.
    """

    camera: CameraModel
    height_m: float
    verdict: Verdict
    rms_px: float
    residuals_px: Array
    left_out_mm: float
    workspace_mm: float
    sd_translation_m: Array
    sd_rotation_rad: Array
    elevation_rad: float
    second_rms_px: float
    n_workspace: int
    table_from_px: Array

    def figures(self) -> Dict[str, Any]:
        """Return all figures as plain values, for the file and for ``--json``."""
        pose = self.camera.table_from_cam
        plain = {
            "rms_px": self.rms_px,
            "n_points": len(self.residuals_px),
            "left_out_mm": self.left_out_mm,
            "workspace_mm": self.workspace_mm,
            "thickness_mm": 1e3 * self.height_m,
            "elevation_deg": math.degrees(self.elevation_rad),
            "second_pose_rms_px": self.second_rms_px,
            "translation_m": pose[:3, 3].tolist(),
            "quaternion_xyzw": quaternion_from_turn(pose[:3, :3]).tolist(),
            "sd_translation_mm": (1e3 * self.sd_translation_m).tolist(),
            "sd_rotation_deg": np.degrees(self.sd_rotation_rad).tolist(),
            "table_from_cam": pose.tolist(),
            "homography_table_m_from_undistorted_px": self.table_from_px.tolist(),
        }
        return {**self.verdict.plain(), **known(plain)}


def place(view: View, board: Board, where: Placement) -> Sighting:
    """Return a board's corners as points of the table.

    Raises
    ------
    CalibrationError : the board looks the same upside down, so that its origin is unknown.
    """
    require_origin(board)
    cosine, sine = math.cos(where.angle_rad), math.sin(where.angle_rad)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    table_m = view.points_m[:, :2] @ turn.T + (where.x_m, where.y_m)
    row, column = np.divmod(view.ids, board.inner[0])
    groups = [np.flatnonzero(line == k) for line in (row, column) for k in np.unique(line)]
    return Sighting(view.name, view.corners_px, table_m, tuple(groups))


def points(pixels: Array, table_m: Array, name: str = "points") -> Sighting:
    """Return points measured by hand: pixels (n, 2) and table x, y (n, 2)."""
    groups = tuple(np.array([i]) for i in range(len(pixels)))
    return Sighting(name, np.asarray(pixels, float), np.asarray(table_m, float), groups)


def solve(lens: Intrinsics, sightings: Sequence[Sighting], height_m: float) -> TableResult:
    """Find the camera's pose over the table and judge it.

    Parameters
    ----------
    lens : the camera's intrinsics; a pose it may have is not used.
    sightings : pictures of one camera that did not move; with several boards at different places
        each board is left out in turn, else rows and columns of corners are.
    height_m : of the points over the table, i.e. the board's thickness.

    Raises
    ------
    CalibrationError : too few points, points on a line, not finite, two poses that fit alike, or
        a camera below the table. A pose that is merely poor gives the verdict ``refuse``.
    """
    pixels = np.concatenate([seen.pixels for seen in sightings] or [np.empty((0, 2))])
    table_m = np.concatenate([seen.table_m for seen in sightings] or [np.empty((0, 2))])
    _check(pixels, table_m, height_m)
    at_height = np.column_stack([table_m, np.full(len(table_m), height_m)])
    (camera, rms_px), (second, second_rms_px) = two_poses(lens, pixels, at_height)
    _check_side(camera, height_m)
    workspace = _workspace(camera)
    if rms_px <= MAX_RMS_PX:  # else neither pose fits, which is the fault to report
        apart_mm = _shift_mm(camera, second, workspace, table_m, height_m)
        _check_ambiguity((rms_px, second_rms_px), apart_mm)
    left_out = _leave_out(camera, (pixels, table_m), _groups(sightings), height_m)
    loo_mm = [error for _, error in left_out]
    moved_mm = [_shift_mm(camera, other, workspace, table_m, height_m) for other, _ in left_out]
    sd_translation_m, sd_rotation_rad = _sds(camera, pixels, table_m, height_m)
    ray = np.append(table_m.mean(axis=0), height_m) - camera.table_from_cam[:3, 3]
    flat = np.delete(np.linalg.inv(camera.table_from_cam)[:3], 2, axis=1)
    result = TableResult(
        camera=camera,
        height_m=height_m,
        verdict=Verdict("", ()),
        rms_px=rms_px,
        residuals_px=pixels - _expected(camera, table_m, height_m),
        left_out_mm=max(loo_mm, default=math.nan),
        workspace_mm=max(moved_mm, default=math.nan),
        sd_translation_m=sd_translation_m,
        sd_rotation_rad=sd_rotation_rad,
        elevation_rad=math.atan2(-ray[2], float(np.hypot(ray[0], ray[1]))),
        second_rms_px=second_rms_px,
        n_workspace=len(workspace),
        table_from_px=_unit(np.linalg.inv(camera_matrix(lens) @ flat)),
    )
    return replace(result, verdict=_judge(result))


def _unit(matrix: Array) -> Array:
    result: Array = matrix / matrix[2, 2]
    return result


def _check(pixels: Array, table_m: Array, height_m: float) -> None:
    if len(pixels) != len(table_m) or len(pixels) < MIN_POINTS:
        raise CalibrationError(f"{len(pixels)} points on the table, at least {MIN_POINTS} needed")
    if not (np.isfinite(pixels).all() and np.isfinite(table_m).all()):
        raise CalibrationError("points on the table: not all numbers are finite")
    if not 0.0 <= height_m <= 0.1:
        raise CalibrationError(f"a board {1e3 * height_m:g} mm thick; expected 0 to 100 mm")
    for values, where in ((pixels, "picture"), (table_m, "table")):
        extent = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
        if not extent[1] > MIN_THICKNESS * extent[0]:
            raise CalibrationError(
                f"the points lie on a line in the {where}; spread them over an area"
            )


def _expected(camera: CameraModel, table_m: Array, height_m: float) -> Array:
    at_height = np.column_stack([table_m, np.full(len(table_m), height_m)])
    return project(camera, at_height)[0]


def _check_side(camera: CameraModel, height_m: float) -> None:
    above_m = float(camera.table_from_cam[2, 3]) - height_m
    if not above_m > MIN_HEIGHT_M:
        raise CalibrationError(
            f"the camera would be {1e3 * above_m:.0f} mm over the table; it must be above it: are "
            "the stated places mirrored? x is forward, y to the left"
        )


def _check_ambiguity(rms_px: Tuple[float, float], apart_mm: float) -> None:
    best, second = rms_px
    is_alike = second < AMBIGUOUS_RATIO * max(best, NOISE_FLOOR_PX)
    # two poses that say the same of the table are one; NaN: the other one cannot see it
    if is_alike and not apart_mm <= WANTED_MM:
        raise CalibrationError(
            f"ambiguous: two poses of the camera fit alike ({best:.2f} and {second:.2f} px), but "
            f"differ by {apart_mm:.0f} mm on the table; use a larger board, nearer, or several"
        )


def _workspace(camera: CameraModel) -> Array:
    """Return the points (n, 2) of the arm's reach on the table that the picture shows."""
    x = np.arange(WORKSPACE_X_M[0], WORKSPACE_X_M[1] + 1e-9, WORKSPACE_STEP_M)
    y = np.arange(WORKSPACE_Y_M[0], WORKSPACE_Y_M[1] + 1e-9, WORKSPACE_STEP_M)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    pixels, depth = project(camera, np.column_stack([grid, np.zeros(len(grid))]))
    with np.errstate(invalid="ignore"):
        is_seen = ((pixels >= 0.0) & (pixels < (camera.width_px, camera.height_px))).all(axis=1)
    result: Array = grid[is_seen & (depth > 0.0)]
    return result


def _shift_mm(
    camera: CameraModel, other: CameraModel, workspace: Array, table_m: Array, height_m: float
) -> float:
    """Return how far apart two cameras put the same pixel on the table, at most."""
    where = workspace if len(workspace) else table_m
    there = on_plane(other, _expected(camera, where, height_m), np.asarray(height_m))[:, :2]
    return 1e3 * float(np.linalg.norm(there - where, axis=1).max())


def _groups(sightings: Sequence[Sighting]) -> List[Array]:
    """Return index arrays into all points: one per place, or rows and columns of a single one."""
    starts = np.cumsum([0, *(len(seen.pixels) for seen in sightings)])
    places: Dict[Tuple[float, ...], List[Array]] = {}
    for start, seen in zip(starts, sightings):
        # pictures of one board in one place share their points
        key = tuple(np.round(seen.table_m[[0, -1]], 4).ravel().tolist())
        places.setdefault(key, []).append(start + np.arange(len(seen.pixels)))
    if len(places) > 1:
        return [np.concatenate(parts) for parts in places.values()]
    return [start + group for start, seen in zip(starts, sightings) for group in seen.groups]


def _leave_out(
    camera: CameraModel, data: Tuple[Array, Array], groups: Sequence[Array], height_m: float
) -> List[Tuple[CameraModel, float]]:
    """Return, per group, the camera found without it and the rms error in mm of its prediction."""
    pixels, table_m = data
    found = []
    for group in groups:
        rest = np.setdiff1d(np.arange(len(pixels)), group)
        try:
            _check(pixels[rest], table_m[rest], height_m)
        except CalibrationError:
            continue  # what is left fixes no pose
        at_height = np.column_stack([table_m[rest], np.full(len(rest), height_m)])
        other, _ = refine(camera, pixels[rest], at_height)
        miss_m = on_plane(other, pixels[group], np.asarray(height_m))[:, :2] - table_m[group]
        found.append((other, 1e3 * rms_length(miss_m)))
    return found


def _sds(
    camera: CameraModel, pixels: Array, table_m: Array, height_m: float
) -> Tuple[Array, Array]:
    """Return the sds of the camera's position (3,) and of small turns about its axes (3,)."""

    def moved(step: Array) -> CameraModel:
        turn = camera.table_from_cam[:3, :3] @ turn_from_vector(step[3:])
        return replace(camera, table_from_cam=pose(turn, camera.table_from_cam[:3, 3] + step[:3]))

    columns = []
    for axis in range(6):
        step = np.zeros(6)
        step[axis] = 1e-5
        ends = [_expected(moved(sign * step), table_m, height_m) for sign in (1.0, -1.0)]
        columns.append(((ends[0] - ends[1]) / 2e-5).ravel())
    slope = np.column_stack(columns)
    miss = pixels - _expected(camera, table_m, height_m)
    n_free = max(1, slope.shape[0] - 6)
    spread = float((miss**2).sum()) / n_free
    sd = np.sqrt(np.clip(np.diag(np.linalg.pinv(slope.T @ slope)) * spread, 0.0, None))
    return sd[:3], sd[3:]


def _judge(result: TableResult) -> Verdict:
    elevation_deg = math.degrees(result.elevation_rad)
    limits = [
        Limit(
            result.rms_px,
            WANTED_RMS_PX,
            MAX_RMS_PX,
            "the points fit to {:.2f} px only: are all stated places, the square size and the lens "
            "right, and is the board flat?",
        ),
        Limit(
            elevation_deg,
            WANTED_ELEVATION_DEG,
            MIN_ELEVATION_DEG,
            "the camera looks along the table, {:.0f} deg over it",
            True,
        ),
        Limit(result.n_workspace, 1, 0, "{:.0f} points of the arm's workspace are in view", True),
    ]
    if math.isnan(result.left_out_mm):
        n_points = len(result.residuals_px)
        what = "{:.0f} points leave none to check with: nothing is known of the error"
        return judge([*limits, Limit(n_points, MIN_POINTS + 1, 0, what, True)])
    error_mm, moved_mm = result.left_out_mm, result.workspace_mm
    return judge(
        [
            *limits,
            Limit(error_mm, WANTED_MM, MAX_MM, "points left out are foretold to {:.1f} mm only"),
            Limit(
                moved_mm,
                WANTED_MM,
                MAX_MM,
                "the map of the workspace moves by {:.1f} mm with the choice of points",
            ),
        ]
    )
