"""``apex arm move``: to joint angles or to a place, slowly, if the guard lets it."""

import argparse

import numpy as np

from apex_edge.errors import ConfigError
from apex_edge.types import Array
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.verbs.common import add_motion_arguments, go, goal_from, moving

HELP = "move to joint angles in degrees or to a place in metres"
EXAMPLE = "apex arm move --arm so-101 --port /dev/ttyACM0 --tip 0.2,0,0.1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare where to."""
    add_motion_arguments(parser)
    where = parser.add_mutually_exclusive_group(required=True)
    where.add_argument("--tip", metavar="X,Y,Z", help="place of the closed gripper, metres")
    where.add_argument("--joints", metavar="NAME=DEG,...", help="angles; the others stay")


def run(args: argparse.Namespace) -> int:
    """Move there and say where the arm stands.

    Raises
    ------
    MotionRefused : out of reach, or outside the limits; nothing moved.
    """
    arm = ArmModel.load(args.arm)
    tip_goal = None if args.tip is None else _goal_of_tip(args.tip, arm)
    with moving(args) as ready:
        start = ready.session.read().joints_rad
        goal = goal_from(args.joints, arm, start) if tip_goal is None else tip_goal
        go(ready, [goal], args.speed, print)
    return 0


def _goal_of_tip(text: str, arm: ArmModel) -> Array:
    try:
        tip_m = np.array([float(part) for part in text.split(",")])
    except ValueError:
        tip_m = np.zeros(0)
    if tip_m.shape != (3,) or not np.isfinite(tip_m).all():
        raise ConfigError(f"--tip {text!r}: expected three numbers X,Y,Z in metres")
    joints, is_reachable = arm.inverse(tip_m)
    if not is_reachable[0]:
        raise ConfigError(f"--tip {text}: {arm.name} cannot reach that place")
    goal: Array = joints[0]
    return goal
