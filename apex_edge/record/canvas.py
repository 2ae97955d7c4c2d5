"""Drawing with OpenCV that looks the same at 640x480 and at 1920x1080."""

import zlib
from typing import Dict, List, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.types import Array

Bgr = Tuple[int, int, int]
Box = Tuple[float, float, float, float]
"""x, y, width, height in pixels."""

INK: Bgr = (245, 245, 245)
DIM: Bgr = (190, 184, 178)
PANEL: Bgr = (34, 28, 24)
SAFE: Bgr = (110, 205, 80)
BEST: Bgr = (250, 235, 90)
DANGER: Bgr = (70, 70, 240)
AMBER: Bgr = (50, 170, 245)
ARM: Bgr = (245, 170, 70)
UNSAFE: Bgr = (120, 116, 112)

NAMED: Dict[str, Bgr] = {
    "red": (70, 70, 235),
    "green": (90, 200, 70),
    "blue": (235, 140, 60),
    "yellow": (60, 220, 245),
    "orange": (40, 145, 250),
    "purple": (215, 110, 170),
    "pink": (190, 140, 250),
    "white": (240, 240, 240),
    "black": (60, 60, 60),
}

_FONT = cv2.FONT_HERSHEY_SIMPLEX
_BOLD = cv2.FONT_HERSHEY_DUPLEX
_SHIFT = 4


def name_colour(name: str) -> Bgr:
    """Return the colour to draw an object in: its own where the name says it, else a steady one."""
    for word, colour in NAMED.items():
        if word in name.lower():
            return colour
    hue = zlib.crc32(name.encode("utf-8")) % 180
    pixel = cv2.cvtColor(np.array([[[hue, 150, 235]]], dtype=np.uint8), cv2.COLOR_HSV2BGR)[0, 0]
    return int(pixel[0]), int(pixel[1]), int(pixel[2])


