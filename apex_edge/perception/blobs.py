"""Connected regions of one colour: where, how large, and their sub-pixel centre.

The whole picture is only searched coarsely, for boxes; the regions themselves are always taken
at full resolution inside a window. Outlines are traced, not labelled: OpenCV's components with
statistics cost 28 us for a window of 64 px where tracing takes 5 (measured).
"""

import operator
from dataclasses import dataclass
from typing import List, NamedTuple, Optional, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.perception.colour import ColourTable
from apex_edge.perception.lookup import words
from apex_edge.perception.settings import PerceptionConfig
from apex_edge.types import Array

Box = Tuple[int, int, int, int]  # x0, y0, x1, y1; x1 and y1 are just outside
_KERNEL = np.ones((3, 3), np.uint8)
_FRINGE_SHARE = 0.15  # a region must keep this much after losing its rim
_FULL_SHARE = 0.7  # of its outline's area is an object's own colour, but for highlights
_FEW_NAMES = 3  # for so few a comparison each is cheaper than a histogram
_FRAGMENT_SHARE = 0.3  # a piece this small beside a larger one is part of it
_FRAGMENT_GAP_PX = 3
_INLAY_SHARE = 0.1
_SEARCH_PAD = 2  # coarse cells around a coarse box
_RIM = 2  # pixels around a region that may belong to it in part


@dataclass
class Blob:
    """One region: ``label`` of its colour, ``body`` (h, w) uint8 mask of its pixels.

    ``origin_px`` is the picture position of ``body[0, 0]``; ``box_px`` x, y, w, h; ``spread_px2``
    the second central moments xx, xy, yy; ``contours`` count from ``window_px``. ``is_part`` says
    that it was cut out of a region that several objects share.
    """

    label: int
    centre_px: Tuple[float, float]
    area_px2: float
    box_px: Tuple[int, int, int, int]
    touches_border: bool
    is_clipped: bool
    body: Array
    origin_px: Tuple[int, int]
    spread_px2: Tuple[float, float, float]
    contours: Tuple[Array, ...]
    window_px: Tuple[int, int]
    is_part: bool = False

    @property
    def core(self) -> Array:
        """Return the mask without its rim, where colours and depths mix; as large as ``body``."""
        return _erode(self.body)

    def outline_px(self) -> Array:
        """Return the border pixels (k, 2) in the picture."""
        result: Array = np.concatenate(self.contours)[:, 0, :] + np.array(self.window_px)
        return result


class _Piece(NamedTuple):
    """One traced outline: its points, how many pixels it encloses, its box."""

    contour: Array
    area: float
    box: Box


