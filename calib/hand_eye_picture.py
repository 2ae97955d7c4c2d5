"""The picture of a hand-eye calibration: error of each pose, and the target as each pose saw it."""

import numpy as np

from apex_edge.types import Array
from calib import plot
from calib.hand_eye import HandEyeResult, Solution
from calib.hand_eye_checks import GOOD_DEG, GOOD_MM

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
    title = (
        f"hand-eye: {result.verdict.grade}, {found.method}, {len(found.row)} of {result.n_pairs} "
        f"poses, target scatter {found.scatter_mm:.2f} mm {found.scatter_deg:.2f} deg"
    )
    picture = plot.sheet(960, 700, title)
    _bars(picture, found)
    seen = 1e3 * found.base_from_target[:, :3, 3]
    off = seen - seen.mean(axis=0)
    reach = 1.15 * max(float(np.abs(off).max()), GOOD_MM)
    names = [str(row) for row in found.row]
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    for index, (view, x, y) in enumerate(_VIEWS):
        box = (60 + index * 305, 400, 240, 240)
        label = f"target {view}: {'xyz'[x]}, {'xyz'[y]} of the base (mm)"
        chart = plot.Chart(picture, box, (-reach, reach), (-reach, reach), label)
        chart.line(GOOD_MM * np.cos(angle), GOOD_MM * np.sin(angle), plot.GREEN)
        chart.dots(off[:, x], off[:, y], plot.BLUE, names)
    for row, (number, why) in enumerate(result.rejected[:2]):
        plot.write(picture, f"rejected row {number}: {why}", (14, 672 + 16 * row), 0.38, plot.RED)
    return picture


def _bars(picture: Array, found: Solution) -> None:
    x_range = (0.3, float(found.row.max()) + 0.7)
    for index, (errors, limit, unit) in enumerate(
        ((found.error_mm, GOOD_MM, "mm"), (found.error_deg, GOOD_DEG, "deg"))
    ):
        top = 1.1 * max(float(errors.max()), limit)
        box = (60, 60 + index * 160, 880, 110)
        label = (
            f"error of each row's pose, predicted by the others ({unit}); line: limit of the RMS"
        )
        chart = plot.Chart(picture, box, x_range, (0.0, top), label)
        chart.bars(found.row, errors, 0.7, plot.BLUE if index == 0 else plot.ORANGE)
        chart.level(limit, plot.GREEN)
