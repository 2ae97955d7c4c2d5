"""The table as the calibrated camera sees it: a 5 cm grid, the axes and the board, over a photo."""

from typing import Optional, Tuple

import numpy as np

from apex_edge.geometry import project
from apex_edge.types import Array, CameraModel
from calib import plot
from calib.table import WORKSPACE_X_M, WORKSPACE_Y_M, Sighting, TableResult

STEP_M = 0.05
GRID, EDGE = (200, 170, 90), (90, 220, 250)
AXES = ((70, 70, 240), (110, 205, 80), (245, 150, 70))  # x red, y green, z blue


def draw(picture: Optional[Array], result: TableResult, shown: Sighting) -> Array:
    """Return a picture (h, w, 3) uint8 BGR; without a photo the ground is grey.

    Parameters
    ----------
    picture : shape (h, w, 3) uint8 BGR, of the calibration's size.
    shown : the points found in that picture.
    """
    camera = result.camera
    if picture is None:
        picture = np.full((camera.height_px, camera.width_px, 3), 70, np.uint8)
    frame, scale = plot.enlarged(picture)
    _grid(frame, camera, scale)
    reach = 0.1
    for axis, name, colour in zip(np.eye(3), "xyz", AXES):
        _line(frame, camera, np.array([np.zeros(3), reach * axis]), (colour, 3 * scale))
        _label(frame, camera, 1.15 * reach * axis, name, colour)
    for found in (shown.pixels + 0.5) * scale:
        plot.disc(frame, found, 4.0 * scale, plot.FOUND, 2)
    table = np.column_stack([shown.table_m, np.full(len(shown.table_m), result.height_m)])
    for expected in (project(camera, table)[0] + 0.5) * scale:
        plot.disc(frame, expected, 1.5 * scale, plot.EXPECTED, 2)
    return _with_facts(frame, result)


def _grid(frame: Array, camera: CameraModel, scale: int) -> None:
    """Draw lines every 5 cm over the table in and around the workspace, with x and y in cm."""
    x = np.arange(0.0, WORKSPACE_X_M[1] + 1e-9, STEP_M)
    y = np.arange(WORKSPACE_Y_M[0], WORKSPACE_Y_M[1] + 1e-9, STEP_M)
    fine = np.linspace(0.0, 1.0, 40)
    for value in x:
        ends = np.column_stack([np.full(40, value), y[0] + fine * (y[-1] - y[0]), np.zeros(40)])
        _line(frame, camera, ends, (GRID, scale))
    for value in y:
        ends = np.column_stack([fine * x[-1], np.full(40, value), np.zeros(40)])
        _line(frame, camera, ends, (GRID, scale))
    for value in x[2::2]:
        where = np.column_stack([np.full(len(y), value), y[np.argsort(np.abs(y))]])
        _label_inside(frame, camera, where, f"x {round(100 * value)}")
    for value in y[1::2]:
        where = np.column_stack([x, np.full(len(x), value)])
        _label_inside(frame, camera, where, f"y {round(100 * value)}")


def _label_inside(frame: Array, camera: CameraModel, where_m: Array, words: str) -> None:
    """Write words at the first of several places (n, 2) of the table that is well in view."""
    at_m = np.column_stack([where_m, np.zeros(len(where_m))])
    pixels, _ = project(camera, at_m)
    with np.errstate(invalid="ignore"):
        room = (0.92 * camera.width_px, 0.98 * camera.height_px)
        inside = ((pixels >= 0.02 * camera.width_px) & (pixels <= room)).all(axis=1)
    if inside.any():
        _label(frame, camera, at_m[int(np.argmax(inside))], words, EDGE)


def _line(frame: Array, camera: CameraModel, table_m: Array, style: Tuple[plot.Bgr, int]) -> None:
    pixels = (project(camera, table_m)[0] + 0.5) * frame.shape[1] / camera.width_px
    far = 4.0 * max(frame.shape)
    for a, b in zip(pixels, pixels[1:]):
        # also skips NaN, which a point behind the camera gives
        if np.abs(a).max() < far and np.abs(b).max() < far:
            plot.stroke(frame, a, b, *style)


def _label(frame: Array, camera: CameraModel, at_m: Array, words: str, colour: plot.Bgr) -> None:
    place = (project(camera, at_m)[0][0] + 0.5) * frame.shape[1] / camera.width_px
    if np.abs(place).max() < 4.0 * max(frame.shape):
        plot.label(frame, words, (round(place[0]) + 4, round(place[1]) - 4), 0.6, colour)


def _with_facts(frame: Array, result: TableResult) -> Array:
    eye, sd = 1e3 * result.camera.table_from_cam[:3, 3], 1e3 * result.sd_translation_m
    headline = (
        f"left-out points foretold to {result.left_out_mm:.2f} mm, map moves "
        f"{result.workspace_mm:.2f} mm; RMS {result.rms_px:.2f} px over "
        f"{len(result.residuals_px)} points"
    )
    facts = [
        f"camera at x {eye[0]:.0f} +- {sd[0]:.1f}   y {eye[1]:.0f} +- {sd[1]:.1f}   "
        f"z {eye[2]:.0f} +- {sd[2]:.1f} mm (sd)",
        "grid every 5 cm, numbers in cm; orange: found, green: expected",
    ]
    return plot.with_panel(frame, result.verdict, headline, facts)
