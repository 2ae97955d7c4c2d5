"""Hand-eye files: where the camera sits on the gripper.

::

    {"format": "apex-hand-eye", "version": 1, "sha256": "...",
     "gripper_from_cam": 4 x 4, "translation_m": [...], "quaternion_xyzw": [...],
     "made": {...}}
"""

from pathlib import Path
from typing import Any, Dict, Mapping, Union

import numpy as np

from apex_edge import documents
from apex_edge.errors import CalibrationError
from apex_edge.geometry import is_rigid
from apex_edge.types import Array
from calib.pose_pairs import MAX_PLACE_M
from calib.rigid import quaternion_from_turn
from firmware_bridge.kinematics import ArmModel

FORMAT = "apex-hand-eye"
VERSION = 1


def hand_eye_document(gripper_from_cam: Array, made: Mapping[str, Any]) -> Dict[str, Any]:
    """Return the document of a pose (4, 4).

    Raises
    ------
    CalibrationError : it is not a rigid transform.
    """
    _check(gripper_from_cam, "gripper_from_cam")
    content = {
        "gripper_from_cam": gripper_from_cam.tolist(),
        "translation_m": gripper_from_cam[:3, 3].tolist(),
        "quaternion_xyzw": quaternion_from_turn(gripper_from_cam[:3, :3]).tolist(),
    }
    return documents.compose(FORMAT, VERSION, content, made)


def load_hand_eye(path: Union[str, Path]) -> Array:
    """Return gripper_from_cam (4, 4) of a file.

    Raises
    ------
    CalibrationError : unreadable, another format or version, changed by hand, or not rigid.
    """
    document = documents.read(Path(path), FORMAT, VERSION, CalibrationError)
    try:
        pose = np.array(document["gripper_from_cam"], dtype=np.float64)
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: gripper_from_cam: {error}") from error
    _check(pose, str(path))
    return pose


def table_from_cam(arm: ArmModel, joints_rad: Array, gripper_from_cam: Array) -> Array:
    """Return the camera's poses (n, 4, 4) over the table for joints (n, k) of the arm.

    The arm's base is the table frame's origin.
    """
    result: Array = arm.gripper_pose(joints_rad) @ gripper_from_cam
    return result


def _check(pose: Array, where: str) -> None:
    if not is_rigid(pose):
        raise CalibrationError(f"{where}: gripper_from_cam is not a rigid transform (4 x 4)")
    if np.abs(pose[:3, 3]).max() > MAX_PLACE_M:
        raise CalibrationError(f"{where}: the camera is over {MAX_PLACE_M:g} m off the gripper")
