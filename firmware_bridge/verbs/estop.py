"""``apex arm estop``: stop an arm that no program of ours holds."""

import argparse
import time
from typing import List

import numpy as np

from firmware_bridge.servos import Servos
from firmware_bridge.verbs.common import add_arm_arguments, listening

HELP = "stop all servos where they stand; with --torque-off let go of the arm"
EXAMPLE = "apex arm estop --arm lx16a-arm --port /dev/ttyUSB0"
_SETTLE_S = 0.15  # a light arm swings on after a stop
_STILL_RAD = 0.02


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_arm_arguments(parser)
    parser.add_argument("--torque-off", action="store_true", help="the arm falls: hold it")


def run(args: argparse.Namespace) -> int:
    """Send the stop before anything else; 1 when it cannot be told, or is not seen, to work.

    Raises
    ------
    ArmError : no way to the arm; a program that holds the port must be stopped itself.
    """
    with listening(args) as servos:
        frames = servos.stop_frames(np.full(servos.arm.n_joints, np.nan))
        if args.torque_off:
            frames += servos.bus.protocol.torque(servos.arm.all_ids, False)
        if frames:
            servos.bus.urgent(frames)
        elif servos.has_feedback:
            servos.bus.urgent(servos.stop_frames(servos.measure().q_rad))
        else:
            told = servos.commanded_by_board()
            if told is None:
                print("these servos stop by themselves at the end of their last short command")
                return 1
            servos.bus.urgent(servos.stop_frames(told))
        moving = _still_moving(servos) if servos.has_feedback else []
    for name in moving:
        print(f"trouble: {name} still moves, or does not say where it stands")
    print("stopped" if not moving else "NOT everything stopped: switch the supply off")
    return 1 if moving else 0


def _still_moving(servos: Servos) -> List[str]:
    """Return the joints that are not seen to stand still, some time after the stop."""
    time.sleep(_SETTLE_S)
    before = servos.measure().q_rad
    time.sleep(_SETTLE_S)
    way = np.abs(servos.measure().q_rad - before)
    return [name for name, rad in zip(servos.arm.joint_names, way) if not rad < _STILL_RAD]
