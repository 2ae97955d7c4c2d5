"""Rotations and rigid transforms for calibrations, vectorised over many of them.

Transforms are ``a_from_b (..., 4, 4)``: they take points of frame b to frame a.
Source: textbook exponential map of SO(3).
"""

import numpy as np

from apex_edge.types import Array

_TINY_RAD = 1e-8


def skew(vectors: Array) -> Array:
    """Return the matrices (..., 3, 3) of the cross products with ``vectors`` (..., 3)."""
    v = np.asarray(vectors, dtype=np.float64)
    result = np.zeros(v.shape + (3,))
    result[..., 0, 1], result[..., 0, 2], result[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    result[..., 1, 0], result[..., 2, 0], result[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return result


def turn_from_vector(vectors_rad: Array) -> Array:
    """Return the rotations (..., 3, 3) about ``vectors_rad`` (..., 3) by their length."""
    v = np.asarray(vectors_rad, dtype=np.float64)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    cross = skew(v)
    safe = np.maximum(angle, _TINY_RAD)
    result: Array = (
        np.eye(3)
        + np.where(angle < _TINY_RAD, 1.0, np.sin(safe) / safe) * cross
        + np.where(angle < _TINY_RAD, 0.5, (1.0 - np.cos(safe)) / safe**2) * (cross @ cross)
    )
    return result


def vector_from_turn(turns: Array) -> Array:
    """Return the rotation vectors (..., 3) in radians, at most pi long, of ``turns`` (..., 3, 3).

    By way of the quaternion, which is exact near 0 and near pi alike.
    """
    q = quaternion_from_turn(turns)
    q = np.where(q[..., 3:] < 0.0, -q, q)
    sine = np.linalg.norm(q[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., 3:])
    scale = np.where(sine < _TINY_RAD, 2.0, angle / np.maximum(sine, _TINY_RAD))
    result: Array = q[..., :3] * scale
    return result


def angle_between_rad(a_turns: Array, b_turns: Array) -> Array:
    """Return the angles (...) between rotations (..., 3, 3)."""
    relative = np.swapaxes(a_turns, -1, -2) @ b_turns
    result: Array = np.linalg.norm(vector_from_turn(relative), axis=-1)
    return result


def turn_from_quaternion(quaternions_xyzw: Array) -> Array:
    """Return the rotations (..., 3, 3) of quaternions (..., 4); they need not be of unit length."""
    q = np.asarray(quaternions_xyzw, dtype=np.float64)
    x, y, z, w = np.moveaxis(q / np.linalg.norm(q, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_turn(turns: Array) -> Array:
    """Return unit quaternions x y z w (..., 4) of rotations (..., 3, 3), for any angle."""
    m = np.asarray(turns, dtype=np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    outer = np.empty(m.shape[:-2] + (4, 4))  # 4 q q^T; its longest row is the safest
    outer[..., 0, 0], outer[..., 1, 1] = 1 + xx - yy - zz, 1 - xx + yy - zz
    outer[..., 2, 2], outer[..., 3, 3] = 1 - xx - yy + zz, 1 + xx + yy + zz
    for i, j, value in (
        (0, 1, m[..., 0, 1] + m[..., 1, 0]),
        (0, 2, m[..., 0, 2] + m[..., 2, 0]),
        (1, 2, m[..., 1, 2] + m[..., 2, 1]),
        (0, 3, m[..., 2, 1] - m[..., 1, 2]),
        (1, 3, m[..., 0, 2] - m[..., 2, 0]),
        (2, 3, m[..., 1, 0] - m[..., 0, 1]),
    ):
        outer[..., i, j] = outer[..., j, i] = value
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    rows = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    result: Array = rows / np.linalg.norm(rows, axis=-1, keepdims=True)
    return result


def pose(turns: Array, places_m: Array) -> Array:
    """Return the transforms (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    turns, places_m = np.asarray(turns), np.asarray(places_m)
    result = np.zeros(turns.shape[:-2] + (4, 4))
    result[..., :3, :3], result[..., :3, 3], result[..., 3, 3] = turns, places_m, 1.0
    return result


def inverse(poses: Array) -> Array:
    """Return the inverse transforms (..., 4, 4)."""
    back = np.swapaxes(poses[..., :3, :3], -1, -2)
    return pose(back, -(back @ poses[..., :3, 3:])[..., 0])


def nearest_turn(matrix: Array) -> Array:
    """Return the rotation (3, 3) nearest to a matrix (3, 3)."""
    u, _, vt = np.linalg.svd(matrix)
    keep = np.diag([1.0, 1.0, float(np.sign(np.linalg.det(u @ vt)))])
    result: Array = u @ keep @ vt
    return result


def mean_pose(poses: Array) -> Array:
    """Return the mean (4, 4) of poses (n, 4, 4): chordal mean rotation, mean translation."""
    return pose(nearest_turn(poses[:, :3, :3].sum(axis=0)), poses[:, :3, 3].mean(axis=0))
