"""Travel files: how fast each servo gets there, and the lines for the arm's data file."""

import math
from typing import Any, Dict, List, Mapping, Sequence

from apex_edge import documents
from calib.servo_file import joint_of
from calib.travel import TravelFit
from calib.verdict import known
from firmware_bridge.kinematics import ArmModel

FORMAT = "apex-travel"
VERSION = 1


def travel_document(
    fits: Sequence[TravelFit], arm: ArmModel, made: Mapping[str, Any]
) -> Dict[str, Any]:
    """Return the document: how each servo travels, and the same as TOML lines."""
    servos = [
        known(
            {
                "servo_id": each.servo_id,
                "joint": joint_of(each.servo_id, arm),
                "kind": each.kind,
                "dead_s": each.dead_s,
                "rate_rad_s": each.rate_rad_s,
                "accel_rad_s2": each.accel_rad_s2,
                "time_constant_s": each.time_constant_s,
            }
        )
        for each in fits
    ]
    content = {"servos": servos, "toml": "\n".join(toml_lines(fits, arm)) + "\n"}
    return documents.compose(FORMAT, VERSION, content, made)


def toml_lines(fits: Sequence[TravelFit], arm: ArmModel) -> List[str]:
    """Return the lines that replace those of the same name in the arm's data file.

    The lag is the longest of all servos measured; rates are rounded down.
    """
    lag_s = min(max(max(each.lag_s for each in fits), 0.0), 1.0)
    constants = [each.time_constant_s for each in fits if math.isfinite(each.time_constant_s)]
    lines = [f"lag_s = {lag_s:.4f}"]
    if constants:
        lines.append(f"servo_time_constant_s = {min(max(*constants, 0.001), 0.5):.4f}")
    for each in fits:
        joint = joint_of(each.servo_id, arm)
        lines.append(f"[joints.{joint}]" if joint else "# no joint of the arm has this servo")
        lines.append(f"rate_rad_s = {math.floor(each.rate_rad_s * 1000.0) / 1000.0:.3f}")
        accel = each.accel_rad_s2 if math.isfinite(each.accel_rad_s2) else 0.0
        lines.append(f"accel_rad_s2 = {math.floor(accel * 10.0) / 10.0:.1f}")
    return lines
