"""``apex arm torque``: let the arm go, or hold it where it stands."""

import argparse

from apex_edge.errors import ConfigError
from firmware_bridge.codec.protocol import Quantity
from firmware_bridge.verbs.common import add_arm_arguments, joint_index, listening

HELP = "switch the servos' torque; off lets the arm fall"
EXAMPLE = "apex arm torque --arm so-101 --port /dev/ttyACM0 off"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_arm_arguments(parser)
    parser.add_argument("switch", choices=("on", "off"))
    parser.add_argument("--joint", default="", help="this joint only (all, the gripper too)")


def run(args: argparse.Namespace) -> int:
    """Switch it; before torque goes on, each servo is told to stay where it stands.

    1 when a servo that can be asked is not as it should be afterwards.

    Raises
    ------
    ConfigError : servos that have no such switch. NoReply : a servo does not say where it stands.
    """
    with listening(args) as servos:
        arm = servos.arm
        ids = arm.all_ids
        if args.joint:
            ids = (arm.servo_ids[joint_index(args.joint, arm)],)
        is_on = args.switch == "on"
        is_done = servos.switch_on_here(ids) if is_on else servos.switch(False, ids)
        if not is_done:
            raise ConfigError(f"{arm.name}: {arm.bus.protocol} servos have no torque switch")
        if Quantity.TORQUE in servos.bus.protocol.quantities:
            found = servos.bus.read(Quantity.TORQUE, ids)
            wrong = [i for i in ids if i not in found or bool(found[i].values[0]) != is_on]
        else:
            wrong = []
    print(f"torque {args.switch}: ids {', '.join(map(str, ids))}")
    for servo_id in wrong:
        print(f"trouble: id {servo_id} does not say that its torque is {args.switch}")
    return 1 if wrong else 0
