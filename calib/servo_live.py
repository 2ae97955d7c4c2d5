"""Protractor readings from a live arm: one joint goes up through its range and down again.

Source: ours.
"""

from typing import Callable, List, Optional, Tuple

import numpy as np

from apex_edge.errors import CalibrationError, ConfigError
from apex_edge.types import Array
from calib.moving import RATE_SHARE, may_go, room
from calib.servo import ServoSamples
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.ready import ReadyArm

_N_ANGLES = 9
_EDGE = 0.03  # of the range that is left at both ends
Ask = Callable[[str], Optional[float]]
"""Asks for a reading in degrees; None leaves it out."""


def poses_for(arm: ArmModel, joint: str) -> Array:
    """Return joints (n, k) in the order of rising ticks: one joint turns, the others are home.

    Raises
    ------
    ConfigError : no such joint. CalibrationError : too little of its range is free from home.
    """
    if joint not in arm.joint_names:
        raise ConfigError(f"no joint is named {joint!r}; known: {', '.join(arm.joint_names)}")
    at = arm.joint_names.index(joint)
    low, high = arm.limits_rad[at]
    edge = _EDGE * (high - low)
    poses = np.tile(arm.home_rad, (_N_ANGLES, 1))
    poses[:, at] = np.linspace(low + edge, high - edge, _N_ANGLES)
    if arm.ticks_per_rad[at] < 0.0:
        poses = poses[::-1]
    limits = room(arm, 0.02, 0.02)
    free = np.array([may_go(arm, arm.home_rad, pose, limits) for pose in poses])
    if free.sum() < 5:
        raise CalibrationError(
            f"{joint}: only {int(free.sum())} of {_N_ANGLES} angles can be reached from home"
        )
    reachable: Array = poses[free]
    return reachable


def collect(ready: ReadyArm, joint: str, poses: Array, ask: Ask) -> ServoSamples:
    """Go up through the poses and down again, and ask for the angle at each.

    The ends are turned at, and not asked: they would be reached from the wrong side.

    Raises
    ------
    MotionRefused, ArmError : the arm was stopped. CalibrationError : nothing was read.
    """
    arm = ready.session.model
    at = arm.joint_names.index(joint)
    rows: List[Tuple[int, float, bool]] = []
    ready.go(poses[0], RATE_SHARE)
    for order, is_up in ((poses[1:], True), (poses[-2::-1], False)):
        for pose in order:
            ready.go(pose, RATE_SHARE)
            ticks = int(arm.ticks(ready.session.read().joints_rad)[at])
            wanted = np.degrees(pose[at])
            angle = ask(f"{joint}: meant to stand at {wanted:.0f} deg; protractor reads: ")
            if angle is not None:
                rows.append((ticks, angle, is_up))
    ready.go(arm.home_rad, RATE_SHARE)
    if not rows:
        raise CalibrationError("no angle was read")
    positions, angles, ups = zip(*rows)
    n = len(rows)
    ids = np.full(n, arm.servo_ids[at])
    return ServoSamples(
        ids, np.array(positions, dtype=float), np.array(angles), np.array(ups), np.arange(1, n + 1)
    )
