"""The way from connected to armed: from the measured pose, or home from the last command."""

import logging
from typing import Optional

import numpy as np

from apex_edge.types import Array
from firmware_bridge.errors import MotionRefused
from firmware_bridge.guard import CheckedPath, Limits, check_path
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.motion import HORIZON_S
from firmware_bridge.servos import Measured, Servos

_LOG = logging.getLogger(__name__)

BLIND_HOME_S = 3.0  # longest turn is pi rad: about 1 rad/s
_ARMING_SHARE = 0.4  # of the arm's rate, on the way home


def vouched(arm: ArmModel, at_rad: Array, limits: Limits) -> Array:
    """Return a pose (k,) that the caller vouches for.

    Raises
    ------
    MotionRefused : it is outside the limits.
    """
    pose = np.asarray(at_rad, dtype=np.float64)
    check_path(arm, pose, pose[None], np.array([HORIZON_S]), limits)
    return pose


def take_hold(servos: Servos, seen: Measured) -> Array:
    """Make the servos hold where they stand, then switch their torque on; returns the pose (k,).

    The goal goes first: a servo whose torque comes back runs to its old goal.

    Raises
    ------
    MotionRefused : a joint was not measured, or stands where no command can hold it.
    LinkLost : the link is gone.
    """
    names = servos.arm.joint_names
    for j, name in enumerate(names):
        if not seen.is_valid[j]:
            raise MotionRefused(f"{name} (id {servos.arm.servo_ids[j]}): its pose is not known")
    if seen.grip_ticks is not None:
        low, high = servos.arm.tick_range
        servos.grip_ticks = min(max(seen.grip_ticks, low), high)
    try:
        servos.send(seen.q_rad, HORIZON_S)
    except MotionRefused as error:
        raise MotionRefused(
            f"the arm stands where no command can hold it; move it by hand: {error}"
        ) from None
    servos.switch(True)
    return seen.q_rad.copy()


def way_home(arm: ArmModel, told: Array, limits: Limits) -> Optional[CheckedPath]:
    """Return the slow way home from the pose (k,) the board was last told; None: it is there.

    Raises
    ------
    MotionRefused : there is no safe one.
    """
    home = arm.home_rad
    if np.abs(arm.ticks(home) - arm.ticks(told)).max() <= 1:
        return None
    start = np.clip(told, arm.limits_rad[:, 0], arm.limits_rad[:, 1])
    duration_s = arm.travel_time_s(start, home[None]) / _ARMING_SHARE
    try:
        return check_path(arm, start, home[None], duration_s, limits)
    except MotionRefused as error:
        raise MotionRefused(f"no safe way home from the board's pose: {error}") from None
