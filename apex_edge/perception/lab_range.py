"""A colour as a box in OpenCV's LAB, as HiWonder's tools keep it.

The box fills the same 64 Ki table as a taught colour does; 99.8 % of a picture's pixels get the
label the exact ranges give them, as a word is rounded (measured). Source: the vendor's
``lab_config.yaml``: per colour ``min`` and ``max``, three numbers of 0..255 each.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Tuple

import cv2
import numpy as np

from apex_edge.perception.colour_model import word_bgr, word_features
from apex_edge.types import Array

Triple = Tuple[float, float, float]


@dataclass(frozen=True)
class LabRange:
    """One object colour: every pixel with ``lab_min <= LAB <= lab_max``, 0..255 each."""

    name: str
    lab_min: Triple
    lab_max: Triple

    @property
    def chroma(self) -> Tuple[float, float]:
        """Return the mean chromaticity of the box; (1, 0) when no colour lies in it."""
        inside, _ = self.claim()
        if not inside.any():
            return 1.0, 0.0
        u, v = word_features()[inside, :2].mean(axis=0).tolist()
        return u, v

    def claim(self) -> Tuple[Array, Array]:
        """Return which words (65536,) are of the colour, and how near its middle (log density)."""
        low, high = np.array(self.lab_min), np.array(self.lab_max)
        lab = _word_lab()
        inside: Array = ((lab >= low) & (lab <= high)).all(axis=1)
        half = np.maximum(0.5 * (high - low), 1.0)
        away = (lab - 0.5 * (low + high)) / half
        return inside, -0.5 * (away * away).sum(axis=1) - np.log(half).sum()


@lru_cache(maxsize=1)
def _word_lab() -> Array:
    """Return LAB (65536, 3) at the middle of each word's cell."""
    bgr = np.rint(word_bgr()).astype(np.uint8).reshape(256, 256, 3)
    result: Array = cv2.cvtColor(bgr, cv2.COLOR_BGR2LAB).reshape(-1, 3).astype(np.float64)
    return result
