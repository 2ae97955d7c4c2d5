"""The 12 pair features of the linear trigger; one source for the trainer and the device.

All are free of units, scaled by the pair's combined radius and the horizon, so that one model
serves balls and blocks. A linear model on raw coordinates is at chance (it cannot form the
products); on these it matches gradient boosting within run noise.
Source: ours; the paper names only "a lightweight linear classifier" (section "Limitations").
"""

from typing import Tuple

import numpy as np

from apex_edge.triggers.approach import Approach, Pairs
from apex_edge.types import Array

FEATURE_SET = "fused12"
FEATURE_VERSION = 1
FEATURE_NAMES: Tuple[str, ...] = (
    "distance",
    "closing",
    "speed",
    "cos",
    "dca",
    "tca",
    "z",
    "reach",
    "z_pos",
    "reach_pos",
    "sigma",
    "z_reach",
)
FEATURE_UNITS: Tuple[str, ...] = (
    "radii",
    "radii per horizon",
    "radii per horizon",
    "1",
    "radii",
    "horizons",
    "sd",
    "sd",
    "sd",
    "sd",
    "radii",
    "sd^2",
)
# A vanishing sd would make z and reach infinite; 0.1 mm is finer than any camera here measures.
SD_FLOOR_M = 1e-4
# Beyond 4 sd the factors of the product say no more; unlimited, it drowned the linear model
# (PR .826 without the limit, .834 with it, on scenes of another seed).
_PRODUCT_SD = 4.0
# As arrays: a Python number is made into one at every call, 0.2 us.
_ZERO, _FLOOR = np.array(0.0), np.array(SD_FLOOR_M)
_LOWEST, _HIGHEST = np.array(-_PRODUCT_SD), np.array(_PRODUCT_SD)


def edge_features(pairs: Pairs, approach: Approach, horizon_s: float) -> Array:
    """Return the features (m, 12) of m pairs, in the order of ``FEATURE_NAMES``.

    z is how many sd the closest approach lies inside (+) or outside (-) the combined radius;
    reach is by how many sd the approach along the line of sight covers the gap by the horizon.
    """
    radius = pairs.radius_m
    rows = np.empty((len(FEATURE_NAMES), len(radius)))
    per_radius = horizon_s / radius
    sd = np.maximum(approach.sd_m, _FLOOR)
    np.divide(approach.distance_m, radius, rows[0])
    np.multiply(approach.closing_m_s, per_radius, rows[1])
    np.multiply(approach.speed_m_s, per_radius, rows[2])
    np.divide(approach.closing_m_s, approach.speed_m_s, rows[3])
    np.divide(approach.near_m[0], radius, rows[4])
    np.divide(approach.tca_s, horizon_s, rows[5])
    inside = np.divide(radius - approach.near_m, sd, rows[6:8])
    np.maximum(inside, _ZERO, out=rows[8:10])
    np.divide(sd[0], radius, rows[10])
    limited = np.minimum(np.maximum(inside, _LOWEST), _HIGHEST)
    np.multiply(limited[0], limited[1], rows[11])
    features: Array = rows.T
    return features


def reach_sds(pairs: Pairs, approach: Approach) -> Array:
    """Return by how many sd (m,) the approach along the line of sight covers the gap."""
    sigma = np.maximum(approach.sd_m[1], SD_FLOOR_M)
    result: Array = (pairs.radius_m - approach.near_m[1]) / sigma
    return result
