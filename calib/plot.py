"""What the pictures that calibrations leave share: lines of text, the verdict's panel, charts."""

import textwrap
from typing import Optional, Sequence, Tuple, Union

import cv2
import numpy as np

from apex_edge.types import Array
from calib.verdict import PASS, WARN, Verdict

Bgr = Tuple[int, int, int]
Range = Tuple[float, float]
Numbers = Union[Array, Sequence[float]]
INK: Bgr = (40, 40, 40)
GRID: Bgr = (222, 222, 222)
BLUE: Bgr = (180, 110, 40)
ORANGE: Bgr = (30, 130, 235)
GREEN: Bgr = (80, 150, 50)
RED: Bgr = (50, 50, 210)
FOUND: Bgr = (60, 190, 250)  # over photos: what was found, and what was expected
EXPECTED: Bgr = (110, 205, 80)
WIDTH_PX = 960
_GRADES = {PASS: (110, 205, 80), WARN: (50, 170, 245)}
_REFUSED: Bgr = (70, 70, 240)
_PANEL, _PANEL_INK, _LINE_PX = (28, 24, 22), (240, 240, 240), 24
_LETTER_PX = 8  # wide, about
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHIFT = 4


def sheet(height_px: int) -> Array:
    """Return a white picture (h, w, 3)."""
    return np.full((height_px, WIDTH_PX, 3), 255, dtype=np.uint8)