def search(bgr: Array, table: ColourTable, config: PerceptionConfig) -> List[Box]:
    """Return windows that hold every region of any object colour in the whole picture."""
    height, width = bgr.shape[:2]
    stride = max(1, -(-width // config.search_width_px))
    coarse = bgr
    if stride > 1:
        size = (-(-width // stride), -(-height // stride))
        # every stride-th pixel: mixing pixels here would mix colours
        coarse = cv2.resize(bgr, size, interpolation=cv2.INTER_NEAREST)
    found = cv2.min(table.classify(coarse), 1)
    least = 0.5 * config.min_area_px2 / stride**2
    pad = _SEARCH_PAD
    boxes = [
        (
            max(0, (x0 - pad) * stride),
            max(0, (y0 - pad) * stride),
            min(width, (x1 + pad) * stride),
            min(height, (y1 + pad) * stride),
        )
        for _, area, (x0, y0, x1, y1) in _trace(found)
        if area >= least
    ]
    return union(boxes)


def union(boxes: Sequence[Box]) -> List[Box]:
    """Join overlapping boxes until none overlap, so that no pixel is looked at twice."""
    done: List[Box] = []
    waiting = [box for box in boxes if box[2] > box[0] and box[3] > box[1]]
    while waiting:
        box = waiting.pop()
        for index, other in enumerate(done):
            if _overlap(box, other, 0):
                done.pop(index)
                waiting.append(_hull(box, other))
                break
        else:
            done.append(box)
    return sorted(done)


def find(
    bgr: Array, table: ColourTable, windows: Sequence[Box], config: PerceptionConfig
) -> List[Blob]:
    """Return the regions inside disjoint windows, by colour and then by falling area."""
    shape = (bgr.shape[0], bgr.shape[1])
    blobs: List[Blob] = []
    for box in windows:
        x0, y0, x1, y1 = box
        word = words(bgr[y0:y1, x0:x1])
        labels = table.labels(word)
        for label, mask in _present(labels, len(table.names), config.min_area_px2):
            blobs.extend(_regions(mask, _View(label, box, shape, word, table), config))
    return _without_dirt(blobs, shape, config)


def _present(labels: Array, n_names: int, least: float) -> List[Tuple[int, Array]]:
    """Return the labels, 1 .. n_names, that at least so many pixels have, each with its mask."""
    wanted: Sequence[int] = range(1, n_names + 1)
    if n_names > _FEW_NAMES:
        counts = cv2.calcHist([labels], [0], None, [n_names + 1], [0, n_names + 1]).ravel()
        wanted = [label for label in wanted if counts[label] >= least]
    masks = [(label, cv2.compare(labels, label, cv2.CMP_EQ)) for label in wanted]
    return [(label, mask) for label, mask in masks if cv2.countNonZero(mask) >= least]


class _View(NamedTuple):
    """Where a colour is looked for: label, window, size of the picture, words (h, w), table."""

    label: int
    window: Box
    shape: Tuple[int, int]
    word: Array
    table: ColourTable


def _without_dirt(
    blobs: List[Blob], shape: Tuple[int, int], config: PerceptionConfig
) -> List[Blob]:
    """Drop what is too large, or inside another."""
    limit = config.max_area_share * shape[0] * shape[1]
    kept = [blob for blob in blobs if blob.area_px2 <= limit]
    kept = [blob for blob in kept if not any(_is_inlay(blob, other) for other in kept)]
    return sorted(kept, key=lambda blob: (blob.label, -blob.area_px2, blob.box_px))


def _regions(found: Array, view: _View, config: PerceptionConfig) -> List[Blob]:
    solid = cv2.medianBlur(found, 3)
    blobs = []
    for group in _groups(_trace(solid), config.min_area_px2):
        blob = _measure(solid, group, view)
        if blob is not None and blob.area_px2 >= config.min_area_px2:
            blobs.append(blob)
    return blobs


def _trace(mask: Array) -> List[_Piece]:
    """Return the outer outlines of a mask, largest first."""
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    pieces = []
    for contour in contours:
        x, y, w, h = cv2.boundingRect(contour)
        # Pick's theorem: pixels inside and on a lattice polygon
        area = cv2.contourArea(contour) + 0.5 * len(contour) + 1.0
        pieces.append(_Piece(contour, area, (x, y, x + w, y + h)))
    if len(pieces) > 1:
        pieces.sort(key=lambda piece: (-piece.area, piece.box))
    return pieces


def _groups(pieces: Sequence[_Piece], min_area: float) -> List[List[_Piece]]:
    """Group pieces, largest first, into objects: a small one joins the larger one beside it."""
    groups: List[List[_Piece]] = []
    for piece in pieces:
        for group in groups:
            whole = group[0]
            is_small = piece.area <= _FRAGMENT_SHARE * whole.area
            if is_small and _overlap(piece.box, whole.box, _FRAGMENT_GAP_PX):
                group.append(piece)
                break
        else:
            if piece.area < min_area:
                # whatever follows is smaller still and can only be a piece of what stands
                continue
            groups.append([piece])
    return groups


def _measure(solid: Array, group: Sequence[_Piece], view: _View) -> Optional[Blob]:
    """Return the blob of some pieces, or None when it is only a fringe of mixed colours.

    The centre is weighted: what lies inside counts whole whatever its shade, the pixels of the rim
    by how much of them is of the colour (0.02 px instead of 0.07 on drawn balls, measured).
    """
    height, width = solid.shape
    box = group[0].box
    for piece in group[1:]:
        box = _hull(box, piece.box)
    x0, y0 = max(0, box[0] - _RIM), max(0, box[1] - _RIM)
    x1, y1 = min(width, box[2] + _RIM), min(height, box[3] + _RIM)
    contours = [piece.contour for piece in group]
    filled = body = solid[y0:y1, x0:x1]
    if len(group) > 1 or cv2.countNonZero(body) != group[0].area:
        # holes, or something else within the box
        filled = np.zeros(body.shape, np.uint8)
        cv2.drawContours(filled, contours, -1, 255, cv2.FILLED, offset=(-x0, -y0))
        body = cv2.bitwise_and(filled, body)
    if _is_fringe(body, group):
        return None
    # the rim counts by how much of it is of the colour
    coverage = view.table.coverage(view.word[y0:y1, x0:x1], view.label)
    weight = cv2.bitwise_and(cv2.dilate(filled, _KERNEL), coverage)
    moments = cv2.moments(cv2.max(weight, _erode(filled)))
    mass = max(moments["m00"], 1.0)
    left, top, right, bottom = view.window
    n_rows, n_columns = view.shape
    is_cut = (box[0] <= 0, box[1] <= 0, box[2] >= width, box[3] >= height)
    is_border = (left <= 0, top <= 0, right >= n_columns, bottom >= n_rows)
    n_cut = sum(is_cut)
    n_at_border = sum(map(operator.and_, is_cut, is_border)) if n_cut else 0
    return Blob(
        label=view.label,
        centre_px=(left + x0 + moments["m10"] / mass, top + y0 + moments["m01"] / mass),
        area_px2=mass / 255.0,
        box_px=(left + box[0], top + box[1], box[2] - box[0], box[3] - box[1]),
        touches_border=n_at_border > 0,
        is_clipped=n_cut > n_at_border,
        body=body,
        origin_px=(left + x0, top + y0),
        spread_px2=(moments["mu20"] / mass, moments["mu11"] / mass, moments["mu02"] / mass),
        contours=tuple(contours),
        window_px=(left, top),
    )


def _is_fringe(body: Array, group: Sequence[_Piece]) -> bool:
    """Say whether hardly anything of a region is left without its rim.

    A full outline tells by its area and length; a ring, or several pieces, have to be eroded.
    """
    n_body, (contour, area, _) = cv2.countNonZero(body), group[0]
    if len(group) == 1 and n_body >= _FULL_SHARE * area:
        return area - len(contour) < _FRINGE_SHARE * area
    return cv2.countNonZero(_erode(body)) < _FRINGE_SHARE * n_body


def _erode(mask: Array) -> Array:
    """Take one pixel off a mask's rim, but not off the end of its array."""
    result: Array = cv2.erode(mask, _KERNEL)
    return result


def _is_inlay(blob: Blob, other: Blob) -> bool:
    """Say whether a blob is only a highlight or a shaded patch within a much larger one."""
    if blob.area_px2 > _INLAY_SHARE * other.area_px2:
        return False
    x, y, w, h = blob.box_px
    left, top, width, height = other.box_px
    return left <= x and top <= y and x + w <= left + width and y + h <= top + height


def _overlap(a: Box, b: Box, gap: int) -> bool:
    return a[0] < b[2] + gap and b[0] < a[2] + gap and a[1] < b[3] + gap and b[1] < a[3] + gap


def _hull(a: Box, b: Box) -> Box:
    return min(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), max(a[3], b[3])
