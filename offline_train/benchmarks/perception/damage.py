"""Make pictures with and without objects, and damage bytes, values and documents, by a seed."""

import json
import math
from typing import Any, Dict, List, Tuple

import cv2
import numpy as np

from apex_edge import documents
from apex_edge.twin.palette import PALETTE
from apex_edge.twin.view import twin_camera_model
from apex_edge.types import Array, CameraModel

SIZE = (160, 120)
GROUND = 150
ODD_VALUES: Tuple[Any, ...] = (
    None, True, "", "x", [], {}, -1, 0, 1e308, -1e308, math.nan, math.inf, [[]], 2**70, "1",
)  # fmt: skip


def camera(width: int = SIZE[0], height: int = SIZE[1]) -> CameraModel:
    """Return the twin's camera at a size."""
    return twin_camera_model(width, height, 560.0 * width / 640.0)


def ground(rng: np.random.RandomState, size: Tuple[int, int] = SIZE) -> Array:
    """Return a grey table with grain: no object in it."""
    width, height = size
    shade = GROUND + 20.0 * rng.uniform(-1.0, 1.0) * np.linspace(-1.0, 1.0, width)
    grain = rng.normal(0.0, 3.0, (height, width, 3))
    result: Array = np.clip(shade[None, :, None] + grain, 0.0, 255.0).astype(np.uint8)
    return result


def balls(rng: np.random.RandomState, n_frames: int, size: Tuple[int, int] = SIZE) -> List[Array]:
    """Return pictures of a red and a green ball that roll over the table."""
    width, height = size
    radius = max(4, height // 10)
    starts = {"red": (0.25 * width, 0.6 * height), "green": (0.7 * width, 0.45 * height)}
    steps = {name: rng.uniform(-2.0, 2.0, 2) for name in starts}
    pictures = []
    for number in range(n_frames):
        picture = ground(rng, size)
        for name, start in starts.items():
            x, y = start + number * steps[name]
            centre = (int(round(16.0 * x)), int(round(16.0 * y)))
            cv2.circle(picture, centre, 16 * radius, PALETTE[name], -1, cv2.LINE_AA, 4)
        pictures.append(picture)
    return pictures


def depth_of(picture: Array, distance_mm: int = 650) -> Array:
    """Return a plain depth picture (h, w) uint16 for a colour picture."""
    return np.full(picture.shape[:2], distance_mm, dtype=np.uint16)


def blank(rng: np.random.RandomState) -> Array:
    """Return a picture of one shade of grey, black or white."""
    level = (0, 255, int(rng.randint(0, 256)))[int(rng.randint(0, 3))]
    return np.full((SIZE[1], SIZE[0], 3), level, dtype=np.uint8)


def noise(rng: np.random.RandomState) -> Array:
    """Return a picture of nothing but noise: per pixel in colour, or blotches of grey."""
    shape = (SIZE[1], SIZE[0], 3)
    kind = int(rng.randint(0, 4))
    if kind == 0:
        return rng.randint(0, 256, shape).astype(np.uint8)
    if kind == 1:
        level, sd = rng.uniform(0.0, 255.0), rng.uniform(1.0, 80.0)
        return np.clip(rng.normal(level, sd, shape), 0, 255).astype(np.uint8)
    grey = rng.randint(0, 256, (SIZE[1], SIZE[0])).astype(np.uint8)
    if kind == 2:
        grey = cv2.GaussianBlur(grey, (0, 0), float(rng.uniform(0.5, 6.0)))
    result: Array = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    return result


def torn(rng: np.random.RandomState, picture: Array) -> Array:
    """Return a picture as a bad cable leaves it: rows shifted, blocks swapped, bits flipped."""
    result = picture.copy()
    kind = int(rng.randint(0, 5))
    height, width = result.shape[:2]
    if kind == 0:
        for row in range(height):
            result[row] = np.roll(result[row], int(rng.randint(-width, width)), axis=0)
    elif kind == 1:
        top = int(rng.randint(0, height))
        result[top:] = rng.randint(0, 256)
    elif kind == 2:
        flat = result.reshape(-1)
        at = rng.randint(0, flat.size, flat.size // 50)
        flat[at] ^= (1 << rng.randint(0, 8, at.size)).astype(np.uint8)
    elif kind == 3:
        result = result[:, :, rng.permutation(3)]
    else:
        y, x = int(rng.randint(0, height // 2)), int(rng.randint(0, width // 2))
        part = result[y : y + height // 2, x : x + width // 2].copy()
        result[-part.shape[0] :, -part.shape[1] :] = part
    return np.ascontiguousarray(result)


def broken(rng: np.random.RandomState, data: bytes) -> bytes:
    """Return bytes cut short, with some changed, with a piece lost or doubled, or none at all."""
    kind = int(rng.randint(0, 8))
    size = len(data)
    at = int(rng.randint(0, max(1, size)))
    if kind <= 1:
        return data[:at]
    if kind <= 4:
        changed = bytearray(data)
        # the first bytes hold what the rest depends on: hit them often
        reach = size if rng.uniform() < 0.5 else min(size, 400)
        for where in rng.randint(0, max(1, reach), int(rng.randint(1, 40))):
            changed[int(where)] = int(rng.randint(0, 256))
        return bytes(changed)
    end = min(size, at + int(rng.randint(1, 2000)))
    if kind == 5:
        return data[:at] + data[end:]
    if kind == 6:
        return data[:end] + data[at:]
    return (b"", b"\0" * size, bytes(rng.randint(0, 256, min(size, 3000)).astype(np.uint8)))[
        int(rng.randint(0, 3))
    ]


def edited(rng: np.random.RandomState, document: Dict[str, Any]) -> Dict[str, Any]:
    """Return a document with one value, anywhere in it, removed or replaced by an odd one."""
    result: Dict[str, Any] = json.loads(json.dumps(document))
    places = list(_places(result))
    holder, key = places[int(rng.randint(0, len(places)))]
    if rng.uniform() < 0.3:
        del holder[key]
    else:
        holder[key] = ODD_VALUES[int(rng.randint(0, len(ODD_VALUES)))]
    return result


def _places(node: Any) -> List[Tuple[Any, Any]]:
    """Return every (container, key) of a JSON value."""
    keys: List[Any] = []
    if isinstance(node, dict):
        keys = sorted(node)
    elif isinstance(node, list):
        keys = list(range(len(node)))
    found = [(node, key) for key in keys]
    for key in keys:
        found += _places(node[key])
    return found


def signed(document: Dict[str, Any]) -> str:
    """Return a document as text with a hash that fits, so that only its values can be wrong."""
    document["sha256"] = documents.digest(document)
    return documents.to_text(document)
