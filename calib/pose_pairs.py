"""Pose pairs of an eye in the hand: where the gripper stood, and how its camera saw a fixed target.

A file has a header line and one row a pose: base->gripper x, y, z (m) and quaternion x, y, z, w,
then camera->target likewise. Source: ours.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import List, Sequence

import numpy as np

from apex_edge.errors import CalibrationError
from apex_edge.geometry import is_rigid
from apex_edge.types import Array
from calib.csv_rows import read_cells, read_numbers
from calib.rigid import pose, quaternion_from_turn, turn_from_quaternion

_PARTS = ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
COLUMNS = tuple(f"{side}_{part}" for side in ("gripper", "target") for part in _PARTS)
# No arm on a table reaches 10 m; millimetres taken for metres always do.
MAX_PLACE_M = 10.0
_UNIT_TOLERANCE = 0.01


@dataclass(frozen=True)
class PosePairs:
    """``base_from_gripper`` and ``cam_from_target`` (n, 4, 4); ``row`` (n,) counts from 1."""

    base_from_gripper: Array
    cam_from_target: Array
    row: Array

    def __len__(self) -> int:
        return len(self.row)

    def pick(self, which: Array) -> "PosePairs":
        """Return some of the pairs, by mask or index (m,)."""
        return PosePairs(
            self.base_from_gripper[which], self.cam_from_target[which], self.row[which]
        )


def pairs_from(base_from_gripper: Array, cam_from_target: Array) -> PosePairs:
    """Return pairs of poses (n, 4, 4) in their order.

    Raises
    ------
    CalibrationError : shapes differ, a number is not finite, or a pose is not rigid.
    """
    gripper = np.asarray(base_from_gripper, dtype=np.float64)
    target = np.asarray(cam_from_target, dtype=np.float64)
    if gripper.shape != target.shape or gripper.ndim != 3 or gripper.shape[1:] != (4, 4):
        raise CalibrationError(
            f"pose pairs must be two arrays (n, 4, 4), found {gripper.shape} and {target.shape}"
        )
    for name, poses in (("base_from_gripper", gripper), ("cam_from_target", target)):
        for index, each in enumerate(poses):
            if not is_rigid(each):
                raise CalibrationError(f"pair {index + 1}: {name} is not a rigid transform")
    return PosePairs(gripper, target, np.arange(1, len(gripper) + 1))


def read_pairs(path: Path) -> PosePairs:
    """Read a file of pose pairs.

    Raises
    ------
    CalibrationError : unreadable, no header, a row with other than 14 finite numbers, a
        quaternion that is not of unit length, or lengths that cannot be metres.
    """
    rows = read_numbers(path, len(COLUMNS))
    _check_order(path, read_cells(path, len(COLUMNS))[0])
    for at, side in ((3, "base->gripper"), (10, "camera->target")):
        _check_quaternions(path, rows, at, side)
        far = np.abs(rows[:, at - 3 : at])
        if (far > MAX_PLACE_M).any():
            row = int(np.argmax((far > MAX_PLACE_M).any(axis=1)))
            raise CalibrationError(
                f"{path}: row {row + 1}: {side} is {far[row].max():.5g} m away, at most "
                f"{MAX_PLACE_M:g} m is possible; lengths must be in metres, not millimetres"
            )
    gripper = pose(turn_from_quaternion(rows[:, 3:7]), rows[:, 0:3])
    target = pose(turn_from_quaternion(rows[:, 10:14]), rows[:, 7:10])
    return PosePairs(gripper, target, np.arange(1, len(rows) + 1))


def pairs_text(pairs: PosePairs) -> str:
    """Return pairs as the text of a file that ``read_pairs`` reads."""
    lines = [",".join(COLUMNS)]
    for gripper, target in zip(pairs.base_from_gripper, pairs.cam_from_target):
        numbers: List[float] = []
        for each in (gripper, target):
            numbers += [*each[:3, 3], *quaternion_from_turn(each[:3, :3])]
        lines.append(",".join(f"{number:.9g}" for number in numbers))
    return "\n".join(lines) + "\n"


def _check_order(path: Path, header: Sequence[str]) -> None:
    """Refuse quaternions that are named in the order w x y z."""
    names = [name.lower().rstrip("_m") for name in header]
    for w, x in zip(_places(names, "qw"), _places(names, "qx")):
        if w < x:
            raise CalibrationError(
                f"{path}: column {header[w]!r} comes before {header[x]!r}; "
                "quaternions must be in the order x, y, z, w"
            )


def _places(names: Sequence[str], ending: str) -> List[int]:
    return [index for index, name in enumerate(names) if name.endswith(ending)]


def _check_quaternions(path: Path, rows: Array, at: int, side: str) -> None:
    length = np.linalg.norm(rows[:, at : at + 4], axis=1)
    is_bad = np.abs(length - 1.0) > _UNIT_TOLERANCE
    if is_bad.any():
        row = int(np.argmax(is_bad))
        raise CalibrationError(
            f"{path}: row {row + 1}: the quaternion of {side} has length {length[row]:.4g}, "
            f"expected 1 within {_UNIT_TOLERANCE:g}; {int(is_bad.sum())} of {len(rows)} rows are so"
        )
