"""``apex arm watch``: a line a second of where the arm stands and how the servos are."""

import argparse
import time

from firmware_bridge.verbs.common import add_arm_arguments, listening
from firmware_bridge.verbs.read import show, state_of

HELP = "print pose and telemetry until Ctrl-C; moves nothing"
EXAMPLE = "apex arm watch --arm so-101 --port /dev/ttyACM0 --seconds 10"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_arm_arguments(parser)
    parser.add_argument("--seconds", type=float, help="end after so long")
    parser.add_argument("--every", type=float, default=1.0, help="seconds between two (1)")


def run(args: argparse.Namespace) -> int:
    """Print until told to stop.

    Raises
    ------
    LinkLost : the link went away.
    """
    with listening(args) as servos:
        end_s = float("inf") if args.seconds is None else time.monotonic() + args.seconds
        while True:
            show(servos, state_of(servos))
            if time.monotonic() + args.every > end_s:
                return 0
            time.sleep(args.every)
