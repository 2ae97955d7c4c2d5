"""Does an arm's file still say what its servo calibration measured? Asked before it is armed.

Source: ours.
"""

import math
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple

from apex_edge import documents
from apex_edge.errors import CalibrationError
from firmware_bridge.kinematics import ArmModel

FORMAT = "apex-servo"
VERSION = 2  # 1 had zero_us and us_per_rad, for PWM servos alone
_ROUNDING = 0.06  # the arm's file has one decimal
_MAPS = ("zero_ticks", "ticks_per_rad")


def compare_calibration(arm: ArmModel) -> Tuple[List[str], List[str]]:
    """Return what forbids to arm and what is worth knowing; both empty without a calibration."""
    if arm.calibration is None:
        return [], []
    path = Path(arm.calibration.file)
    try:
        document = documents.read(path, FORMAT, VERSION, CalibrationError)
        servos = _servos(document, path)
    except CalibrationError as error:
        return [
            f"calibration: {error}; put the file there, or take [calibration] out of the arm's "
            "file, calibrate again (apex calibrate servo) and copy the lines that it prints"
        ], []
    if document["sha256"] != arm.calibration.sha256:
        return [
            f"calibration: {path} is not the one that the arm's file was made from (sha256 "
            f"{document['sha256']}, the arm's file says {arm.calibration.sha256}); copy the lines "
            "of this calibration into the arm's file, or bring the former one back"
        ], []
    strange = [i for i in servos if i not in arm.all_ids]
    troubles = [f"calibration: {path} is of a servo {i}, which this arm has not" for i in strange]
    notes: List[str] = []
    for j, servo_id in enumerate(arm.servo_ids):
        who = f"{arm.joint_names[j]} (id {servo_id})"
        if servo_id not in servos:
            notes.append(f"calibration: {path} says nothing of {who}")
            continue
        in_file = (float(arm.zero_ticks[j]), float(arm.ticks_per_rad[j]))
        troubles += [
            f"calibration: {who} has {name} {stated:.1f} in the arm's file (offset_ticks "
            f"included), {path} measured {measured:.1f}; copy the calibration's lines into the "
            "arm's file"
            for name, stated, measured in zip(_MAPS, in_file, servos[servo_id])
            if not abs(stated - measured) <= _ROUNDING
        ]
    return troubles, notes


def _servos(document: Mapping[str, Any], path: Path) -> Dict[int, Tuple[float, float]]:
    """Return zero and ticks per radian of each servo id.

    Raises
    ------
    CalibrationError : the document is signed, but holds something else.
    """
    servos = document.get("servos")
    if not isinstance(servos, list) or not servos:
        raise CalibrationError(f"{path}: servos must be a list of at least one")
    result: Dict[int, Tuple[float, float]] = {}
    for servo in servos:
        values: List[Any] = [servo.get(key) for key in _MAPS] if isinstance(servo, dict) else []
        servo_id = servo.get("servo_id") if isinstance(servo, dict) else None
        if type(servo_id) is not int or not all(_is_number(value) for value in values):
            raise CalibrationError(f"{path}: servo {servo!r} needs servo_id, {', '.join(_MAPS)}")
        if servo_id in result:
            raise CalibrationError(f"{path}: servo {servo_id} is there twice")
        result[servo_id] = (float(values[0]), float(values[1]))
    return result


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)
