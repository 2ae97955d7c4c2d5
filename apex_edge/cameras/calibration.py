"""Camera files: lens and, once the table was measured, the camera's pose over it.

::

    {"format": "apex-camera", "version": 1, "sha256": "...",
     "camera": {"width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px",
                "dist": [k1, k2, p1, p2, k3], "table_from_cam": 4 x 4 or null},
     "made": {...}}
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, Mapping, Union

import cv2
import numpy as np

from apex_edge import documents
from apex_edge.errors import CalibrationError
from apex_edge.geometry import camera_matrix, is_rigid
from apex_edge.types import Array, CameraModel, Intrinsics

FORMAT = "apex-camera"
VERSION = 1
N_DIST = 5
MAX_SIDE_PX = 65535
MAX_FOLD_PX = 2.0  # strong but real lenses reach 0.9 at the corners (k1 -0.4, f 0.8 of the width)
MAX_AWAY_M = 100.0
FOCAL_SIDES = (0.02, 200.0)  # of the longer side: from a view all around to a telescope


def camera_document(camera: Intrinsics, made: Mapping[str, Any]) -> Dict[str, Any]:
    """Return the document of a lens, with its pose where ``camera`` is a CameraModel.

    Raises
    ------
    CalibrationError : the numbers are not a usable camera.
    """
    values = _to_plain(camera)
    _from_plain(values, "camera")
    return documents.compose(FORMAT, VERSION, {"camera": values}, made)


def save_camera(path: Union[str, Path], camera: Intrinsics, made: Mapping[str, Any]) -> None:
    """Write a camera file; an existing one is replaced in one step.

    Raises
    ------
    CalibrationError : the numbers are not a usable camera, or the file cannot be written.
    """
    text = documents.to_text(camera_document(camera, made))
    part = Path(f"{path}.part")
    try:
        part.write_text(text, encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot write: {error}") from error


def load_intrinsics(path: Union[str, Path]) -> Intrinsics:
    """Read a lens; a CameraModel where the file holds a pose as well.

    Raises
    ------
    CalibrationError : unreadable, another format or version, changed by hand, or out of range.
    """
    values = documents.read(Path(path), FORMAT, VERSION, CalibrationError).get("camera")
    if not isinstance(values, dict):
        raise CalibrationError(f"{path}: no camera in the file")
    return _from_plain(values, str(path))


def load_camera(path: Union[str, Path]) -> CameraModel:
    """Read a camera with its pose over the table.

    Raises
    ------
    CalibrationError : as ``load_intrinsics``, or the file knows the lens only.
    """
    camera = load_intrinsics(path)
    if not isinstance(camera, CameraModel):
        raise CalibrationError(
            f"{path}: knows the lens, but not where the camera stands over the table; "
            "add that with `apex calibrate table`"
        )
    return camera


def check_size(camera: Intrinsics, picture: Array, where: str) -> None:
    """Refuse pictures of another size than the calibration's.

    Raises
    ------
    CalibrationError : the sizes differ.
    """
    height, width = picture.shape[:2]
    if (width, height) != (camera.width_px, camera.height_px):
        raise CalibrationError(
            f"{where}: pictures are {width}x{height}, "
            f"but the calibration is for {camera.width_px}x{camera.height_px}"
        )


def _to_plain(camera: Intrinsics) -> Dict[str, Any]:
    values = {key: float(value) for key, value in asdict(camera).items() if np.ndim(value) == 0}
    values.update(width_px=int(camera.width_px), height_px=int(camera.height_px))
    pose = camera.table_from_cam if isinstance(camera, CameraModel) else None
    return {
        **values,
        "dist": np.asarray(camera.dist, dtype=np.float64).ravel().tolist(),
        "table_from_cam": None if pose is None else np.asarray(pose, dtype=np.float64).tolist(),
    }


def _from_plain(values: Mapping[str, Any], where: str) -> Intrinsics:
    try:
        lens = Intrinsics(
            width_px=int(values["width_px"]),
            height_px=int(values["height_px"]),
            fx_px=float(values["fx_px"]),
            fy_px=float(values["fy_px"]),
            cx_px=float(values["cx_px"]),
            cy_px=float(values["cy_px"]),
            dist=np.array(values["dist"], dtype=np.float64),
        )
        pose = values["table_from_cam"]
        if pose is not None:
            lens = CameraModel(**vars(lens), table_from_cam=np.array(pose, dtype=np.float64))
    except KeyError as error:
        raise CalibrationError(f"{where}: camera {error} is missing") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f"{where}: camera: {error}") from error
    _check_lens(lens, where)
    if isinstance(lens, CameraModel):
        _check_pose(lens.table_from_cam, where)
    return lens


def _check_lens(lens: Intrinsics, where: str) -> None:
    sides = (lens.width_px, lens.height_px)
    if not all(1 <= side <= MAX_SIDE_PX for side in sides):
        raise CalibrationError(f"{where}: picture size {sides} is outside 1..{MAX_SIDE_PX}")
    least, most = (factor * max(sides) for factor in FOCAL_SIDES)
    # written so that NaN fails as well
    if not (least <= lens.fx_px <= most and least <= lens.fy_px <= most):
        raise CalibrationError(
            f"{where}: focal lengths {lens.fx_px:g}, {lens.fy_px:g} px are outside "
            f"[{least:g}, {most:g}] for a picture of {sides[0]}x{sides[1]}"
        )
    if not np.isfinite([lens.cx_px, lens.cy_px]).all():
        raise CalibrationError(f"{where}: the principal point is not finite")
    if lens.dist.shape != (N_DIST,) or not np.isfinite(lens.dist).all():
        raise CalibrationError(f"{where}: dist must be {N_DIST} finite numbers (k1 k2 p1 p2 k3)")
    _check_invertible(lens, where)


def _check_invertible(lens: Intrinsics, where: str) -> None:
    """Refuse a distortion that folds the picture: a pixel must come back from its viewing ray."""
    columns, rows = np.meshgrid(
        np.linspace(0.0, lens.width_px - 1.0, 5), np.linspace(0.0, lens.height_px - 1.0, 5)
    )
    pixels = np.column_stack([columns.ravel(), rows.ravel()]).reshape(-1, 1, 2)
    matrix = camera_matrix(lens)
    flat = cv2.undistortPoints(pixels, matrix, lens.dist)
    rays = cv2.convertPointsToHomogeneous(flat)
    back, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, lens.dist)
    off_px = float(np.abs(back - pixels).max())
    if not off_px <= MAX_FOLD_PX:
        raise CalibrationError(
            f"{where}: dist {lens.dist.tolist()} cannot be undone within the picture "
            f"({off_px:.3g} px off, {MAX_FOLD_PX:g} allowed); calibrate the lens again"
        )


def _check_pose(pose: Array, where: str) -> None:
    if not is_rigid(pose):
        raise CalibrationError(f"{where}: table_from_cam is not a rigid transform (4 x 4)")
    if np.abs(pose[:3, 3]).max() > MAX_AWAY_M:
        raise CalibrationError(f"{where}: the camera stands over {MAX_AWAY_M:g} m from the table")
