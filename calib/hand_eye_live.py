"""Pose pairs from a live arm: where it shall go, whether it may, and what its camera sees there.

All motion goes through the session of a ``ReadyArm``, so every way passes the guard; the whole
round is also checked beforehand, with more room above the table, for the gripper holds a camera.
Source: ours.
"""

from pathlib import Path
from typing import Callable, List, Optional

import numpy as np

from apex_edge.cameras.base import Camera
from apex_edge.cameras.calibration import check_size
from apex_edge.errors import CalibrationError, CameraError
from apex_edge.types import Array, Intrinsics
from calib.boards import Board, require_origin
from calib.csv_rows import read_numbers
from calib.detect import detect
from calib.hand_eye_checks import MIN_POSES, motion_of
from calib.moving import RATE_SHARE, may_go, room
from calib.planar_pose import two_poses
from calib.pose_pairs import PosePairs
from calib.rigid import angle_between_rad, inverse
from calib.verdict import judge
from firmware_bridge.guard import check_path
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.ready import ReadyArm

Detector = Callable[[Array], Optional[Array]]
"""Takes a picture (h, w, 3), returns cam_from_target (4, 4) or None when it sees no target."""
_TIP_Z_M, _LINK_Z_M = 0.04, 0.03  # room over the table, for the board lies on it
_N_TRIED = 6000
_NEAREST_M, _FARTHEST_M = 0.08, 0.30
_MAX_OFF_RAD = np.radians(25.0)  # cameras see about 30 degrees to each side
_OLD_PICTURE_S = 0.25  # a camera's own delay: its stamp may be that much later than the exposure
_N_PICTURES = 100


def auto_poses(arm: ArmModel, aim_m: Array, rng: np.random.RandomState, n_poses: int = 24) -> Array:
    """Return joints (n, k) that point the hand at a place on the table from many sides.

    Of random poses whose hand points to within 25 degrees of ``aim_m`` (3,), those are taken in
    turn that differ most from all before in how the gripper is turned. Sorted for short ways.

    Raises
    ------
    CalibrationError : the arm cannot look there from enough sides.
    """
    joints = _towards(arm, np.asarray(aim_m, dtype=np.float64), rng)
    pose = arm.gripper_pose(joints)
    away = np.asarray(aim_m, dtype=np.float64) - pose[:, :3, 3]
    distance = np.linalg.norm(away, axis=1)
    off = np.arccos(np.clip((away * pose[:, :3, 0]).sum(axis=1) / distance, -1.0, 1.0))
    is_good = (off <= _MAX_OFF_RAD) & (distance >= _NEAREST_M) & (distance <= _FARTHEST_M)
    limits = room(arm, _TIP_Z_M, _LINK_Z_M)
    able = [q for q in joints[is_good] if may_go(arm, arm.home_rad, q, limits)]
    if len(able) < MIN_POSES:
        raise CalibrationError(
            f"the arm can look at {np.round(aim_m, 3).tolist()} m from {len(able)} of {_N_TRIED} "
            f"random poses, {MIN_POSES} are needed; move the board and give --aim"
        )
    chosen = _most_different(arm, np.array(able), n_poses)
    return _in_order(arm, chosen[np.lexsort((chosen[:, 1], np.round(chosen[:, 0], 1)))])


def detector(lens: Intrinsics, board: Board) -> Detector:
    """Return what finds the pose of a board in a picture; its origin is the same in every view.

    Raises
    ------
    CalibrationError : the board looks the same upside down; later, pictures of another size.
    """
    require_origin(board)

    def look(picture: Array) -> Optional[Array]:
        check_size(lens, picture, "camera")
        view = detect(picture, board)
        if view is None:
            return None
        better, _ = two_poses(lens, view.corners_px, view.points_m)
        return inverse(better.camera.table_from_cam)

    return look


def read_poses(path: Path, arm: ArmModel) -> Array:
    """Read joints (n, k) from a CSV file: a header line, then yaw, shoulder, ... in degrees.

    Raises
    ------
    CalibrationError : the file cannot be used.
    """
    return np.radians(read_numbers(path, arm.n_joints))


def check_poses(arm: ArmModel, joints_rad: Array) -> float:
    """Check a round from home through all poses and back; returns how long it takes in s.

    Raises
    ------
    CalibrationError : too few poses, or their turns cannot tell where the camera is.
    MotionRefused : a way leaves the limits or comes too near the table; says which.
    """
    if len(joints_rad) < MIN_POSES:
        raise CalibrationError(f"{len(joints_rad)} poses; at least {MIN_POSES} are needed")
    found = judge(motion_of(arm.gripper_pose(joints_rad)).limits())
    if found.is_refused:
        raise CalibrationError(f"these poses cannot tell: {'; '.join(found.reasons)}")
    goals = np.vstack([joints_rad, arm.home_rad])
    before = np.vstack([arm.home_rad, joints_rad])
    duration_s = np.array([arm.travel_time_s(a, b[None])[0] for a, b in zip(before, goals)])
    slow_s = np.maximum(duration_s / RATE_SHARE, 0.2)
    check_path(arm, arm.home_rad, goals, slow_s, room(arm, _TIP_Z_M, _LINK_Z_M))
    return float(slow_s.sum()) + len(goals) * 1.0


