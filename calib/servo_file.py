"""Servo files: the map of each servo, and the lines for the arm's data file."""

import json
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

import numpy as np

from apex_edge import documents
from apex_edge.types import Array
from calib.servo import ServoFit
from firmware_bridge.calibration import FORMAT, VERSION
from firmware_bridge.kinematics import ArmModel


def servo_document(
    fits: Sequence[ServoFit], arm: ArmModel, made: Mapping[str, Any]
) -> Dict[str, Any]:
    """Return the document: the map of each servo, and the same as TOML lines."""
    servos = [
        {
            "servo_id": fit.servo_id,
            "joint": joint_of(fit.servo_id, arm),
            "zero_ticks": fit.zero_ticks,
            "ticks_per_rad": fit.ticks_per_rad,
            "backlash_deg": None if np.isnan(fit.backlash_deg) else fit.backlash_deg,
        }
        for fit in fits
    ]
    content = {"servos": servos, "toml": "\n".join(toml_lines(fits, arm)) + "\n"}
    return documents.compose(FORMAT, VERSION, content, made)


def joint_of(servo_id: int, arm: ArmModel) -> str:
    """Return the name of the joint that a servo turns; empty when the arm has no such servo."""
    if servo_id not in arm.servo_ids:
        return ""
    return arm.joint_names[arm.servo_ids.index(servo_id)]


def toml_lines(fits: Sequence[ServoFit], arm: ArmModel) -> List[str]:
    """Return the lines that replace those of the same name in the arm's data file."""
    lines: List[str] = []
    for fit in fits:
        joint = joint_of(fit.servo_id, arm)
        lines += [f"[joints.{joint}]" if joint else "# no joint of the arm has this servo"]
        lines += [
            f"servo_id = {fit.servo_id}",
            f"zero_ticks = {fit.zero_ticks:.1f}",
            f"ticks_per_rad = {fit.ticks_per_rad:.1f}",
            "offset_ticks = 0.0",
        ]
        if joint:
            lines += _limit_lines(fit, arm)
    return lines


def calibration_lines(document: Mapping[str, Any], out: Path) -> List[str]:
    """Return the lines that tie the arm's data file to this calibration, which lies beside it."""
    return [
        "[calibration]  # the arm is not armed when this file and the lines here do not agree",
        f"file = {json.dumps(out.name, ensure_ascii=False)}  # its path, from the arm's data file",
        "sha256 = {}".format(json.dumps(document["sha256"])),
    ]


def _limit_lines(fit: ServoFit, arm: ArmModel) -> List[str]:
    """Return narrower joint limits where the servo does not reach the present ones."""
    limits_rad: Array = arm.limits_rad[arm.servo_ids.index(fit.servo_id)]
    zero_ticks, ticks_per_rad = round(fit.zero_ticks, 1), round(fit.ticks_per_rad, 1)
    reach = np.sort((np.array(arm.tick_range) - zero_ticks) / ticks_per_rad)
    narrow = np.clip(limits_rad, *reach)
    lines = []
    for name, before, after in zip(("low_rad", "high_rad"), limits_rad, narrow):
        if abs(after - before) * abs(ticks_per_rad) >= 0.5:
            # toward zero, so that the rounded limit is still within the ticks
            inside = np.trunc(after * 1e4) / 1e4
            lines.append(
                f"{name} = {inside:.4f}  # was {before:.4f}, which the servo does not reach"
            )
    return lines
