"""How far a pose is from what it may not touch: table, workspace box, base, the arm itself.

A clearance is in metres, negative inside; its columns are named by ``names``. Source: ours.
"""

from typing import List, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.arm_file import Limits
from firmware_bridge.kinematics import ArmModel

_POINTS = ("elbow", "wrist", "tip")
_PAIRS = ("forearm and base", "hand and base", "hand and upper arm")
N_COLUMNS = 10
_TINY = 1e-12


def clearances(arm: ArmModel, points_m: Array, limits: Limits) -> Array:
    """Return clearances (n, 10) of poses given by their points (n, 4, 3) from ``forward``.

    Columns: elbow, wrist and tip over the table plane; the same three inside the box; the tip off
    the base; forearm and hand off the base column; hand off the upper arm.
    """
    result = np.empty((len(points_m), N_COLUMNS))
    moving = points_m[:, 1:]
    result[:, :2] = moving[:, :2, 2] - limits.min_link_z_m
    result[:, 2] = moving[:, 2, 2] - limits.min_tip_z_m
    inside = np.minimum(moving - limits.box_low_m, np.asarray(limits.box_high_m) - moving)
    result[:, 3:6] = inside.min(axis=2)
    tip = moving[:, 2]
    axis = arm.links.axis_m
    off_axis = np.hypot(tip[:, 0] - axis[0], tip[:, 1] - axis[1])
    result[:, 6] = np.maximum(off_axis - limits.base_radius_m, tip[:, 2] - limits.base_height_m)
    result[:, 7:] = _off_itself(arm, points_m)
    return result


def told(column: int, value_m: float, points_m: Array, limits: Limits) -> str:
    """Return what is wrong with a pose, given its points (4, 3) and its worst column."""
    place = np.round(points_m, 4)
    if column < 3:
        floor = limits.min_tip_z_m if column == 2 else limits.min_link_z_m
        z_m = points_m[column + 1, 2]
        return f"{_POINTS[column]} comes to z = {z_m:.4f} m, the table plane allows {floor} m"
    if column < 6:
        return (
            f"{_POINTS[column - 3]} leaves the workspace at {place[column - 2].tolist()} m, "
            f"box {limits.box_low_m} to {limits.box_high_m}"
        )
    if column == 6:
        return f"the tip comes to {place[3].tolist()} m, inside the arm's base"
    return f"{_PAIRS[column - 7]} would touch: {-1000.0 * value_m:.1f} mm into each other"


def _off_itself(arm: ArmModel, points_m: Array) -> Array:
    body = arm.body
    shoulder, elbow, wrist, tip = (points_m[:, i] for i in range(4))
    foot = np.empty_like(shoulder)
    foot[:] = (arm.links.axis_m[0], arm.links.axis_m[1], 0.0)
    top = foot.copy()
    top[:, 2] = body.column_height_m
    begin = (elbow, wrist, wrist)
    first = (np.concatenate(begin), np.concatenate((wrist, tip, tip)))
    second = (np.concatenate((foot, foot, shoulder)), np.concatenate((top, top, elbow)))
    apart = segment_distance(first, second).reshape(3, -1).T
    thick = np.array(
        [
            body.column_radius_m + body.forearm_radius_m,
            body.column_radius_m + body.hand_radius_m,
            body.upper_radius_m + body.hand_radius_m,
        ]
    )
    result: Array = apart - thick
    return result


def segment_distance(first: Tuple[Array, Array], second: Tuple[Array, Array]) -> Array:
    """Return the distances (n,) between segments, each given by its two ends (n, 3)."""
    p, q = first[0], second[0]
    u, v, w = first[1] - p, second[1] - q, p - q
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    d, e = _dot(u, w), _dot(v, w)
    free = a * c - b * b
    s = np.clip((b * e - c * d) / np.maximum(free, _TINY), 0.0, 1.0)
    t = np.clip((b * s + e) / np.maximum(c, _TINY), 0.0, 1.0)
    s = np.clip((b * t - d) / np.maximum(a, _TINY), 0.0, 1.0)
    apart = w + s[:, None] * u - t[:, None] * v
    result: Array = np.sqrt(_dot(apart, apart))
    return result


def _dot(a: Array, b: Array) -> Array:
    result: Array = np.einsum("ij,ij->i", a, b)
    return result


def names() -> List[str]:
    """Return what each column of ``clearances`` is about."""
    table = [f"{name} over the table" for name in _POINTS]
    box = [f"{name} in the box" for name in _POINTS]
    return [*table, *box, "tip and base", *_PAIRS]