def collect(
    ready: ReadyArm,
    camera: Camera,
    detect: Detector,
    joints_rad: Array,
    tell: Callable[[str], None],
) -> PosePairs:
    """Go through the poses, look at each when the arm stands, and come home.

    Poses at which the target is not seen are left out.

    Raises
    ------
    MotionRefused, ArmError : the arm was stopped. CameraError : no picture.
    """
    arm = ready.session.model
    gripper: List[Array] = []
    target: List[Array] = []
    for index, goal in enumerate(joints_rad):
        ready.go(goal, RATE_SHARE)
        seen = detect(_picture_after(camera, ready.session.read().t_s + _OLD_PICTURE_S))
        tell(
            f"pose {index + 1} of {len(joints_rad)}: {'seen' if seen is not None else 'no target'}"
        )
        if seen is not None:
            # what the servos were told: whole pulses, not the wish
            told = arm.angles_rad(arm.ticks(ready.session.read().joints_rad))
            gripper.append(arm.gripper_pose(told)[0])
            target.append(seen)
    ready.go(arm.home_rad, RATE_SHARE)
    shape = (-1, 4, 4)
    return PosePairs(
        np.array(gripper).reshape(shape),
        np.array(target).reshape(shape),
        np.arange(1, len(gripper) + 1),
    )


def _picture_after(camera: Camera, t_s: float) -> Array:
    """Return the first picture stamped at or after ``t_s``: taken when the arm stood."""
    for _ in range(_N_PICTURES):
        frame = camera.read(2.0)
        if frame is None:
            break
        if frame.t_s >= t_s:
            return frame.colour_bgr
    raise CameraError("the camera gave no picture of the standing arm; is its clock the arm's?")


def _towards(arm: ArmModel, aim_m: Array, rng: np.random.RandomState) -> Array:
    """Return random joints (n, k) within their limits whose hand points about at ``aim_m`` (3,).

    Yaw, shoulder and elbow are drawn, the wrist is then bent towards the aim, more or less.
    """
    low, high = arm.limits_rad[:, 0], arm.limits_rad[:, 1]
    margin = 0.02 * (high - low)
    joints = rng.uniform(low + margin, high - margin, (_N_TRIED, arm.n_joints))
    axis = np.array(arm.links.axis_m)
    aim = aim_m[:2] - axis
    turned = np.arctan2(aim[1], aim[0]) + rng.uniform(-0.8, 0.8, _N_TRIED)
    joints[:, 0] = arm.signs[0] * turned
    wrist = arm.forward(joints)[:, 2]
    ahead = (wrist[:, 0] - axis[0]) * np.cos(turned) + (wrist[:, 1] - axis[1]) * np.sin(turned)
    pitch = np.arctan2(aim_m[2] - wrist[:, 2], float(np.hypot(*aim)) - ahead)
    pitch += rng.uniform(-_MAX_OFF_RAD, _MAX_OFF_RAD, _N_TRIED)
    joints[:, 3] = 0.0
    joints[:, 3] = arm.signs[3] * (pitch - arm.pitches(joints)[:, 2])
    inside = ((joints >= low + margin) & (joints <= high - margin)).all(axis=1)
    drawn: Array = joints[inside]
    return drawn


def _most_different(arm: ArmModel, joints: Array, n_poses: int) -> Array:
    turns = arm.gripper_pose(joints)[:, :3, :3]
    chosen = [0]
    nearest = angle_between_rad(turns, turns[0])
    while len(chosen) < min(n_poses, len(joints)):
        chosen.append(int(np.argmax(nearest)))
        nearest = np.minimum(nearest, angle_between_rad(turns, turns[chosen[-1]]))
    picked: Array = joints[chosen]
    return picked


def _in_order(arm: ArmModel, joints: Array) -> Array:
    """Return the poses that can be reached one from another; all can from and to home."""
    limits = room(arm, _TIP_Z_M, _LINK_Z_M)
    kept: List[Array] = [joints[0]]
    for goal in joints[1:]:
        if may_go(arm, kept[-1], goal, limits):
            kept.append(goal)
    while not may_go(arm, kept[-1], arm.home_rad, limits):
        kept.pop()
    return np.array(kept)
