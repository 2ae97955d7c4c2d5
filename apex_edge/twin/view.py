"""The camera the twin is seen through: on a stand opposite the arm, looking down at the table."""

from typing import Tuple

import numpy as np

from apex_edge.geometry import look_at, project
from apex_edge.types import Array, CameraModel

EYE_M: Tuple[float, float, float] = (0.60, 0.0, 0.55)
AIM_M: Tuple[float, float, float] = (0.20, 0.0, 0.0)


def twin_camera_model(
    width_px: int = 640,
    height_px: int = 480,
    focal_px: float = 560.0,
    eye_m: Tuple[float, float, float] = EYE_M,
    aim_m: Tuple[float, float, float] = AIM_M,
) -> CameraModel:
    """Return the calibration of the twin's camera; it has no lens distortion."""
    return CameraModel(
        width_px=width_px,
        height_px=height_px,
        fx_px=focal_px,
        fy_px=focal_px,
        cx_px=0.5 * (width_px - 1),
        cy_px=0.5 * (height_px - 1),
        dist=np.zeros(5),
        table_from_cam=look_at(np.array(eye_m), np.array(aim_m)),
    )


def is_in_view(camera: CameraModel, points_m: Array, radius_m: float) -> bool:
    """Say whether spheres of ``radius_m`` at ``points_m (n, 3)`` all lie wholly in the picture."""
    pixels, depth = project(camera, points_m)
    if not (depth > 0.0).all():
        return False
    margin = radius_m * camera.fx_px / depth + 4.0
    low = pixels.min(axis=1) - margin
    right = camera.width_px - 1 - pixels[:, 0] - margin
    bottom = camera.height_px - 1 - pixels[:, 1] - margin
    return bool((low >= 0.0).all() and (right >= 0.0).all() and (bottom >= 0.0).all())
