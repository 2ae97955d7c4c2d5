"""What never moves: the wooden table, its rails and the floor, painted once per camera."""

from typing import Tuple

import cv2
import numpy as np

from apex_edge.twin.canvas import Canvas, Lens
from apex_edge.twin.palette import SURROUNDINGS
from apex_edge.twin.scene import TABLE_X_M, TABLE_Y_M
from apex_edge.types import Array

FLOOR_M = -0.45
RAIL_HALF_M = 0.008
RAIL_HEIGHT_M = 0.022
PLANK_M = 0.1
TEXELS_PER_M = 1000.0
_SEED = 20


def paint_backdrop(lens: Lens) -> Tuple[Array, Array, Array]:
    """Return colour (h, w, 3) uint8, depth (h, w) float32 in m, and the table mask (h, w) 0/255."""
    ground, floor = _plane_points(lens, 0.0), _plane_points(lens, FLOOR_M)
    x, y = ground[..., 0], ground[..., 1]
    is_table = (x >= TABLE_X_M[0]) & (x <= TABLE_X_M[1]) & (y >= TABLE_Y_M[0]) & (y <= TABLE_Y_M[1])
    colour = np.where(is_table[..., None], _wood(x, y), _carpet(floor))
    # With the camera's unit depth rays, depth along the axis is the share of the ray.
    depth = np.where(is_table, -lens.eye_m[2], FLOOR_M - lens.eye_m[2]) / lens.table_rays[..., 2]
    depth = np.where((depth > 0.0) & (depth < 4.0), depth, 4.0).astype(np.float32)
    picture = np.clip(np.nan_to_num(colour), 0.0, 255.0).astype(np.uint8)
    canvas = Canvas(lens, picture, depth, 0.0)
    middle_x, half_x = 0.5 * sum(TABLE_X_M), 0.5 * (TABLE_X_M[1] - TABLE_X_M[0])
    for side in (-1.0, 1.0):
        edge = TABLE_Y_M[1] + RAIL_HALF_M
        _rail(canvas, (middle_x, side * edge), (half_x + 2.0 * RAIL_HALF_M, RAIL_HALF_M))
        _rail(canvas, (middle_x + side * (half_x + RAIL_HALF_M), 0.0), (RAIL_HALF_M, TABLE_Y_M[1]))
    return canvas.colour, canvas.depth_m, is_table.astype(np.uint8) * np.uint8(255)


def _rail(canvas: Canvas, at: Tuple[float, float], half: Tuple[float, float]) -> None:
    centre = np.array([at[0], at[1], 0.5 * RAIL_HEIGHT_M])
    half_m = np.array([half[0], half[1], 0.5 * RAIL_HEIGHT_M])
    canvas.box(centre, half_m, 0.0, SURROUNDINGS["wall"], np.zeros(3))


def _plane_points(lens: Lens, height_m: float) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (height_m - lens.eye_m[2]) / lens.table_rays[..., 2]
    share = np.where(share > 0.0, share, np.nan)
    result: Array = lens.eye_m + share[..., None] * lens.table_rays
    return result


def _wood(x: Array, y: Array) -> Array:
    """Colour table points as pale planks along y, lit unevenly."""
    rng = np.random.RandomState(_SEED)
    shape = (
        int((TABLE_X_M[1] - TABLE_X_M[0]) * TEXELS_PER_M),
        int((TABLE_Y_M[1] - TABLE_Y_M[0]) * TEXELS_PER_M),
    )
    grain = _smooth_noise(rng, shape, (1, 16), (1.3, 2.8))
    cloud = _smooth_noise(rng, shape, (8, 16), (3.0, 3.8))
    rows = np.arange(shape[0]) / TEXELS_PER_M
    plank = (rows / PLANK_M).astype(int)
    tone = rng.uniform(-0.022, 0.022, plank.max() + 1)[plank]
    seam = np.abs(rows / PLANK_M - np.rint(rows / PLANK_M)) * PLANK_M < 0.0007
    texture = 1.0 + 0.020 * grain + 0.018 * cloud
    texture += (tone - 0.16 * seam)[:, None]
    column = ((y - TABLE_Y_M[0]) * TEXELS_PER_M).astype(np.float32)
    row = ((x - TABLE_X_M[0]) * TEXELS_PER_M).astype(np.float32)
    found = cv2.remap(
        texture.astype(np.float32), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    uneven = 1.05 - 0.55 * ((x - 0.22) ** 2 + (y - 0.10) ** 2)
    shade: Array = np.asarray(found) * uneven
    result: Array = np.asarray(SURROUNDINGS["table"]) * shade[..., None]
    return result


def _smooth_noise(
    rng: np.random.RandomState,
    shape: Tuple[int, int],
    cell: Tuple[int, int],
    sigma: Tuple[float, float],
) -> Array:
    """Return noise (shape) of sd 1, blurred by ``sigma`` cells of ``cell`` texels each."""
    small = rng.standard_normal((shape[0] // cell[0], shape[1] // cell[1])).astype(np.float32)
    soft = np.asarray(cv2.GaussianBlur(small, (0, 0), sigma[1], sigmaY=sigma[0]))
    grown = cv2.resize(soft / soft.std(), shape[::-1], interpolation=cv2.INTER_CUBIC)
    result: Array = np.asarray(grown)
    return result


def _carpet(points: Array) -> Array:
    rng = np.random.RandomState(_SEED + 1)
    speckle = rng.standard_normal(points.shape[:2]).astype(np.float32)
    shade: Array = 0.86 + 0.05 * np.asarray(cv2.GaussianBlur(speckle, (0, 0), 1.2))
    result: Array = np.asarray(SURROUNDINGS["floor"]) * shade[..., None]
    return result