def enlarged(photo: Array) -> Tuple[Array, int]:
    """Return a photo (h, w, 3) at least as wide as a sheet, and how many times larger it is."""
    scale = max(1, -(-WIDTH_PX // photo.shape[1]))
    return cv2.resize(photo, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC), scale


def write(
    picture: Array, text: str, at_px: Tuple[int, int], size: float = 0.4, colour: Bgr = INK
) -> None:
    """Write one line of ASCII text with its baseline starting at ``at_px``, smaller if it must."""
    (width, _), _ = cv2.getTextSize(text, _FONT, size, 1)
    size *= min(1.0, (picture.shape[1] - at_px[0] - 6) / max(1, width))
    cv2.putText(picture, text, at_px, _FONT, size, colour, 1, cv2.LINE_AA)


def label(
    picture: Array, text: str, at_px: Tuple[int, int], size: float, colour: Bgr = _PANEL_INK
) -> None:
    """Write a few words over a photo, with a dark rim; cut off where the photo ends."""
    cv2.putText(picture, text, at_px, _FONT, size, _PANEL, 4, cv2.LINE_AA)
    cv2.putText(picture, text, at_px, _FONT, size, colour, 1, cv2.LINE_AA)


def disc(picture: Array, at_px: Array, radius_px: float, colour: Bgr, line_px: int = -1) -> None:
    """Draw a filled circle, or a ring of ``line_px``, to a fraction of a pixel."""
    radius = round(radius_px * (1 << _SHIFT))
    cv2.circle(picture, _fixed(at_px), radius, colour, line_px, cv2.LINE_AA, _SHIFT)


def stroke(picture: Array, a_px: Array, b_px: Array, colour: Bgr, line_px: int = 1) -> None:
    """Draw a line between two points, to a fraction of a pixel."""
    cv2.line(picture, _fixed(a_px), _fixed(b_px), colour, line_px, cv2.LINE_AA, _SHIFT)


def _fixed(point: Array) -> Tuple[int, int]:
    return round(float(point[0]) * (1 << _SHIFT)), round(float(point[1]) * (1 << _SHIFT))


def with_panel(picture: Array, verdict: Verdict, headline: str, facts: Sequence[str]) -> Array:
    """Return the picture (h, w, 3) with a panel below: verdict, facts, and the reasons in full."""
    grade = _GRADES.get(verdict.grade, _REFUSED)
    told = [(f"{verdict.grade.upper()}   {headline}", grade)]
    told += [(fact, _PANEL_INK) for fact in facts]
    told += [(reason, grade) for reason in verdict.reasons]
    n_letters = picture.shape[1] // _LETTER_PX
    lines = [(part, colour) for line, colour in told for part in textwrap.wrap(line, n_letters)]
    panel = np.empty((_LINE_PX * len(lines) + 12, picture.shape[1], 3), np.uint8)
    panel[:] = _PANEL
    for number, (line, colour) in enumerate(lines):
        write(panel, line, (10, _LINE_PX * (number + 1) - 4), 0.5, colour)
    return np.vstack([picture, panel])


class Chart:
    """Axes inside a box (x, y, width, height) px of a picture; draws in data units.

    Values outside the ranges are drawn at the edge.
    """

    def __init__(
        self,
        picture: Array,
        box: Tuple[int, int, int, int],
        x_range: Range,
        y_range: Range,
        title: str = "",
    ) -> None:
        self._picture, self._box = picture, box
        self._x, self._y = _wide(x_range), _wide(y_range)
        x, y, w, h = box
        write(picture, title, (x, y - 6))
        for value in _ticks(self._x, w / 70.0):
            column = int(self._place([value], [self._y[0]])[0, 0]) >> _SHIFT
            cv2.line(picture, (column, y), (column, y + h), GRID)
            write(picture, f"{value:g}", (column - 8, y + h + 14), 0.35)
        for value in _ticks(self._y, h / 35.0):
            line = int(self._place([self._x[0]], [value])[0, 1]) >> _SHIFT
            cv2.line(picture, (x, line), (x + w, line), GRID)
            write(picture, f"{value:g}", (x - 38, line + 4), 0.35)
        cv2.rectangle(picture, (x, y), (x + w, y + h), INK)

    def line(self, x: Numbers, y: Numbers, colour: Bgr, width_px: int = 1) -> None:
        """Draw a line through points (n,)."""
        points = self._place(x, y).reshape(-1, 1, 2)
        cv2.polylines(self._picture, [points], False, colour, width_px, cv2.LINE_AA, _SHIFT)

    def dots(
        self,
        x: Numbers,
        y: Numbers,
        colour: Bgr,
        names: Optional[Sequence[str]] = None,
    ) -> None:
        """Draw dots (n,), each with its name beside it where there are names."""
        for index, place in enumerate(self._place(x, y) / (1 << _SHIFT)):
            disc(self._picture, place, 3.0, colour)
            if names is not None:
                beside = (int(place[0]) + 4, int(place[1]) - 3)
                write(self._picture, names[index], beside, 0.32)

    def bars(self, x: Numbers, y: Numbers, width: float, colour: Bgr) -> None:
        """Draw bars (n,) from zero; ``width`` in units of x."""
        low = self._place(np.asarray(x) - 0.5 * width, np.zeros(len(x))) >> _SHIFT
        high = self._place(np.asarray(x) + 0.5 * width, y) >> _SHIFT
        for a, b in zip(low, high):
            first, second = (int(a[0]), int(a[1])), (int(b[0]), int(b[1]))
            cv2.rectangle(self._picture, first, second, colour, -1)

    def level(self, y: float, colour: Bgr) -> None:
        """Draw a level line across the chart."""
        self.line(list(self._x), [y, y], colour)

    def _place(self, x: Numbers, y: Numbers) -> Array:
        left, top, w, h = self._box
        across = (np.clip(x, *self._x) - self._x[0]) / (self._x[1] - self._x[0])
        up = (np.clip(y, *self._y) - self._y[0]) / (self._y[1] - self._y[0])
        pixels = np.column_stack([left + w * across, top + h * (1.0 - up)])
        result: Array = np.rint(pixels * (1 << _SHIFT)).astype(np.int32)
        return result


def span(values: Numbers, margin: float = 0.08) -> Range:
    """Return a range that holds all finite values with some margin."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    if not len(finite):
        return 0.0, 1.0
    edge = margin * max(float(np.ptp(finite)), 1e-9)
    return float(finite.min()) - edge, float(finite.max()) + edge


def _wide(bounds: Range) -> Range:
    low, high = bounds
    return (low, high) if high - low > 1e-12 else (low - 0.5, high + 0.5)


def _ticks(bounds: Range, n_wanted: float) -> Array:
    """Return round numbers inside a range, about ``n_wanted`` of them."""
    low, high = bounds
    raw = (high - low) / max(n_wanted, 1.0)
    power = 10.0 ** np.floor(np.log10(raw))
    step = power * min((1, 2, 5, 10), key=lambda each: abs(each - raw / power))
    ticks = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    result: Array = np.where(np.abs(ticks) < 1e-9 * step, 0.0, ticks)
    return result
