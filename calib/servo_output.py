"""What a servo calibration leaves: a signed file, lines for the arm's data file, a picture."""

from typing import Any, Dict, List, Mapping, Sequence

import numpy as np

from apex_edge import documents
from apex_edge.types import Array
from calib import plot
from calib.servo import GOOD_DEG, ServoFit, ServoSamples
from firmware_bridge.kinematics import PULSE_MAX_US, PULSE_MIN_US, ArmModel

FORMAT = "apex-servo"
VERSION = 1


def servo_document(
    fits: Sequence[ServoFit], arm: ArmModel, made: Mapping[str, Any]
) -> Dict[str, Any]:
    """Return the document: the map of each servo, and the same as TOML lines."""
    servos = [
        {
            "servo_id": fit.servo_id,
            "joint": joint_of(fit.servo_id, arm),
            "zero_us": fit.zero_us,
            "us_per_rad": fit.us_per_rad,
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
            f"zero_us = {fit.zero_us:.1f}",
            f"us_per_rad = {fit.us_per_rad:.1f}",
            "offset_us = 0.0",
        ]
        if joint:
            lines += _limit_lines(fit, arm.limits_rad[arm.servo_ids.index(fit.servo_id)])
    return lines


def _limit_lines(fit: ServoFit, limits_rad: Array) -> List[str]:
    """Return narrower joint limits where the servo's pulses do not reach the present ones."""
    zero_us, us_per_rad = round(fit.zero_us, 1), round(fit.us_per_rad, 1)
    reach = np.sort((np.array([PULSE_MIN_US, PULSE_MAX_US]) - zero_us) / us_per_rad)
    narrow = np.clip(limits_rad, *reach)
    lines = []
    for name, before, after in zip(("low_rad", "high_rad"), limits_rad, narrow):
        if abs(after - before) * abs(us_per_rad) >= 0.5:
            # toward zero, so that the rounded limit is still within the pulses
            inside = np.trunc(after * 1e4) / 1e4
            lines.append(f"{name} = {inside:.4f}  # was {before:.4f}, which no pulse reaches")
    return lines


def draw(samples: ServoSamples, fits: Sequence[ServoFit]) -> Array:
    """Return a picture: angle over pulse, and what is left of it, one row of charts a servo."""
    height = 250
    picture = plot.sheet(960, 50 + height * len(fits), "servo: blue up, orange down")
    for index, fit in enumerate(fits):
        own = samples.pick(samples.servo_id == fit.servo_id)
        left = own.angle_deg - np.degrees((own.pulse_us - fit.zero_us) / fit.us_per_rad)
        top = 70 + height * index
        pulses, reach = plot.span(own.pulse_us), max(1.2 * float(np.abs(left).max()), GOOD_DEG)
        title = f"servo {fit.servo_id}: {fit.verdict}; angle (deg) over pulse (us)"
        line = plot.Chart(picture, (60, top, 400, 180), pulses, plot.span(own.angle_deg), title)
        ends = np.array(pulses)
        line.line(ends, np.degrees((ends - fit.zero_us) / fit.us_per_rad), plot.GREEN)
        title = f"off the line (deg), backlash {fit.backlash_deg:.2f} deg"
        rest = plot.Chart(picture, (530, top, 400, 180), pulses, (-reach, reach), title)
        for way, colour in ((own.is_up, plot.BLUE), (~own.is_up, plot.ORANGE)):
            line.dots(own.pulse_us[way], own.angle_deg[way], colour)
            rest.dots(own.pulse_us[way], left[way], colour)
        for sign in (-1.0, 1.0):
            rest.level(
                0.5 * sign * fit.backlash_deg if np.isfinite(fit.backlash_deg) else 0.0, plot.GREEN
            )
    return picture
