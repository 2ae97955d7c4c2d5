"""What a taught object colour is: a Gaussian over chromaticity.

Shading leaves chromaticity alone, so brightness is weighted weakly. Source: ours; APEX says
only "colour segmentation".
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Tuple

import numpy as np

from apex_edge.errors import ColourError
from apex_edge.perception.lookup import N_WORDS
from apex_edge.types import Array

GATE_999 = 16.27  # chi-square, 3 degrees of freedom, 99.9 %
NOISE_COUNTS = 5.0  # per channel: sensor noise and the 565 word's own steps (8 / sqrt(12))
LUMA_SD = 0.45  # of log brightness: a factor of 0.5 to 2 costs little
HUE_SD_RAD = 0.05  # white balance drifts by about this much
SATURATION_SD = 0.2  # relative: motion blur mixes the background in
FLOOR = 0.5  # least share of the model's own saturation
_LEAST_LIGHT = 36.0  # of the strongest channel; a dark green ball in a dim room has 60
_LEAST_HUE = 3.0 * NOISE_COUNTS  # between the strongest and the weakest channel
_DARK = 15.0  # keeps the chromaticity of near-black pixels from exploding


@dataclass(frozen=True)
class ColourModel:
    """One object colour.

    ``chroma (2,)`` and ``chroma_cov (2, 2)`` in the plane of ``features``; ``log_luma`` and its
    sd; ``gate`` is the largest squared Mahalanobis distance (3 degrees of freedom); ``floor`` the
    least share of the model's saturation along its own hue.
    """

    name: str
    chroma: Tuple[float, float]
    chroma_cov: Tuple[Tuple[float, float], Tuple[float, float]]
    log_luma: float
    log_luma_sd: float
    gate: float = GATE_999
    floor: float = FLOOR

    def claim(self) -> Tuple[Array, Array]:
        """Return which words (65536,) are of the colour, and how likely each is (log density)."""
        dist2, density = distance2(self, word_features())
        return (dist2 <= self.gate) & has_hue(), density


def features(bgr: Array) -> Array:
    """Return (n, 3): two brightness-free opponent chromaticities and log brightness.

    Parameters
    ----------
    bgr : shape (n, 3), 0..255.
    """
    blue, green, red = np.asarray(bgr, dtype=np.float64).reshape(-1, 3).T
    total = blue + green + red + _DARK
    result: Array = np.column_stack(
        [
            (2.0 * red - green - blue) / (2.0 * total),
            np.sqrt(3.0) * (green - blue) / (2.0 * total),
            np.log(total / 3.0),
        ]
    )
    return result


def chroma_noise_var(log_luma: Array) -> Array:
    """Return the variance (n,) of either chromaticity that sensor noise makes at a brightness."""
    total = 3.0 * np.exp(np.asarray(log_luma, dtype=np.float64))
    result: Array = 1.5 * NOISE_COUNTS**2 / total**2
    return result


def model_from(name: str, points: Array) -> ColourModel:
    """Fit one colour to feature points (n, 3) that all belong to it.

    The spread is never taken narrower than what noise, white balance, blur and shading do.

    Raises
    ------
    ColourError : fewer than 3 points, or no hue to tell it by.
    """
    if len(points) < 3:
        raise ColourError(f"colour {name!r}: {len(points)} pixels are too few for a model")
    mean = points.mean(axis=0)
    saturation = float(np.hypot(mean[0], mean[1]))
    if saturation < 0.02:
        raise ColourError(
            f"colour {name!r}: saturation {saturation:.3f} is below 0.02; a grey, white or black "
            "object cannot be told by its hue"
        )
    radial = mean[:2] / saturation
    tangent = np.array([-radial[1], radial[0]])
    noise = float(chroma_noise_var(mean[2]))
    spread = (SATURATION_SD * saturation) ** 2 * np.outer(radial, radial)
    spread += ((HUE_SD_RAD * saturation) ** 2 + noise) * np.outer(tangent, tangent)
    cov = np.cov(points[:, :2].T) + spread + noise * np.outer(radial, radial)
    luma_sd = float(np.hypot(points[:, 2].std(), LUMA_SD))
    cross = float(cov[0, 1])
    return ColourModel(
        name=name,
        chroma=(float(mean[0]), float(mean[1])),
        chroma_cov=((float(cov[0, 0]), cross), (cross, float(cov[1, 1]))),
        log_luma=float(mean[2]),
        log_luma_sd=luma_sd,
    )


def distance2(model: ColourModel, points: Array) -> Tuple[Array, Array]:
    """Return squared Mahalanobis distance (n,) and log density (n,) of feature points (n, 3).

    A pixel darker than the model gets the wider spread that noise gives it. Distance is inf below
    the saturation floor.
    """
    chroma = np.asarray(model.chroma)
    (a, b), (_, d) = model.chroma_cov
    extra = chroma_noise_var(points[:, 2]) - float(chroma_noise_var(np.array(model.log_luma)))
    extra = np.maximum(extra, 0.0)
    aa, dd = a + extra, d + extra
    determinant = aa * dd - b * b
    du, dv = points[:, 0] - chroma[0], points[:, 1] - chroma[1]
    luma = (points[:, 2] - model.log_luma) / model.log_luma_sd
    dist2 = (dd * du * du - 2.0 * b * du * dv + aa * dv * dv) / determinant + luma * luma
    saturation = points[:, :2] @ chroma / float(chroma @ chroma)
    dist2 = np.where(saturation >= model.floor, dist2, np.inf)
    density = -0.5 * (dist2 + np.log(determinant) + 2.0 * np.log(model.log_luma_sd))
    return dist2, density


def word_bgr() -> Array:
    """Return blue, green, red (65536, 3) at the middle of each word's cell."""
    word = np.arange(N_WORDS)
    blue, green, red = word & 31, (word >> 5) & 63, word >> 11
    result: Array = np.column_stack([blue * 8 + 3.5, green * 4 + 1.5, red * 8 + 3.5])
    return result


@lru_cache(maxsize=1)
def word_features() -> Array:
    """Return ``features`` (65536, 3) at the middle of each word's cell."""
    return features(word_bgr())


@lru_cache(maxsize=1)
def has_hue() -> Array:
    """Say which words (65536,) differ enough between their channels for noise not to have made it.

    Near black every hue is within the noise; shadows and damaged pictures are full of it.
    """
    bgr = word_bgr()
    brightest = bgr.max(axis=1)
    result: Array = (brightest - bgr.min(axis=1) >= _LEAST_HUE) & (brightest >= _LEAST_LIGHT)
    return result
