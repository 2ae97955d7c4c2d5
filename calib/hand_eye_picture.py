"""The picture of a hand-eye calibration: error of each pose, and the target as each pose saw it."""

import numpy as np

from apex_edge.types import Array
from calib import plot
from calib.hand_eye import HandEyeResult, Solution
from calib.hand_eye_checks import GOOD_DEG, GOOD_MM

_N_NAMED = 4
_VIEWS = (("from above", 0, 1), ("from the side", 0, 2), ("from the front", 1, 2))


def draw(result: HandEyeResult) -> Array:
    """Return a picture (h, w, 3) of a calibration that has a solution.

    Raises
    ------
    ValueError : it has none.
    """
    found = result.solution
    if found is None:
        raise ValueError("nothing was solved, so there is nothing to draw")
    picture = plot.sheet(660)
    _bars(picture, found)
    seen = 1e3 * found.base_from_target[:, :3, 3]
    off = seen - seen.mean(axis=0)
    reach = 1.15 * max(float(np.abs(off).max()), GOOD_MM)
    # names of all would hide each other
    far = np.argsort(-np.linalg.norm(off, axis=1))[:_N_NAMED]
    names = [str(row) if i in far else "" for i, row in enumerate(found.row)]
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    for index, (view, across, up) in enumerate(_VIEWS):
        box = (60 + index * 310, 380, 240, 240)
        label = f"target {view}: {'xyz'[up]} over {'xyz'[across]} (mm)"
        chart = plot.Chart(picture, box, (-reach, reach), (-reach, reach), label)
        chart.line(GOOD_MM * np.cos(angle), GOOD_MM * np.sin(angle), plot.GREEN)
        chart.dots(off[:, across], off[:, up], plot.BLUE, names)
    headline = (
        f"{found.method}, {len(found.row)} of {result.n_pairs} poses; target scatter "
        f"{found.scatter_mm:.2f} mm, {found.scatter_deg:.2f} deg"
    )
    x, y, z = 1e3 * found.gripper_from_cam[:3, 3]
    sd = found.sd_mm
    facts = [
        f"camera on the gripper: x {x:.1f} +- {sd[0]:.1f}   y {y:.1f} +- {sd[1]:.1f}   "
        f"z {z:.1f} +- {sd[2]:.1f} mm (sd)",
        *(f"row {row} left out: {why}" for row, why in result.rejected[:3]),
    ]
    return plot.with_panel(picture, result.verdict, headline, facts)


def _bars(picture: Array, found: Solution) -> None:
    x_range = (0.3, float(found.row.max()) + 0.7)
    for index, (errors, limit, unit) in enumerate(
        ((found.error_mm, GOOD_MM, "mm"), (found.error_deg, GOOD_DEG, "deg"))
    ):
        top = 1.1 * max(float(errors.max()), limit)
        box = (60, 34 + index * 160, 880, 110)
        label = f"error ({unit}) of each row's pose, foretold by the others; line: limit of the RMS"
        chart = plot.Chart(picture, box, x_range, (0.0, top), label)
        chart.bars(found.row, errors, 0.7, plot.BLUE if index == 0 else plot.ORANGE)
        chart.level(limit, plot.GREEN)