class Canvas:
    """A picture to draw on; lengths are in units of a 640x480 picture's pixel, places in pixels.

    Parameters
    ----------
    picture : (h, w, 3) uint8 BGR, drawn on in place.
    """

    def __init__(self, picture: Array) -> None:
        """Choose the scale from the size."""
        self.picture = picture
        self.height, self.width = picture.shape[:2]
        self.scale = min(4.0, max(0.4, min(self.width / 640.0, self.height / 480.0)))
        self._taken: List[Box] = []

    def line(self, a: Sequence[float], b: Sequence[float], colour: Bgr, width: float = 1.5) -> None:
        """Draw a straight line between two points."""
        if _are_drawable(a, b):
            cv2.line(
                self.picture, _fixed(a), _fixed(b), colour, self._px(width), cv2.LINE_AA, _SHIFT
            )

    def dashes(self, a: Sequence[float], b: Sequence[float], colour: Bgr, width: float) -> None:
        """Draw a dashed line between two points."""
        start, end = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        if not _are_drawable(a, b):
            return
        n = max(1, int(np.hypot(*(end - start)) / (9.0 * self.scale)))
        for i in range(min(n, 200)):
            piece = start + (end - start) * np.array([[i / n], [(i + 0.55) / n]])
            self.line(piece[0], piece[1], colour, width)

    def arrow(self, a: Sequence[float], b: Sequence[float], colour: Bgr, width: float = 2) -> None:
        """Draw an arrow from ``a`` to ``b`` with a dark edge; shorter than 3 units is left out."""
        if not _are_drawable(a, b):
            return
        length = float(np.hypot(b[0] - a[0], b[1] - a[1]))
        if length < 3.0 * self.scale:
            return
        tip = min(0.5, 9.0 * self.scale / length)
        ends = (int(a[0]), int(a[1])), (int(b[0]), int(b[1]))
        for edge, ink in ((width + 2.0, PANEL), (width, colour)):
            cv2.arrowedLine(
                self.picture, ends[0], ends[1], ink, self._px(edge), cv2.LINE_AA, 0, tip
            )

    def ring(self, at: Sequence[float], radius_px: float, colour: Bgr, width: float = 2) -> None:
        """Draw a circle line; ``radius_px`` is in pixels."""
        if _are_drawable(at) and 0 < radius_px < 10000:
            radius = int(radius_px * (1 << _SHIFT))
            cv2.circle(
                self.picture, _fixed(at), radius, colour, self._px(width), cv2.LINE_AA, _SHIFT
            )

    def disc(self, at: Sequence[float], radius: float, colour: Bgr) -> None:
        """Draw a filled circle; ``radius`` is in units."""
        if _are_drawable(at):
            size = int(max(0.8, radius * self.scale) * (1 << _SHIFT))
            cv2.circle(self.picture, _fixed(at), size, colour, -1, cv2.LINE_AA, _SHIFT)

    def dots(self, pixels: Array, radius: float, colours: Array) -> None:
        """Draw many small discs at once: ``pixels (n, 2)``, ``colours (n, 3)`` uint8 BGR.

        A loop over cv2.circle costs 20 us a point; this costs less than 1.
        """
        reach = max(0.8, radius * self.scale)
        span = np.arange(-int(reach), int(reach) + 1)
        dx, dy = np.meshgrid(span, span)
        is_inside = dx * dx + dy * dy <= reach * reach
        is_near = (np.abs(np.nan_to_num(pixels, nan=1e9)) < 20000.0).all(axis=1)
        at = np.rint(pixels[is_near]).astype(np.int64)
        inks = colours[is_near]
        for x, y in zip(dx[is_inside], dy[is_inside]):
            column, row = at[:, 0] + x, at[:, 1] + y
            ok = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
            self.picture[row[ok], column[ok]] = inks[ok]

    def panel(self, box: Box, colour: Bgr, alpha: float, radius: float = 5.0) -> None:
        """Lay a translucent rounded rectangle over the picture."""
        x0, y0 = max(0, int(box[0])), max(0, int(box[1]))
        x1, y1 = min(self.width, int(box[0] + box[2])), min(self.height, int(box[1] + box[3]))
        if x1 <= x0 or y1 <= y0:
            return
        under = self.picture[y0:y1, x0:x1]
        over = under.copy()
        w, h = x1 - x0 - 1, y1 - y0 - 1
        r = int(min(radius * self.scale, w / 2, h / 2))
        cv2.rectangle(over, (r, 0), (w - r, h), colour, -1)
        cv2.rectangle(over, (0, r), (w, h - r), colour, -1)
        for corner in ((r, r), (w - r, r), (r, h - r), (w - r, h - r)):
            cv2.circle(over, corner, r, colour, -1, cv2.LINE_AA)
        cv2.addWeighted(over, alpha, under, 1.0 - alpha, 0.0, dst=under)

    def text(
        self,
        at: Sequence[float],
        words: str,
        colour: Bgr = INK,
        size: float = 13.0,
        is_bold: bool = False,
    ) -> None:
        """Write ASCII text with its vertical middle at ``at``; ``size`` is the line height."""
        font, factor, thick = self._font(size, is_bold)
        (_, high), _ = cv2.getTextSize(words, font, factor, thick)
        origin = (int(at[0]), int(at[1] + high / 2))
        cv2.putText(
            self.picture, ascii_only(words), origin, font, factor, colour, thick, cv2.LINE_AA
        )

    def text_width(self, words: str, size: float = 13.0, is_bold: bool = False) -> float:
        """Return how wide a text comes out, in pixels."""
        font, factor, thick = self._font(size, is_bold)
        return float(cv2.getTextSize(ascii_only(words), font, factor, thick)[0][0])

    def fitted(self, words: str, room_px: float, size: float = 13.0) -> str:
        """Return the text, cut with an ellipsis where it would not fit."""
        if self.text_width(words, size) <= room_px:
            return words
        while words and self.text_width(words + "...", size) > room_px:
            words = words[:-1]
        return words.rstrip() + "..." if words else ""

    def pill(
        self, at: Sequence[float], words: str, fill: Bgr, ink: Bgr = INK, size: float = 13.0
    ) -> float:
        """Draw a label with its left middle at ``at``; return its width in pixels."""
        width = self.text_width(words, size) + 10.0 * self.scale
        height = (size + 5.0) * self.scale
        self.panel((at[0], at[1] - height / 2, width, height), fill, 0.82)
        self.text((at[0] + 5.0 * self.scale, at[1]), words, ink, size)
        return width

    def label(
        self, near: Sequence[float], gap_px: float, words: str, fill: Bgr, ink: Bgr = INK
    ) -> None:
        """Put a label above, below or beside a point, where none is yet and inside the picture."""
        if not _are_drawable(near):
            return
        size = 12.0
        width = self.text_width(words, size) + 10.0 * self.scale
        height = (size + 5.0) * self.scale
        x, y, gap = near[0], near[1], gap_px + 3.0 * self.scale
        places = (
            (x - width / 2, y - gap - height),
            (x - width / 2, y + gap),
            (x + gap, y - height / 2),
            (x - gap - width, y - height / 2),
            (x - width / 2, y - gap - 2.1 * height),
            (x - width / 2, y + gap + 1.1 * height),
        )
        boxes = [(left, top, width, height) for left, top in places]
        free = [box for box in boxes if self._is_free(box)] or boxes[:1]
        left, top = free[0][:2]
        left = min(max(2.0, left), self.width - width - 2.0)
        top = min(max(2.0, top), self.height - height - 2.0)
        self.reserve((left, top, width, height))
        self.pill((left, top + height / 2), words, fill, ink, size)

    def reserve(self, box: Box) -> None:
        """Keep labels off a region."""
        self._taken.append(box)

    def _is_free(self, box: Box) -> bool:
        x, y, w, h = box
        if x < 0 or y < 0 or x + w > self.width or y + h > self.height:
            return False
        return not any(
            x < tx + tw and tx < x + w and y < ty + th and ty < y + h
            for tx, ty, tw, th in self._taken
        )

    def _font(self, size: float, is_bold: bool) -> Tuple[int, float, int]:
        factor = size * self.scale / 30.0
        thick = max(1, int(round(factor * (1.9 if is_bold else 1.5))))
        return (_BOLD if is_bold else _FONT), factor, thick

    def _px(self, width: float) -> int:
        return max(1, int(round(width * self.scale)))


def ascii_only(words: str) -> str:
    """Return text as OpenCV's fonts can show it."""
    return words.replace("\u2192", "->").replace("\u00b1", "+-").encode("ascii", "replace").decode()


def _fixed(point: Sequence[float]) -> Tuple[int, int]:
    return int(point[0] * (1 << _SHIFT)), int(point[1] * (1 << _SHIFT))


def _are_drawable(*points: Sequence[float]) -> bool:
    # OpenCV takes 32-bit fixed point; far outside and NaN are not worth drawing
    return all(abs(point[0]) < 20000.0 and abs(point[1]) < 20000.0 for point in points)
