"""Depth pictures in the camera's own unit -> millimetres."""

from functools import lru_cache

import numpy as np

from apex_edge.types import Array

MM_M = 0.001
SATURATED = 65535


def to_mm(raw: Array, unit_m: float) -> Array:
    """Return depth (h, w) uint16 in mm for raw values (h, w) uint16 of ``unit_m`` metres each.

    A hole (0) stays one, a saturated value (65535) too, and what 65534 mm cannot hold becomes
    saturated.
    """
    # float32 scales, such as 0.0010000000474974513, mean what they look like
    if abs(unit_m - MM_M) < 1e-6 * MM_M:
        return raw
    result: Array = _table(unit_m)[raw]
    return result


@lru_cache(maxsize=4)
def _table(unit_m: float) -> Array:
    # one look-up a pixel, where float arithmetic takes four passes over the picture
    mm = np.rint(np.arange(SATURATED + 1) * (unit_m / MM_M))
    mm[mm >= SATURATED] = SATURATED
    mm[SATURATED] = SATURATED
    table: Array = mm.astype(np.uint16)
    return table
