"""Blob and depth picture -> object centre on the table, with its size and uncertainty.

The outline of a ball or block is centrally symmetric, so the ray through its blob's centroid runs
through its centre whatever faces are seen. What is left is how far along that ray, and three
things can say it, each with its own sd:

- the depth surface: half the height of the top, for an object that stands on the table; for one
  held above it, the surface distance;
- the known size of a ball against its outline;
- the table plane: an assumption, not a measurement, so it only speaks where no surface is seen (a
  standing object's surface estimate contains the plane already, with the height measured).

``range_fusion`` weighs them. Source: ours (the paper's code has one pixel-per-centimetre constant
and no depth).
"""

import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from apex_edge import geometry
from apex_edge.errors import InputError
from apex_edge.perception.blobs import Blob
from apex_edge.perception.range_fusion import Estimate, fuse
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
# A ball's whole outline is an ellipse: area / area of the ellipse with its moments. On the twin
# 0.985..0.996 for 270 balls, below 0.982 for 95 % of 390 blocks.
_FULL, _ROUND_SIDES = 0.98, 0.75
_OUTLINE_PX = 0.5  # sd of the outline's radius; on the same balls 0.3 RMS
_RADIUS_SHARE = 0.02  # relative sd of a radius that somebody measured


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


class Range(NamedTuple):
    """What a depth picture says inside a mask: median, robust sd (1.4826 MAD), valid share 0..1.

    Median and spread are NaN where nothing in the mask is valid.
    """

    median_m: float
    spread_m: float
    valid_share: float


def range_of(mask: Array, depth_mm: Array, origin_px: Tuple[int, int] = (0, 0)) -> Range:
    """Measure the distance along the optical axis inside a mask; needs no table and no lens.

    Parameters
    ----------
    mask : shape (h, w); what is not 0 counts. For a blob ``range_of(blob.core, depth_mm,
        blob.origin_px)``.
    depth_mm : depth picture (h, w) uint16; 0 (hole) and 65535 (saturated) are ignored.
    origin_px : picture position x, y of ``mask[0, 0]``.

    Raises
    ------
    InputError : no depth picture of uint16, or the mask reaches beyond it.
    """
    rows, columns = np.nonzero(mask)
    rows, columns = rows + origin_px[1], columns + origin_px[0]
    _check_depth(depth_mm, rows, columns)
    depth_m, valid = _valid(depth_mm[rows, columns])
    if not len(depth_m):
        return Range(math.nan, math.nan, 0.0)
    return Range(_median(depth_m), _spread(depth_m), float(np.mean(valid)))


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
    depth, valid = _valid(depth_mm[rows, columns])
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
    blob: Blob,
    depth_mm: Optional[Array],
    camera: CameraModel,
    config: PerceptionConfig,
    ball_radius_m: float = math.nan,
) -> Placed:
    """Return where the blob's object stands; NaN where nothing can be said.

    Parameters
    ----------
    blob : the region; ``depth_mm`` (h, w) uint16 or None.
    camera : lens and pose.
    config : noise figures and limits.
    ball_radius_m : radius of the ball that this must be; NaN when that is not known.
    """
    seen, ray = _look(blob, depth_mm, camera)
    eye = camera.table_from_cam[:3, 3]
    size = _from_size(blob, ray, camera, ball_radius_m)
    measured, assumed = None, None
    if seen is not None and seen.valid_share >= config.min_depth_share:
        measured = _from_depth(seen, ray, camera, config)
    if measured is None:
        if size is not None and eye[2] + size.reach_m * ray[2] < -size.gate_m:
            size = None  # below the table: part of the outline is hidden
        assumed = _from_plane(blob, ray, camera, config, ball_radius_m)
    best = fuse([e for e in (measured, size) if e is not None], assumed)
    if best is None:
        return NOWHERE
    across_m = config.noise_px * best.reach_m / camera.fx_px
    return Placed(eye + best.reach_m * ray, float(np.hypot(across_m, best.sd_m)), best.radius_m)


def _look(
    blob: Blob, depth_mm: Optional[Array], camera: CameraModel
) -> Tuple[Optional[Surface], Array]:
    if depth_mm is None:
        return None, geometry.rays(camera, np.array([blob.centre_px]))[0]
    return surface(blob, depth_mm, camera)


