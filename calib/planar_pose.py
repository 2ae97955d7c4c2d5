"""The two camera poses that a view of points in one plane allows, each refined.

A small or distant plane looks almost the same tilted one way or the other. OpenCV's IPPE gives
both poses but returns NaN for some exact grids, so here the first pose comes from the homography
(``SOLVEPNP_ITERATIVE``) and the second starts from the first with the plane's normal mirrored at
the line of sight (Schweighofer and Pinz 2006). Source: ours.
"""

from typing import List, NamedTuple, Tuple

import cv2
import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.geometry import camera_matrix, project
from apex_edge.types import Array, CameraModel, Intrinsics
from calib.rigid import pose
from calib.spread import rms_length


class Fit(NamedTuple):
    """A camera over the points and the rms distance to their pixels."""

    camera: CameraModel
    rms_px: float


def two_poses(lens: Intrinsics, pixels: Array, points_m: Array) -> Tuple[Fit, Fit]:
    """Return the better and the worse fitting pose; the same twice when there is only one.

    Parameters
    ----------
    lens : a pose that it may have is not used.
    pixels : shape (n, 2), at least 4, not on a line.
    points_m : shape (n, 3) in the table's frame, all at one height.

    Raises
    ------
    CalibrationError : no pose puts the points before the camera.
    """
    middle = points_m.mean(axis=0)
    matrix, centred = camera_matrix(lens), points_m - middle
    try:
        is_found, turn, shift = cv2.solvePnP(
            centred, pixels, matrix, lens.dist, flags=cv2.SOLVEPNP_ITERATIVE
        )
    except cv2.error as error:
        raise CalibrationError(f"no pose explains these points: {error.err}") from error
    fits: List[Fit] = []
    if is_found:
        first = cv2.Rodrigues(turn)[0]
        for start in (first, _mirrored(first, np.ravel(shift))):
            fits += _refined(lens, pixels, points_m, (cv2.Rodrigues(start)[0], shift))
    if not fits:
        raise CalibrationError("no pose of the camera explains these points")
    fits.sort(key=lambda fit: fit.rms_px)
    return fits[0], fits[-1]


def refine(camera: CameraModel, pixels: Array, points_m: Array) -> Fit:
    """Return the best pose near that of ``camera``.

    Raises
    ------
    CalibrationError : the search leaves all sense.
    """
    turn = camera.table_from_cam[:3, :3].T
    shift = turn @ (points_m.mean(axis=0) - camera.table_from_cam[:3, 3])
    fits = _refined(camera, pixels, points_m, (cv2.Rodrigues(turn)[0], shift))
    if not fits:
        raise CalibrationError("no pose of the camera explains a part of these points")
    return fits[0]


def _mirrored(turn: Array, shift: Array) -> Array:
    """Return the rotation (3, 3) with the plane's normal mirrored at the line of sight."""
    sight = shift / np.linalg.norm(shift)
    normal = turn[:, 2]
    # half a turn about the sight, and half a turn of the plane in itself to undo its spin
    flip = 2.0 * np.outer(sight, sight) - np.eye(3)
    spin = 2.0 * np.outer(normal, normal) - np.eye(3)
    result: Array = flip @ spin @ turn
    return result


def _refined(
    lens: Intrinsics, pixels: Array, points_m: Array, start: Tuple[Array, Array]
) -> List[Fit]:
    """Return the refined pose, or nothing when it is not finite or the points lie behind it."""
    middle = points_m.mean(axis=0)
    turn, shift = cv2.solvePnPRefineLM(
        points_m - middle,
        pixels,
        camera_matrix(lens),
        lens.dist,
        np.array(start[0], dtype=np.float64).reshape(3, 1),
        np.array(start[1], dtype=np.float64).reshape(3, 1),
    )
    rotation = cv2.Rodrigues(turn)[0].T
    seen_from = pose(rotation, middle - rotation @ np.ravel(shift))
    if not np.isfinite(seen_from).all():
        return []
    camera = CameraModel(**{**vars(lens), "table_from_cam": seen_from})
    rms_px = rms_length(pixels - project(camera, points_m)[0])
    return [Fit(camera, rms_px)] if np.isfinite(rms_px) else []
