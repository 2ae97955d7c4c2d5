"""What others do with the same pictures and sightings: the peers that ratios are taken against.

Source: the paper's arm code, read and written anew from its description (320x240, blur, LAB,
ranges, open, close, largest contour, enclosing circle; two windows of five frames).
"""

from typing import Mapping, Optional, Tuple

import cv2
import numpy as np

from apex_edge.types import Array

Range = Tuple[Tuple[float, float, float], Tuple[float, float, float]]
SIZE_PX = (320, 240)
MIN_AREA_PX2 = 300.0  # its own, at 320x240: a ball less than 40 px wide at 640x480 is never seen
N_HALF = 5
_KERNEL = np.ones((3, 3), np.uint8)


def lab_range(bgr: Array, disc: Array) -> Range:
    """Return a LAB box about the pixels (h, w) bool of one object, as a user would set it."""
    lab = cv2.cvtColor(bgr, cv2.COLOR_BGR2LAB)[disc].astype(np.float64)
    low, high = np.percentile(lab, [1.0, 99.0], axis=0).tolist()
    margin = 6.0
    return (
        (low[0] - margin, low[1] - margin, low[2] - margin),
        (high[0] + margin, high[1] + margin, high[2] + margin),
    )


def classify_lab(bgr: Array, ranges: Mapping[str, Range]) -> Mapping[str, Array]:
    """Return one mask (h, w) uint8 per colour: LAB conversion and a range each."""
    lab = cv2.cvtColor(bgr, cv2.COLOR_BGR2LAB)
    return {name: cv2.inRange(lab, low, high) for name, (low, high) in ranges.items()}


def paper_centres(
    bgr: Array, ranges: Mapping[str, Range], min_area_px2: float = MIN_AREA_PX2
) -> Mapping[str, Optional[Tuple[float, float]]]:
    """Return the centre of each colour's largest contour in the full picture; None when none."""
    small = cv2.resize(bgr, SIZE_PX, interpolation=cv2.INTER_NEAREST)
    lab = cv2.cvtColor(cv2.GaussianBlur(small, (3, 3), 3), cv2.COLOR_BGR2LAB)
    scale = bgr.shape[1] / float(SIZE_PX[0])
    found = {}
    for name, (low, high) in ranges.items():
        mask = cv2.inRange(lab, low, high)
        mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, _KERNEL)
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, _KERNEL)
        found[name] = _largest(mask, min_area_px2, scale)
    return found


def _largest(mask: Array, min_area_px2: float, scale: float) -> Optional[Tuple[float, float]]:
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    best, best_area = None, min_area_px2
    for contour in contours:
        area = abs(cv2.contourArea(contour))
        if area > best_area:
            best, best_area = contour, area
    if best is None:
        return None
    (x, y), _ = cv2.minEnclosingCircle(best)
    return float(int(x * scale)), float(int(y * scale))


def two_windows(t_s: Array, x: Array) -> Array:
    """Return the paper's speed (n, d) from times (n, m) and positions (n, m, d), m >= 10."""
    new, old = slice(-N_HALF, None), slice(-2 * N_HALF, -N_HALF)
    dt_s = t_s[:, new].mean(axis=1) - t_s[:, old].mean(axis=1)
    result: Array = (x[:, new].mean(axis=1) - x[:, old].mean(axis=1)) / dt_s[:, None]
    return result


def mean_of_five(x: Array) -> Array:
    """Return the paper's position (n, d): the mean of the newest five of (n, m, d)."""
    result: Array = x[:, -N_HALF:].mean(axis=1)
    return result


def line_fit(t_s: Array, x: Array, n_samples: int = 10) -> Array:
    """Return the speed (n, d) of a plain least-squares line through the newest samples."""
    t, newest = t_s[:, -n_samples:], x[:, -n_samples:]
    t = t - t.mean(axis=1, keepdims=True)
    result: Array = (t[..., None] * newest).sum(axis=1) / (t * t).sum(axis=1)[:, None]
    return result