def _from_depth(
    seen: Surface, ray: Array, camera: CameraModel, config: PerceptionConfig
) -> Optional[Estimate]:
    n = len(seen.depth_m)
    if n < _MIN_POINTS:
        return None
    eye = camera.table_from_cam[:3, 3]
    middle = _median(seen.depth_m)
    radius = _half_extent(seen.points_m[:, :2]) + middle / camera.fx_px
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
    bias = config.bias_m if is_standing else max(config.bias_m, 0.3 * radius)
    sd = float(np.hypot(_spread(seen.depth_m) / np.sqrt(n), bias))
    return Estimate(float(reach), sd, radius)


def _from_size(
    blob: Blob, ray: Array, camera: CameraModel, ball_radius_m: float
) -> Optional[Estimate]:
    """Return how far a ball of known radius is, by the area of its outline."""
    if not ball_radius_m > 0.0 or blob.touches_border or blob.is_part or not _is_round(blob):
        return None
    radius_px = math.sqrt(blob.area_px2 / math.pi)
    # the outline's area on the plane at unit depth; the lens stretches it differently everywhere
    x, y = blob.centre_px
    a, b = geometry.rays(camera, np.array([[x + radius_px, y], [x, y + radius_px]])) - ray
    area = blob.area_px2 / radius_px**2 * math.sqrt((a @ a) * (b @ b) - (a @ b) ** 2)
    # exact for a sphere on the optical axis; off the axis its outline is longer by the ray's length
    reach = ball_radius_m * math.sqrt(1.0 + math.pi * math.sqrt(ray @ ray) / area)
    sd = reach * math.hypot(_OUTLINE_PX / radius_px, _RADIUS_SHARE)
    return Estimate(reach, sd, ball_radius_m)


def _is_round(blob: Blob) -> bool:
    """Say whether the whole outline of a ball can be seen: an ellipse, and not a long one."""
    xx, xy, yy = blob.spread_px2
    product = xx * yy - xy * xy
    if product <= 0.0:
        return False
    half = 0.5 * (xx + yy)
    ratio2 = product / (half + math.sqrt(max(0.0, half * half - product))) ** 2
    fullness = blob.area_px2 / (4.0 * math.pi * math.sqrt(product))
    return fullness > _FULL and ratio2 > _ROUND_SIDES**2


def _from_plane(
    blob: Blob, ray: Array, camera: CameraModel, config: PerceptionConfig, ball_radius_m: float
) -> Optional[Estimate]:
    """Return where the ray meets the middle height of what stands on the table."""
    if ray[2] > -1e-3:
        return None
    middle_m = ball_radius_m if ball_radius_m > 0.0 else 0.5 * config.object_height_m
    reach = (middle_m - camera.table_from_cam[2, 3]) / ray[2]
    if reach <= 0.0:
        return None
    radius = math.sqrt(blob.area_px2 / math.pi) * reach / camera.fx_px
    if radius > config.max_radius_m:
        return None
    return Estimate(float(reach), config.plane_bias_m, radius)


def _check_depth(depth_mm: Array, rows: Array, columns: Array) -> None:
    if not isinstance(depth_mm, np.ndarray) or depth_mm.ndim != 2 or depth_mm.dtype != np.uint16:
        found = f"{getattr(depth_mm, 'shape', None)} {getattr(depth_mm, 'dtype', type(depth_mm))}"
        raise InputError(f"expected a depth picture (h, w) of uint16 mm, found {found}")
    height, width = depth_mm.shape
    if len(rows) and not (
        rows.min() >= 0 and rows.max() < height and columns.min() >= 0 and columns.max() < width
    ):
        raise InputError(f"the mask reaches beyond the depth picture of {width}x{height}")


def _valid(raw_mm: Array) -> Tuple[Array, Array]:
    """Return the valid depths in metres and which of ``raw_mm (n,)`` they are."""
    valid = (raw_mm > 0) & (raw_mm < _SATURATED)
    return raw_mm[valid].astype(np.float64) / 1000.0, valid


def _median(values: Array) -> float:
    """Return the upper median (np.median costs ten times as much on a few hundred values)."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _spread(values: Array) -> float:
    return 1.4826 * _median(np.abs(values - _median(values)))


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
