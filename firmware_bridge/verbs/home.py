"""``apex arm home``: to the pose of rest."""

import argparse

from firmware_bridge.kinematics import ArmModel
from firmware_bridge.verbs.common import add_motion_arguments, go, moving

HELP = "go to the pose of rest, slowly"
EXAMPLE = "apex arm home --arm armpi-mini --port /dev/ttyAMA0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_motion_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Go home and say where the arm stands.

    Raises
    ------
    MotionRefused : the straight way home is not free; nothing moved.
    """
    home = ArmModel.load(args.arm).home_rad
    with moving(args) as ready:
        go(ready, [home], args.speed, print)
    return 0
