"""What a cheap RGB-D camera does to a perfect picture: gain, grain, depth noise, holes, glare.

Noise comes from banks that are drawn once and read from a random corner each frame: drawing
921 600 fresh normal numbers would cost more than the whole picture.
"""

from dataclasses import dataclass
from typing import Tuple

import cv2
import numpy as np

from apex_edge.config import setting
from apex_edge.types import Array

SATURATED = 65535
BANK_MARGIN_PX = 64
EDGE_STEP_M = 0.008


@dataclass(frozen=True)
class SensorConfig:
    """Settings of the twin's sensor."""

    exposure_s: float = setting(0.010, "exposure time (s), sets the motion blur", 0.0, 0.1)
    gain: float = setting(1.0, "mean exposure gain", 0.1, 4.0)
    gain_sd: float = setting(0.012, "frame-to-frame spread of the gain", 0.0, 0.3)
    colour_noise: float = setting(3.0, "colour noise per channel (grey levels, sd)", 0.0, 40.0)
    depth_noise_m: float = setting(0.0012, "depth noise at 0.7 m (m, sd); grows as z^2", 0.0, 0.05)
    edge_holes: float = setting(0.5, "share of depth-edge pixels without depth", 0.0, 1.0)
    holes: float = setting(5.0, "mean number of random holes a frame", 0.0, 100.0)
    glare: float = setting(0.3, "mean number of saturated depth patches a frame", 0.0, 100.0)


class Sensor:
    """Turns a clean picture into what the camera hands over; random numbers come from ``rng``."""

    def __init__(
        self, config: SensorConfig, shape: Tuple[int, int], rng: np.random.RandomState
    ) -> None:
        self.config = config
        self._rng = rng
        height, width = shape[0] + BANK_MARGIN_PX, shape[1] + BANK_MARGIN_PX
        grain = rng.standard_normal((height, width, 3)) * config.colour_noise
        self._grain: Array = np.rint(grain).astype(np.int16)
        # Stereo and structured light smear their noise over neighbouring pixels.
        rough = cv2.GaussianBlur(
            rng.standard_normal((height, width)).astype(np.float32), (0, 0), 0.8
        )
        scale = 1000.0 * config.depth_noise_m / 0.7**2
        self._ripple: Array = rough * np.float32(scale / float(rough.std()))
        patchy = cv2.GaussianBlur(rng.uniform(size=(height, width)).astype(np.float32), (0, 0), 0.7)
        level = np.percentile(patchy, 100.0 * config.edge_holes)
        self._patches: Array = (patchy < level).astype(np.uint8)

    def expose(self, colour: Array) -> Array:
        """Return the colour picture (h, w, 3) uint8 with this frame's gain and grain."""
        config = self.config
        gain = max(0.05, config.gain * (1.0 + config.gain_sd * float(self._rng.standard_normal())))
        soft = cv2.GaussianBlur(colour, (3, 3), 0.55)
        lit = cv2.convertScaleAbs(soft, alpha=gain)
        result: Array = cv2.add(lit, self._corner(self._grain, colour.shape[:2]), dtype=cv2.CV_8U)
        return result

    def measure(self, depth_m: Array) -> Array:
        """Return depth (h, w) uint16 in mm from true depth (h, w) float32 in m."""
        shape = depth_m.shape
        noise = cv2.multiply(cv2.multiply(depth_m, depth_m), self._corner(self._ripple, shape))
        depth: Array = cv2.addWeighted(depth_m, 1000.0, noise, 1.0, 0.0, dtype=cv2.CV_32F)
        result: Array = cv2.add(depth, 0.0, dtype=cv2.CV_16U)
        kernel = np.ones((3, 3), np.uint8)
        step = cv2.dilate(depth_m, kernel) - cv2.erode(depth_m, kernel)
        is_hole = (step > EDGE_STEP_M) & self._corner(self._patches, shape).view(bool)
        result[is_hole] = 0
        for _ in range(int(self._rng.poisson(self.config.holes))):
            self._blot(result, 0, 5.0)
        for _ in range(int(self._rng.poisson(self.config.glare))):
            self._blot(result, SATURATED, 8.0)
        return result

    def _corner(self, bank: Array, shape: Tuple[int, ...]) -> Array:
        y, x = self._rng.randint(0, BANK_MARGIN_PX, 2)
        result: Array = bank[y : y + shape[0], x : x + shape[1]]
        return result

    def _blot(self, depth: Array, value: int, size_px: float) -> None:
        """Fill one small ellipse at a random place."""
        height, width = depth.shape
        x, y = self._rng.uniform(0.0, width), self._rng.uniform(0.0, height)
        a, b = 1.0 + size_px * self._rng.uniform(0.2, 1.0, 2)
        angle = self._rng.uniform(0.0, 180.0)
        box = ((float(x), float(y)), (2.0 * float(a), 2.0 * float(b)), float(angle))
        cv2.ellipse(depth, box, value, cv2.FILLED)
