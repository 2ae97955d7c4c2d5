"""Connected regions of one colour: where, how large, and their sub-pixel centre.

The whole picture is only searched coarsely, for boxes; the regions themselves are always taken
at full resolution inside a window (0.05 ms an object instead of 0.6 ms a picture, measured).
"""

from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.perception.colour import ColourTable
from apex_edge.perception.settings import PerceptionConfig
from apex_edge.types import Array

Box = Tuple[int, int, int, int]  # x0, y0, x1, y1; x1 and y1 are just outside
_KERNEL = np.ones((3, 3), np.uint8)
_FRINGE_SHARE = 0.15  # a region must keep this much after losing its rim
_FRAGMENT_SHARE = 0.3  # a piece this small beside a larger one is part of it
_FRAGMENT_GAP_PX = 3
_INLAY_SHARE = 0.1
_SEARCH_PAD = 2  # coarse cells around a coarse box


@dataclass
class Blob:
    """One region: ``label`` of its colour, ``core`` (h, w) uint8 mask without its rim.

    ``origin_px`` is the picture position of ``core[0, 0]``; ``box_px`` x, y, w, h.
    """

    label: int
    centre_px: Tuple[float, float]
    area_px2: float
    box_px: Tuple[int, int, int, int]
    touches_border: bool
    is_clipped: bool
    core: Array
    origin_px: Tuple[int, int]


def search(bgr: Array, table: ColourTable, config: PerceptionConfig) -> List[Box]:
    """Return windows that hold every region of any object colour in the whole picture."""
    height, width = bgr.shape[:2]
    stride = max(1, -(-width // config.search_width_px))
    coarse = bgr if stride == 1 else np.ascontiguousarray(bgr[::stride, ::stride])
    mask = (table.classify(coarse) > 0).view(np.uint8)
    mask = cv2.medianBlur(mask, 3)
    _, _, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    least = 0.5 * config.min_area_px2 / stride**2
    found = stats[1:][stats[1:, cv2.CC_STAT_AREA] >= least]
    pad = _SEARCH_PAD
    boxes = [
        (
            max(0, (int(x) - pad) * stride),
            max(0, (int(y) - pad) * stride),
            min(width, (int(x + w) + pad) * stride),
            min(height, (int(y + h) + pad) * stride),
        )
        for x, y, w, h, _ in found
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
        labels = table.classify(bgr[y0:y1, x0:x1])
        counts = np.bincount(labels.ravel(), minlength=len(table.names) + 1)
        for label in np.flatnonzero(counts[1:] >= config.min_area_px2) + 1:
            blobs.extend(_regions(labels == label, int(label), box, shape, config))
    largest: Dict[int, float] = {}
    for blob in blobs:
        largest[blob.label] = max(largest.get(blob.label, 0.0), blob.area_px2)
    limit = config.max_area_share * shape[0] * shape[1]
    kept = [
        blob
        for blob in blobs
        if config.min_relative_area * largest[blob.label] <= blob.area_px2 <= limit
    ]
    kept = [blob for blob in kept if not any(_is_inlay(blob, other) for other in kept)]
    return sorted(kept, key=lambda blob: (blob.label, -blob.area_px2, blob.box_px))


def _regions(
    found: Array, label: int, window: Box, shape: Tuple[int, int], config: PerceptionConfig
) -> List[Blob]:
    mask = cv2.medianBlur(found.astype(np.uint8), 3)
    count, parts, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if count < 2:
        return []
    blobs = []
    for group in _groups(stats, config.min_area_px2):
        x0, y0, x1, y1 = _extent(stats[group])
        piece = parts[y0:y1, x0:x1]
        body = (piece == group[0]) if len(group) == 1 else np.isin(piece, group)
        blob = _measure(body.astype(np.uint8), label, (x0, y0), window, shape)
        if blob is not None and blob.area_px2 >= config.min_area_px2:
            blobs.append(blob)
    return blobs


def _groups(stats: Array, min_area: float) -> List[List[int]]:
    """Group component numbers into objects: a small piece joins the larger one beside it."""
    order = sorted(range(1, len(stats)), key=lambda i: (-int(stats[i, cv2.CC_STAT_AREA]), i))
    groups: List[List[int]] = []
    for index in order:
        area, box = float(stats[index, cv2.CC_STAT_AREA]), _extent(stats[[index]])
        for group in groups:
            whole = stats[group[0]]
            is_piece = area <= _FRAGMENT_SHARE * float(whole[cv2.CC_STAT_AREA])
            if is_piece and _overlap(box, _extent(stats[group[:1]]), _FRAGMENT_GAP_PX):
                group.append(index)
                break
        else:
            if area < min_area:
                # whatever follows is smaller still and can only be a piece of what stands
                continue
            groups.append([index])
    return groups


def _extent(rows: Array) -> Box:
    low = rows[:, :2].min(axis=0)
    high = (rows[:, :2] + rows[:, 2:4]).max(axis=0)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _measure(
    body: Array, label: int, offset: Tuple[int, int], window: Box, shape: Tuple[int, int]
) -> Optional[Blob]:
    """Return the blob of a mask, or None when it is only a fringe of mixed colours."""
    padded = cv2.copyMakeBorder(body, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    contours, _ = cv2.findContours(padded, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    core = cv2.erode(padded, _KERNEL)
    n_body = int(cv2.countNonZero(padded))
    if cv2.countNonZero(core) < _FRINGE_SHARE * n_body:
        return None
    filled = padded.copy()
    cv2.drawContours(filled, contours, -1, 1, cv2.FILLED)
    moments = cv2.moments(filled, binaryImage=True)
    x0, y0 = window[0] + offset[0] - 1, window[1] + offset[1] - 1
    height, width = body.shape
    box = (x0 + 1, y0 + 1, width, height)
    right, bottom = box[0] + width, box[1] + height
    at_edge = (box[0] <= window[0], box[1] <= window[1], right >= window[2], bottom >= window[3])
    at_border = (box[0] <= 0, box[1] <= 0, right >= shape[1], bottom >= shape[0])
    return Blob(
        label=label,
        centre_px=(x0 + moments["m10"] / moments["m00"], y0 + moments["m01"] / moments["m00"]),
        area_px2=float(moments["m00"]),
        box_px=box,
        touches_border=any(at_border),
        is_clipped=any(e and not b for e, b in zip(at_edge, at_border)),
        core=core,
        origin_px=(x0, y0),
    )


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
