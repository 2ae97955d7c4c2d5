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

import numpy as np

from apex_edge import documents
from apex_edge.errors import CalibrationError
from apex_edge.geometry import is_rigid
from apex_edge.types import Array, CameraModel, Intrinsics

FORMAT = "apex-camera"
VERSION = 1
N_DIST = 5
MAX_SIDE_PX = 65535


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
    if isinstance(lens, CameraModel) and not is_rigid(lens.table_from_cam):
        raise CalibrationError(f"{where}: table_from_cam is not a rigid transform (4 x 4)")
    return lens


def _check_lens(lens: Intrinsics, where: str) -> None:
    sides = (lens.width_px, lens.height_px)
    if not all(1 <= side <= MAX_SIDE_PX for side in sides):
        raise CalibrationError(f"{where}: picture size {sides} is outside 1..{MAX_SIDE_PX}")
    # written so that NaN fails as well
    if not (0 < lens.fx_px < np.inf and 0 < lens.fy_px < np.inf):
        raise CalibrationError(f"{where}: focal lengths must be positive numbers")
    if not np.isfinite([lens.cx_px, lens.cy_px]).all():
        raise CalibrationError(f"{where}: the principal point is not finite")
    if lens.dist.shape != (N_DIST,) or not np.isfinite(lens.dist).all():
        raise CalibrationError(f"{where}: dist must be {N_DIST} finite numbers (k1 k2 p1 p2 k3)")
