"""The table as the calibrated camera sees it: a 5 cm grid, the axes and the board, over a photo."""

from typing import Optional, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.geometry import project
from apex_edge.types import Array, CameraModel
from calib.table import WORKSPACE_X_M, WORKSPACE_Y_M, Sighting, TableResult
from calib.verdict import PASS, WARN

STEP_M = 0.05
GRID, EDGE, FOUND, EXPECTED = (200, 170, 90), (90, 220, 250), (60, 190, 250), (110, 205, 80)
AXES = ((70, 70, 240), (110, 205, 80), (245, 150, 70))  # x red, y green, z blue
GRADES = {PASS: (110, 205, 80), WARN: (50, 170, 245)}
REFUSED = (70, 70, 240)
MIN_WIDTH_PX = 960
_SHIFT = 4
_FONT = cv2.FONT_HERSHEY_SIMPLEX


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
    scale = max(1, -(-MIN_WIDTH_PX // camera.width_px))
    frame = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    _grid(frame, camera, scale)
    reach = 0.1
    for axis, name, colour in zip(np.eye(3), "xyz", AXES):
        _line(frame, camera, np.array([np.zeros(3), reach * axis]), (colour, 3 * scale))
        _label(frame, camera, 1.15 * reach * axis, f"{name}", colour)
    for found in (shown.pixels + 0.5) * scale:
        _ring(frame, found, 4.0 * scale, FOUND)
    table = np.column_stack([shown.table_m, np.full(len(shown.table_m), result.height_m)])
    for expected in (project(camera, table)[0] + 0.5) * scale:
        _ring(frame, expected, 1.5 * scale, EXPECTED)
    return np.vstack([frame, _panel(_lines(result), result.verdict.grade, frame.shape[1])])


def _grid(frame: Array, camera: CameraModel, scale: float) -> None:
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
        _label(frame, camera, np.array([value, 0.0, 0.0]), f"{100 * value:.0f}", EDGE)
    for value in y[::2]:
        if abs(value) > 1e-6:
            _label(frame, camera, np.array([0.0, value, 0.0]), f"{100 * value:.0f}", EDGE)


def _line(
    frame: Array, camera: CameraModel, table_m: Array, style: Tuple[Tuple[int, int, int], float]
) -> None:
    pixels = (project(camera, table_m)[0] + 0.5) * frame.shape[1] / camera.width_px
    far = 4.0 * max(frame.shape)
    for a, b in zip(pixels, pixels[1:]):
        # also skips NaN, which a point behind the camera gives
        if np.abs(a).max() < far and np.abs(b).max() < far:
            cv2.line(frame, _fixed(a), _fixed(b), style[0], int(style[1]), cv2.LINE_AA, _SHIFT)


def _label(
    frame: Array, camera: CameraModel, at_m: Array, words: str, colour: Tuple[int, int, int]
) -> None:
    place = project(camera, at_m)[0][0] * frame.shape[1] / camera.width_px
    if np.abs(place).max() < 4.0 * max(frame.shape):
        spot = (round(float(place[0])) + 4, round(float(place[1])) - 4)
        cv2.putText(frame, words, spot, _FONT, 0.6, (30, 30, 30), 4, cv2.LINE_AA)
        cv2.putText(frame, words, spot, _FONT, 0.6, colour, 1, cv2.LINE_AA)


def _ring(frame: Array, centre: Array, radius: float, colour: Tuple[int, int, int]) -> None:
    size = round(radius * (1 << _SHIFT))
    cv2.circle(frame, _fixed(centre), size, colour, 2, cv2.LINE_AA, _SHIFT)


def _fixed(point: Array) -> Tuple[int, int]:
    return round(float(point[0]) * (1 << _SHIFT)), round(float(point[1]) * (1 << _SHIFT))


def _lines(result: TableResult) -> Sequence[str]:
    eye, sd = 1e3 * result.camera.table_from_cam[:3, 3], 1e3 * result.position_sd_m
    return [
        f"{result.verdict.grade.upper()}   left-out points foretold to "
        f"{result.leave_one_out_mm:.2f} mm, map moves {result.workspace_mm:.2f} mm; "
        f"RMS {result.rms_px:.2f} px over {len(result.residuals_px)} points",
        f"camera at x {eye[0]:.0f}  y {eye[1]:.0f}  z {eye[2]:.0f} mm  "
        f"(sd {sd[0]:.1f}  {sd[1]:.1f}  {sd[2]:.1f})",
        "grid every 5 cm, numbers in cm; orange: found, green: expected",
        *result.verdict.reasons,
    ]


def _panel(lines: Sequence[str], grade: str, width: int) -> Array:
    panel = np.full((24 * len(lines) + 12, width, 3), 26, np.uint8)
    for number, line in enumerate(lines):
        is_verdict = number == 0 or number > 2
        colour = GRADES.get(grade, REFUSED) if is_verdict else (240, 240, 240)
        (length, _), _ = cv2.getTextSize(line, _FONT, 0.5, 1)
        size = 0.5 * min(1.0, (width - 20) / max(1, length))
        place = (10, 24 * (number + 1) - 4)
        cv2.putText(panel, line, place, _FONT, size, colour, 1, cv2.LINE_AA)
    return panel
