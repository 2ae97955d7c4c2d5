"""Camera calibration files: a CameraModel as versioned JSON with a hash over its numbers."""

import hashlib
import json
from pathlib import Path
from typing import Any, Dict, Mapping, Union

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.types import Array, CameraModel

FORMAT = "apex-camera"
VERSION = 1
N_DIST = 5
MAX_SIDE_PX = 65535


def save_camera(path: Union[str, Path], camera: CameraModel, about: Mapping[str, Any]) -> None:
    """Write a camera calibration.

    Parameters
    ----------
    path : where to; an existing file is replaced in one step.
    camera : what to write.
    about : what to remember of its making (date, reprojection error, ...), not hashed.

    Raises
    ------
    CalibrationError : the numbers are not a usable camera, or the file cannot be written.
    """
    values = _to_plain(camera)
    _from_plain(values, str(path))
    document = {
        "format": FORMAT,
        "version": VERSION,
        "camera": values,
        "sha256": _digest(values),
        "about": dict(about),
    }
    part = Path(f"{path}.part")
    try:
        part.write_text(json.dumps(document, indent=2, sort_keys=True) + "\n", encoding="utf-8")
        part.replace(path)
    except OSError as error:
        raise CalibrationError(f"{path}: cannot write: {error}") from error


def load_camera(path: Union[str, Path]) -> CameraModel:
    """Read a camera calibration.

    Raises
    ------
    CalibrationError : unreadable, another format or version, changed by hand, or out of range.
    """
    try:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise CalibrationError(f"{path}: cannot read: {error}") from error
    except (ValueError, RecursionError) as error:
        raise CalibrationError(f"{path}: not JSON: {error}") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise CalibrationError(f"{path}: not a camera calibration (no format {FORMAT!r})")
    if document.get("version") != VERSION:
        raise CalibrationError(
            f"{path}: calibration version {document.get('version')!r}, expected {VERSION}"
        )
    values = document.get("camera")
    if not isinstance(values, dict) or document.get("sha256") != _digest(values):
        raise CalibrationError(f"{path}: the numbers do not match their hash; calibrate again")
    return _from_plain(values, str(path))


def check_size(camera: CameraModel, picture: Array, where: str) -> None:
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


def _digest(values: Mapping[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def _to_plain(camera: CameraModel) -> Dict[str, Any]:
    return {
        "width_px": int(camera.width_px),
        "height_px": int(camera.height_px),
        "fx_px": float(camera.fx_px),
        "fy_px": float(camera.fy_px),
        "cx_px": float(camera.cx_px),
        "cy_px": float(camera.cy_px),
        "dist": np.asarray(camera.dist, dtype=np.float64).ravel().tolist(),
        "table_from_cam": np.asarray(camera.table_from_cam, dtype=np.float64).tolist(),
    }


def _from_plain(values: Mapping[str, Any], where: str) -> CameraModel:
    try:
        camera = CameraModel(
            width_px=int(values["width_px"]),
            height_px=int(values["height_px"]),
            fx_px=float(values["fx_px"]),
            fy_px=float(values["fy_px"]),
            cx_px=float(values["cx_px"]),
            cy_px=float(values["cy_px"]),
            dist=np.array(values["dist"], dtype=np.float64),
            table_from_cam=np.array(values["table_from_cam"], dtype=np.float64),
        )
    except KeyError as error:
        raise CalibrationError(f"{where}: camera {error} is missing") from error
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f"{where}: camera: {error}") from error
    _check(camera, where)
    return camera


def _check(camera: CameraModel, where: str) -> None:
    sides = (camera.width_px, camera.height_px)
    if not all(1 <= side <= MAX_SIDE_PX for side in sides):
        raise CalibrationError(f"{where}: picture size {sides} is outside 1..{MAX_SIDE_PX}")
    # written so that NaN fails as well
    if not (0 < camera.fx_px < np.inf and 0 < camera.fy_px < np.inf):
        raise CalibrationError(f"{where}: focal lengths must be positive numbers")
    if not np.isfinite([camera.cx_px, camera.cy_px]).all():
        raise CalibrationError(f"{where}: the principal point is not finite")
    if camera.dist.shape != (N_DIST,) or not np.isfinite(camera.dist).all():
        raise CalibrationError(f"{where}: dist must be {N_DIST} finite numbers (k1 k2 p1 p2 k3)")
    pose = camera.table_from_cam
    if pose.shape != (4, 4) or not np.isfinite(pose).all():
        raise CalibrationError(f"{where}: table_from_cam must be 4 x 4 finite numbers")
    turn = pose[:3, :3]
    is_rotation = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
    if not is_rotation or not np.allclose(pose[3], [0.0, 0.0, 0.0, 1.0], atol=1e-12):
        raise CalibrationError(f"{where}: table_from_cam is not a rigid transform")
