"""``apex arm ping``: who answers, and whether it is the arm of the data file. Moves nothing."""

import argparse
import json
import time
from dataclasses import asdict

from firmware_bridge.bus import Priority
from firmware_bridge.handshake import Findings, shake_hands, wanted_limits
from firmware_bridge.servos import Servos
from firmware_bridge.verbs.common import add_arm_arguments, listening

HELP = "ask every servo whether it is there and fits the arm's file; moves nothing"
EXAMPLE = "apex arm ping --arm so-101 --port /dev/ttyACM0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_arm_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument(
        "--write-limits",
        action="store_true",
        help="store the file's joint limits in the servos that differ",
    )


def run(args: argparse.Namespace) -> int:
    """Print what answers and what does not fit; 1 when the arm could not be armed.

    Raises
    ------
    ArmError : no way to the arm.
    """
    with listening(args) as servos:
        found = shake_hands(servos, time.monotonic)
        if args.write_limits and _write_limits(servos, found):
            found = shake_hands(servos, time.monotonic)
    if args.json:
        print(json.dumps(asdict(found)))
    else:
        _print(found)
    return 1 if found.troubles else 0


def _write_limits(servos: Servos, found: Findings) -> bool:
    """Store the limits in each servo that has others; say whether there was one."""
    is_written = False
    for servo in found.servos:
        wanted = wanted_limits(servos.arm, servo.servo_id)
        if servo.limits_ticks is not None and servo.limits_ticks != wanted:
            frames = servos.bus.protocol.set_limits(servo.servo_id, *wanted)
            servos.bus.send(frames, Priority.MOVE)
            is_written = True
    return is_written


def _print(found: Findings) -> None:
    for servo in found.servos:
        words = [f"id {servo.servo_id:3d}  {servo.name:12s}"]
        words.append("answers" if servo.is_there else "SILENT")
        if servo.model:
            words.append(f"model {servo.model}")
        if servo.limits_ticks is not None:
            words.append("limits {}..{}".format(*servo.limits_ticks))
        print("  ".join(words))
    for note in found.notes:
        print(f"note: {note}")
    for trouble in found.troubles:
        print(f"trouble: {trouble}")
