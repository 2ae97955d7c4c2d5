"""What a lens calibration rests on, as a picture: coverage, residuals, distortion, verdict."""

from typing import Tuple

import cv2
import numpy as np

from apex_edge.geometry import camera_matrix
from apex_edge.types import Array, Intrinsics
from calib import plot
from calib.intrinsics import GRID, IntrinsicsResult

ARROW_PX = 18.0  # the median residual is drawn this long
BORDER, EMPTY, FILLED = (28, 24, 22), (46, 36, 74), (58, 88, 44)
DOT, BENT, COUNT = (235, 200, 90), (170, 170, 170), (200, 200, 200)


def draw(result: IntrinsicsResult) -> Array:
    """Return a picture (h, w, 3) uint8 BGR of all kept corners and how they fit.

    Cells of the 5 x 5 grid are green with corners and dark red without; every corner is a dot with
    its residual, magnified, as an arrow; the bent grid is what the lens makes of a straight one.
    """
    lens = result.lens
    scale = plot.WIDTH_PX / lens.width_px
    frame = coverage_picture(result.coverage, (plot.WIDTH_PX, round(lens.height_px * scale)))
    _bent_grid(frame, lens, scale)
    residuals = np.concatenate(result.residuals_px)
    median_px = max(1e-6, float(np.median(np.linalg.norm(residuals, axis=1))))
    magnified = ARROW_PX / median_px
    for view, residual in zip(result.views, result.residuals_px):
        start = (view.corners_px + 0.5) * scale
        for a, b in zip(start, start + magnified * residual):
            plot.disc(frame, a, 2.0, DOT)
            plot.stroke(frame, a, b, plot.FOUND)
    return _with_facts(frame, result, magnified)


def coverage_picture(coverage: Array, size_px: Tuple[int, int]) -> Array:
    """Return a picture of that size whose cells say where corners are, and how many."""
    width, height = size_px
    frame = np.empty((height, width, 3), np.uint8)
    for row in range(GRID):
        for column in range(GRID):
            count = int(coverage[row, column])
            y0, y1 = height * row // GRID, height * (row + 1) // GRID
            x0, x1 = width * column // GRID, width * (column + 1) // GRID
            share = min(1.0, count / 40.0)
            colour = np.add(FILLED, 30.0 * share) if count else np.array(EMPTY)
            frame[y0:y1, x0:x1] = colour
            frame[y0, x0:x1] = frame[y0:y1, x0] = BORDER
            plot.label(frame, str(count), (x0 + 6, y0 + 18), 0.45, COUNT)
    return frame


def _bent_grid(frame: Array, lens: Intrinsics, scale: float) -> None:
    """Draw straight lines of the scene, evenly spaced, as this lens shows them."""
    inverse = np.linalg.inv(camera_matrix(lens))
    steps = np.linspace(0.0, 1.0, 61)
    for share in np.linspace(0.0, 1.0, 2 * GRID + 1):
        for is_row in (True, False):
            u, v = (steps, np.full(61, share)) if is_row else (np.full(61, share), steps)
            pixels = np.column_stack([u * lens.width_px, v * lens.height_px, np.ones(61)])
            bent, _ = cv2.projectPoints(
                pixels @ inverse.T, np.zeros(3), np.zeros(3), camera_matrix(lens), lens.dist
            )
            points = (bent.reshape(-1, 2) + 0.5) * scale
            if np.abs(points).max() < 1e5:
                for a, b in zip(points, points[1:]):
                    plot.stroke(frame, a, b, BENT)


def _with_facts(frame: Array, result: IntrinsicsResult, magnified: float) -> Array:
    lens, sd = result.lens, result.sd_px
    worst = int(np.argmax(result.view_rms_px))
    headline = (
        f"RMS {result.rms_px:.3f} px over {len(result.views)} views, worst "
        f"{result.views[worst].name}: {result.view_rms_px[worst]:.2f} px; "
        f"{len(result.rejected)} left out"
    )
    facts = [
        f"fx {lens.fx_px:.1f} +- {sd[0]:.1f}   fy {lens.fy_px:.1f} +- {sd[1]:.1f}   "
        f"cx {lens.cx_px:.1f} +- {sd[2]:.1f}   cy {lens.cy_px:.1f} +- {sd[3]:.1f} px (sd)   "
        f"jackknife of fx +- {result.jackknife_px:.1f}",
        "k1 k2 p1 p2 k3 = " + "  ".join(f"{value:.4f}" for value in lens.dist),
        f"arrows: found minus expected, {magnified:.0f} times; numbers: corners per cell; grid: "
        "straight lines as this lens bends them",
    ]
    return plot.with_panel(frame, result.verdict, headline, facts)
