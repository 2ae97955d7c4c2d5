"""``apex arm estop``: stop an arm that no program of ours holds."""

import argparse

import numpy as np

from firmware_bridge.verbs.common import add_arm_arguments, listening

HELP = "stop all servos where they stand; with --torque-off let go of the arm"
EXAMPLE = "apex arm estop --arm lx16a-arm --port /dev/ttyUSB0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_arm_arguments(parser)
    parser.add_argument("--torque-off", action="store_true", help="the arm falls: hold it")


def run(args: argparse.Namespace) -> int:
    """Send the stop before anything else; 1 when the servos cannot be told to stop.

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
    print("stopped")
    return 0
