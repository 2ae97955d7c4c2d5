"""Before an arm moves: whether it may, and whether somebody says yes to what is going to happen.

Source: ours.
"""

import sys
from dataclasses import replace

import numpy as np

from apex_edge.errors import InputError
from apex_edge.types import Array
from firmware_bridge.errors import MotionRefused
from firmware_bridge.guard import Limits, check_path
from firmware_bridge.kinematics import ArmModel

RATE_SHARE = 0.15  # of the arm's rates, for every calibration


def room(arm: ArmModel, tip_z_m: float, link_z_m: float) -> Limits:
    """Return the arm's workspace with more air over the table, for tip and links."""
    own = arm.workspace
    return replace(
        own,
        min_tip_z_m=max(own.min_tip_z_m, tip_z_m),
        min_link_z_m=max(own.min_link_z_m, link_z_m),
    )


def may_go(arm: ArmModel, start_rad: Array, goal_rad: Array, limits: Limits) -> bool:
    """Say whether the way between two poses (k,) keeps the limits."""
    try:
        check_path(arm, start_rad, goal_rad[None], np.array([1.0]), limits)
    except MotionRefused:
        return False
    return True


def confirm(what: str, is_yes: bool) -> None:
    """Announce a motion and wait for the word yes, unless it was given on the command line.

    Raises
    ------
    InputError : any other answer, or nobody there to answer; nothing has moved.
    """
    sys.stderr.write(f"{what}\nKeep hands and cables away; Ctrl-C stops the arm.\n")
    if is_yes:
        return
    sys.stderr.write("Type yes to let it move: ")
    sys.stderr.flush()
    answer = sys.stdin.readline().strip().lower()
    if answer != "yes":
        raise InputError(f"answered {answer!r} instead of yes: nothing was moved (or give --yes)")
