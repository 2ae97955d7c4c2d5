"""Take out of a blob the pieces that depth shows to be something else of its colour; ours.

A small piece beside a large one of the same colour counts as part of it, as an object behind a
finger falls into pieces. A stripe on the wall behind the object looks the same, but not in depth.
"""

from dataclasses import replace
from typing import List, Optional, Sequence

import cv2
import numpy as np

from apex_edge.perception.blobs import Blob
from apex_edge.perception.depth import range_of
from apex_edge.types import Array

_REACH = 1.5  # sizes of the largest piece; the others of one object lie no farther off


def drop_far(blobs: Sequence[Blob], depth_mm: Optional[Array]) -> List[Blob]:
    """Return the blobs without pieces that lie clearly before or behind the largest one.

    Parameters
    ----------
    blobs : as ``blobs.find`` returns them.
    depth_mm : shape (h, w) uint16 or None, which changes nothing.
    """
    if depth_mm is None:
        return list(blobs)
    return [_near_only(blob, depth_mm) if len(blob.contours) > 1 else blob for blob in blobs]


def _near_only(blob: Blob, depth_mm: Array) -> Blob:
    ranges = [range_of(_inside(blob, [c]), depth_mm, blob.origin_px) for c in blob.contours]
    middle_m = ranges[0].median_m
    # no lens is needed for this: the focal length of a camera is about its picture's width
    reach_m = _REACH * max(cv2.boundingRect(blob.contours[0])[2:]) / depth_mm.shape[1] * middle_m
    # written so that a piece without depth stays
    kept = [c for c, r in zip(blob.contours, ranges) if not abs(r.median_m - middle_m) > reach_m]
    return blob if len(kept) == len(blob.contours) else _of_pieces(blob, kept, depth_mm)


def _inside(blob: Blob, contours: Sequence[Array]) -> Array:
    """Return the part of the blob's body that lies inside some of its outlines."""
    result: Array = cv2.bitwise_and(_filled(blob, contours), blob.body)
    return result


def _filled(blob: Blob, contours: Sequence[Array]) -> Array:
    mask = np.zeros(blob.body.shape, np.uint8)
    offset = (blob.window_px[0] - blob.origin_px[0], blob.window_px[1] - blob.origin_px[1])
    cv2.drawContours(mask, list(contours), -1, 255, cv2.FILLED, offset=offset)
    result: Array = mask
    return result


def _of_pieces(blob: Blob, contours: Sequence[Array], depth_mm: Array) -> Blob:
    """Measure a blob anew; without the rim's weights, which costs a twentieth of a pixel."""
    moments = cv2.moments(_filled(blob, contours), binaryImage=True)
    mass = moments["m00"]
    x, y, width, height = cv2.boundingRect(np.concatenate(list(contours)))
    x, y = x + blob.window_px[0], y + blob.window_px[1]
    is_inside = x > 0 and y > 0 and x + width < depth_mm.shape[1] and y + height < depth_mm.shape[0]
    return replace(
        blob,
        centre_px=(
            blob.origin_px[0] + moments["m10"] / mass,
            blob.origin_px[1] + moments["m01"] / mass,
        ),
        area_px2=mass,
        box_px=(x, y, width, height),
        touches_border=blob.touches_border and not is_inside,
        body=_inside(blob, contours),
        spread_px2=(moments["mu20"] / mass, moments["mu11"] / mass, moments["mu02"] / mass),
        contours=tuple(contours),
    )
