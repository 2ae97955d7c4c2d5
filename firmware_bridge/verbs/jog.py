"""``apex arm jog``: one joint by a few degrees from where it stands."""

import argparse

import numpy as np

from apex_edge.errors import ConfigError
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.verbs.common import add_motion_arguments, go, joint_index, moving

HELP = "turn one joint by a few degrees"
EXAMPLE = "apex arm jog --arm so-101 --port /dev/ttyACM0 yaw 2"
MOST_DEG = 15.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the joint and how far."""
    add_motion_arguments(parser)
    parser.add_argument("joint", help="name of the joint")
    parser.add_argument("degrees", type=float, help=f"how far, at most {MOST_DEG:g} either way")


def run(args: argparse.Namespace) -> int:
    """Turn the joint and say where the arm stands.

    Raises
    ------
    ConfigError : no such joint, or too far. MotionRefused : outside the limits; nothing moved.
    """
    at = joint_index(args.joint, ArmModel.load(args.arm))
    if not abs(args.degrees) <= MOST_DEG:
        raise ConfigError(f"{args.degrees:g} degrees: jog turns at most {MOST_DEG:g}; use move")
    with moving(args) as ready:
        goal = np.array(ready.session.read().joints_rad)
        goal[at] += np.radians(args.degrees)
        go(ready, [goal], args.speed, print)
    return 0
