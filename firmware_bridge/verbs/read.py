"""``apex arm read``: where the joints stand and how the servos are. Moves nothing."""

import argparse
import json
from typing import Any, Dict, Optional, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.codec.protocol import Quantity, ServoFlag
from firmware_bridge.servos import Servos
from firmware_bridge.verbs.common import add_arm_arguments, listening, pose_text

HELP = "angles, temperatures, voltages and flags of all servos; moves nothing"
EXAMPLE = "apex arm read --arm xarm-1s --port /dev/ttyUSB0 --json"
_ASKED = (Quantity.TEMPERATURE, Quantity.VOLTAGE, Quantity.LOAD, Quantity.TORQUE, Quantity.FLAGS)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_arm_arguments(parser)
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Print what the servos say; 1 when a servo of the arm does not answer.

    Raises
    ------
    ArmError : no way to the arm.
    """
    with listening(args) as servos:
        state = state_of(servos)
    if args.json:
        print(json.dumps(state))
    else:
        show(servos, state)
    return 1 if state["missing_ids"] else 0


def state_of(servos: Servos) -> Dict[str, Any]:
    """Ask all servos; return plain values, keyed by quantity and servo id.

    Raises
    ------
    LinkLost : the link is gone.
    """
    arm, bus = servos.arm, servos.bus
    missing: Tuple[int, ...] = ()
    if servos.has_feedback:
        seen = servos.measure()
        pose: Optional[Array] = seen.q_rad
        missing = seen.missing
    else:
        pose = servos.commanded_by_board()
    values: Dict[str, Dict[str, int]] = {}
    for quantity in _ASKED:
        is_known = servos.has_feedback and quantity in bus.protocol.quantities
        found = bus.read(quantity, arm.all_ids) if is_known else {}
        values[quantity.value] = {str(i): reading.values[0] for i, reading in found.items()}
    bus.drain()
    report = bus.reports.get(Quantity.VOLTAGE)
    q_rad = np.full(arm.n_joints, np.nan) if pose is None else pose
    return {
        "source": "measured" if servos.has_feedback else "commanded",
        "joint_names": list(arm.joint_names),
        "joints_rad": [float(q) if np.isfinite(q) else None for q in q_rad],
        "missing_ids": list(missing),
        "board_mv": None if report is None else report.values[0],
        **values,
    }


def show(servos: Servos, state: Dict[str, Any]) -> None:
    """Print what ``state_of`` found."""
    arm = servos.arm
    q_rad = np.array([np.nan if q is None else q for q in state["joints_rad"]])
    print(f"{state['source']}: {pose_text(arm, q_rad)}")
    for servo_id in arm.all_ids:
        key = str(servo_id)
        words = [f"id {servo_id:3d}  {servos.name_of(servo_id):12s}"]
        if servo_id in state["missing_ids"]:
            words.append("SILENT")
        for name, form in (
            ("temperature", "{} C"),
            ("voltage", "{} mV"),
            ("load", "load {} per mille"),
            ("torque", "torque {}"),
        ):
            if key in state[name]:
                words.append(form.format(state[name][key]))
        flags = ServoFlag(state["flags"].get(key, 0))
        if flags:
            words.append(str(flags))
        if len(words) > 1:
            print("  ".join(words))
    if state["board_mv"] is not None:
        print(f"board: {state['board_mv']} mV")
