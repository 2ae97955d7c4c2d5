"""Makers' lens models -> the five coefficients (k1, k2, p1, p2, k3) used everywhere here.

Whatever the model, it bends points; the five coefficients that bend a grid over the whole picture
alike are a linear least-squares problem.
"""

from typing import Sequence

import cv2
import numpy as np

from apex_edge.types import Array, Intrinsics

_N_GRID = 25


def plain_lens(
    size_px: Sequence[int], focal_px: Sequence[float], centre_px: Sequence[float]
) -> Intrinsics:
    """Return a lens without distortion from (w, h), (fx, fy) and (cx, cy)."""
    return Intrinsics(
        width_px=int(size_px[0]),
        height_px=int(size_px[1]),
        fx_px=float(focal_px[0]),
        fy_px=float(focal_px[1]),
        cx_px=float(centre_px[0]),
        cy_px=float(centre_px[1]),
        dist=np.zeros(5),
    )


def from_opencv(lens: Intrinsics, coefficients: Sequence[float]) -> Array:
    """Return the five for OpenCV's 5, 8, 12 or 14 (k1 k2 p1 p2 k3 k4 k5 k6 s1..s4 tx ty)."""
    values = np.asarray(coefficients, dtype=np.float64)
    if not values[5:].any():
        result: Array = np.append(values[:5], np.zeros(max(0, 5 - len(values))))
        return result
    ideal = grid(lens)
    points = np.column_stack([ideal, np.ones(len(ideal))])
    bent, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), values)
    return fit(ideal, bent.reshape(-1, 2))


def fit(ideal: Array, bent: Array) -> Array:
    """Return the five that bend points (n, 2) at unit depth into (n, 2) best."""
    terms = _terms(ideal).reshape(-1, 5)
    result: Array = np.linalg.lstsq(terms, (bent - ideal).ravel(), rcond=None)[0]
    return result


def _terms(points: Array) -> Array:
    """Return (n, 2, 5): what each coefficient adds to x and y."""
    x, y = points.T
    r2 = x * x + y * y
    along_x = [x * r2, x * r2**2, 2.0 * x * y, r2 + 2.0 * x * x, x * r2**3]
    along_y = [y * r2, y * r2**2, r2 + 2.0 * y * y, 2.0 * x * y, y * r2**3]
    result: Array = np.stack([np.column_stack(along_x), np.column_stack(along_y)], axis=1)
    return result


def grid(lens: Intrinsics) -> Array:
    """Return points (n, 2) at unit depth that cover the picture of a lens without distortion."""
    x = (np.linspace(0.0, lens.width_px, _N_GRID) - lens.cx_px) / lens.fx_px
    y = (np.linspace(0.0, lens.height_px, _N_GRID) - lens.cy_px) / lens.fy_px
    result: Array = np.column_stack([part.ravel() for part in np.meshgrid(x, y)])
    return result
