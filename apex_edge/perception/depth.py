"""Blob and depth picture -> object centre on the table, with its size and uncertainty.

The outline of a ball or block is centrally symmetric, so the ray through its blob's centroid runs
through its centre whatever faces are seen. Depth then only has to say how high that centre is:
half the height of the top, for an object that stands on the table. An object held above
the table gets its centre from the surface distance along the ray instead. Source: ours (the
paper's code has one pixel-per-centimetre constant and no depth).
"""

from typing import NamedTuple, Optional, Tuple

import numpy as np

from apex_edge import geometry
from apex_edge.perception.blobs import Blob
from apex_edge.perception.settings import PerceptionConfig
from apex_edge.types import Array, CameraModel

_SATURATED = 65535
_MAX_POINTS = 250
_MIN_POINTS = 12
_LOW = 0.05
_TOP = 0.80  # inside a block's top face, without its noise tail
# A ball's visible surface is a dome, narrow at the top: that tells it from a block. Measured on
# 160 balls and 195 blocks of the twin: top / extent 1.19..1.40 against 1.00..1.06.
_ROUND_TALL, _ROUND_DOME = 1.12, 0.945
_ROUND_TOP = 0.943  # of a ball's height is reached by the top share of its visible surface
_ANGLES = np.deg2rad(np.arange(0.0, 180.0, 15.0))
_DIRECTIONS = np.vstack([np.cos(_ANGLES), np.sin(_ANGLES)])
_EXTENT = 0.96  # of a side lies between the 3rd and 97th percentile
_CENTRE_DEPTH = 0.75  # centre lies this many radii behind a ball's median surface


class Placed(NamedTuple):
    """Where an object stands: ``pos_m (3,)``, its sd (one axis) and its radius, in metres."""

    pos_m: Array
    sd_m: float
    radius_m: float


class Surface(NamedTuple):
    """Valid surface points (n, 3) on the table, their depths (n,) and the valid share 0..1."""

    points_m: Array
    depth_m: Array
    valid_share: float


NOWHERE = Placed(np.full(3, np.nan), float("nan"), float("nan"))


def surface(blob: Blob, depth_mm: Array, camera: CameraModel) -> Tuple[Surface, Array]:
    """Return the blob's visible surface and the viewing ray (3,) through its centroid.

    The rim, holes (0) and saturated values are left out, and so are points far from the median
    depth (mixed pixels, something in front).
    """
    rows, columns = np.nonzero(blob.core)
    if len(rows) > _MAX_POINTS:
        pick = np.linspace(0, len(rows) - 1, _MAX_POINTS).astype(np.int64)
        rows, columns = rows[pick], columns[pick]
    n_seen = len(rows)
    rows, columns = rows + blob.origin_px[1], columns + blob.origin_px[0]
    raw = depth_mm[rows, columns]
    valid = (raw > 0) & (raw < _SATURATED)
    depth = raw[valid].astype(np.float64) / 1000.0
    near = np.ones(len(depth), dtype=bool)
    if len(depth):
        middle = _median(depth)
        reach = 1.5 * max(blob.box_px[2], blob.box_px[3]) * middle / camera.fx_px
        near = np.abs(depth - middle) <= reach
        depth = depth[near]
    pixels = np.empty((len(depth) + 1, 2))
    pixels[0] = blob.centre_px
    pixels[1:, 0], pixels[1:, 1] = columns[valid][near], rows[valid][near]
    rays = geometry.rays(camera, pixels)
    points = camera.table_from_cam[:3, 3] + depth[:, None] * rays[1:]
    return Surface(points, depth, len(depth) / max(1, n_seen)), rays[0]


def place(
    blob: Blob, depth_mm: Optional[Array], camera: CameraModel, config: PerceptionConfig
) -> Placed:
    """Return where the blob's object stands; NaN where nothing can be said."""
    if depth_mm is None:
        ray = geometry.rays(camera, np.array([blob.centre_px]))[0]
        return _from_plane(blob, ray, camera, config)
    seen, ray = surface(blob, depth_mm, camera)
    if seen.valid_share >= config.min_depth_share and len(seen.depth_m) >= _MIN_POINTS:
        placed = _from_depth(seen, ray, camera, config)
        if placed is not None:
            return placed
    return _from_plane(blob, ray, camera, config)


def _from_depth(
    seen: Surface, ray: Array, camera: CameraModel, config: PerceptionConfig
) -> Optional[Placed]:
    eye = camera.table_from_cam[:3, 3]
    n = len(seen.depth_m)
    middle = _median(seen.depth_m)
    pixel_m = middle / camera.fx_px
    radius = _half_extent(seen.points_m[:, :2]) + pixel_m
    heights = np.sort(seen.points_m[:, 2])
    low, mid, top, peak = (float(heights[int(share * n)]) for share in (_LOW, 0.6, _TOP, 0.9))
    height = top
    if top > _ROUND_TALL * 2.0 * radius and mid < _ROUND_DOME * peak:
        height = top / _ROUND_TOP
        radius = 0.5 * height
    if not radius <= config.max_radius_m:
        return None
    # A ball's outline reaches down to 0.4 radii above the table, a block's to the table itself.
    is_standing = ray[2] < -0.2 and top > 0.2 * radius and low < 0.75 * top
    reach = (0.5 * height - eye[2]) / ray[2] if is_standing else middle + _CENTRE_DEPTH * radius
    spread = 1.4826 * _median(np.abs(seen.depth_m - middle))
    sd = float(np.hypot(config.noise_px * pixel_m, spread / np.sqrt(n)))
    bias = config.bias_m if is_standing else max(config.bias_m, 0.3 * radius)
    return Placed(eye + reach * ray, float(np.hypot(sd, bias)), radius)


def _median(values: Array) -> float:
    """Return the upper median (np.median costs ten times as much on a few hundred values)."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _half_extent(points: Array) -> float:
    """Return the half side of the smallest box about (n, 2) points, any yaw, without outliers."""
    along = points @ _DIRECTIONS
    n = len(points)
    first, last = int(0.03 * n), n - 1 - int(0.03 * n)
    ordered = np.partition(along, (first, last), axis=0)
    sides = (ordered[last] - ordered[first]) / _EXTENT
    half = len(_ANGLES) // 2
    best = int(np.argmin(sides[:half] * sides[half:]))
    return 0.25 * float(sides[best] + sides[best + half])


def _from_plane(blob: Blob, ray: Array, camera: CameraModel, config: PerceptionConfig) -> Placed:
    eye = camera.table_from_cam[:3, 3]
    if ray[2] > -1e-3:
        return NOWHERE
    reach = (0.5 * config.object_height_m - eye[2]) / ray[2]
    if reach <= 0.0:
        return NOWHERE
    pixel_m = reach / camera.fx_px
    radius = float(np.sqrt(blob.area_px2 / np.pi)) * pixel_m
    if radius > config.max_radius_m:
        return NOWHERE
    sd = float(np.hypot(config.noise_px * pixel_m, config.plane_bias_m))
    return Placed(eye + reach * ray, sd, radius)
