"""Ways to solve A X = X B for an eye in the hand: (base_from_gripper, cam_from_target) -> X.

A is a motion of the gripper, B the same motion seen by the camera, X = gripper_from_cam (4, 4).
"""

from typing import Callable, Dict, Tuple

import cv2
import numpy as np

from apex_edge.types import Array
from calib.rigid import (
    inverse,
    mean_pose,
    nearest_turn,
    pose,
    skew,
    turn_from_vector,
    vector_from_turn,
)

Method = Callable[[Array, Array], Array]
_OPENCV = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
_N_REFINE = 15
# A turn and a shift count alike when the turn moves what is 0.2 m away as far as the shift.
_ARM_LENGTH_M = 0.2


def methods() -> Dict[str, Method]:
    """Return all methods of this installation by name; OpenCV 5.0.0 has none of its own."""
    found: Dict[str, Method] = {"park": park, "refined": refined}
    if hasattr(cv2, "calibrateHandEye"):
        for name in _OPENCV:
            number = getattr(cv2, f"CALIB_HAND_EYE_{name}", None)
            if number is not None:
                found[f"opencv-{name.lower()}"] = _opencv(number)
    return found


def motions(base_from_gripper: Array, cam_from_target: Array) -> Tuple[Array, Array]:
    """Return all motions between two of n poses: gripper's and camera's (n (n - 1) / 2, 4, 4)."""
    first, second = np.triu_indices(len(base_from_gripper), k=1)
    gripper = inverse(base_from_gripper[second]) @ base_from_gripper[first]
    camera = cam_from_target[second] @ inverse(cam_from_target[first])
    return gripper, camera


def park(base_from_gripper: Array, cam_from_target: Array) -> Array:
    """Return gripper_from_cam (4, 4) by least squares over all motions.

    Source: Park & Martin 1994, "Robot sensor calibration: solving AX = XB on the Euclidean group".
    """
    gripper, camera = motions(base_from_gripper, cam_from_target)
    alpha = vector_from_turn(gripper[:, :3, :3])
    beta = vector_from_turn(camera[:, :3, :3])
    turn = nearest_turn(alpha.T @ beta)
    left = (gripper[:, :3, :3] - np.eye(3)).reshape(-1, 3)
    right = (camera[:, :3, 3] @ turn.T - gripper[:, :3, 3]).ravel()
    return pose(turn, np.linalg.lstsq(left, right, rcond=None)[0])


def refined(base_from_gripper: Array, cam_from_target: Array) -> Array:
    """Return gripper_from_cam (4, 4) that makes the fixed target's scatter smallest.

    Gauss-Newton from ``park`` over gripper_from_cam and the target's pose together.
    Source: ours.
    """
    hand = park(base_from_gripper, cam_from_target)
    target = mean_pose(base_from_gripper @ hand @ cam_from_target)
    for _ in range(_N_REFINE):
        seen = base_from_gripper @ hand @ cam_from_target
        error, slope = _scatter(seen, target, base_from_gripper @ hand)
        step = np.linalg.lstsq(slope, -error, rcond=None)[0]
        hand = hand @ pose(turn_from_vector(step[:3]), step[3:6])
        shift = pose(turn_from_vector(step[6:9]), step[9:])
        target = pose(shift[:3, :3] @ target[:3, :3], target[:3, 3] + shift[:3, 3])
        if np.abs(step).max() < 1e-10:
            break
    return hand


def _scatter(seen: Array, target: Array, base_from_cam: Array) -> Tuple[Array, Array]:
    """Return the errors (6 n,) of the seen target poses and their slope (6 n, 12).

    Unknowns: turn and shift of gripper_from_cam in the camera's frame, then of the target in the
    base's. Turns are to first order, as the errors are small where it counts.
    """
    n = len(seen)
    turns, scale = base_from_cam[:, :3, :3], _ARM_LENGTH_M
    error, slope = np.empty((n, 6)), np.zeros((n, 6, 12))
    error[:, :3] = scale * vector_from_turn(seen[:, :3, :3] @ target[:3, :3].T)
    error[:, 3:] = seen[:, :3, 3] - target[:3, 3]
    in_cam = np.swapaxes(turns, 1, 2) @ (seen[:, :3, 3:] - base_from_cam[:, :3, 3:])
    slope[:, :3, :3] = scale * turns
    slope[:, :3, 6:9] = -scale * np.eye(3)
    slope[:, 3:, :3] = -turns @ skew(in_cam[..., 0])
    slope[:, 3:, 3:6] = turns
    slope[:, 3:, 9:] = -np.eye(3)
    return error.ravel(), slope.reshape(-1, 12)


def _opencv(number: int) -> Method:
    def solve(base_from_gripper: Array, cam_from_target: Array) -> Array:
        # by name: as the fifth positional argument the method is taken for an output array
        turn, place = cv2.calibrateHandEye(
            list(base_from_gripper[:, :3, :3]),
            list(base_from_gripper[:, :3, 3]),
            list(cam_from_target[:, :3, :3]),
            list(cam_from_target[:, :3, 3]),
            method=number,
        )
        return pose(turn, np.ravel(place))

    return solve
