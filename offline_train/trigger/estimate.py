"""Motion over a sliding window as perception estimates it: a line, or a parabola where it bends.

Half of the scenes are seen by a plain line fit. The other half by an adaptive one, as the shipped
perception has: a parabola with its own, larger covariance where the bend is significant, else a
line whose covariance owns up to the bend that would have gone unnoticed.
"""

from dataclasses import dataclass
from typing import NamedTuple, Tuple

import numpy as np

from apex_edge.types import Array

# Chi-square of a bend that one straight path in 370 shows, in the plane.
_BENT = 11.8
# No object on the table is thought to speed up harder than this unseen.
_MAX_UNSEEN_M_S2 = 0.5


@dataclass(frozen=True)
class Sensing:
    """How each of n scenes is seen.

    ``frame_s``, ``sd_m``, ``told_sd_m`` (what perception believes of its noise) and ``window``
    frames, each (n,); ``is_adaptive (n,)`` whether bends are looked for.
    """

    frame_s: Array
    sd_m: Array
    told_sd_m: Array
    window: Array
    is_adaptive: Array


class Fit(NamedTuple):
    """``position``, ``velocity``, ``acc (n, f, 2)`` at each frame; ``is_bent (n, f)``."""

    position: Array
    velocity: Array
    acc: Array
    is_bent: Array


def fit(seen: Array, sensing: Sensing) -> Fit:
    """Fit each trailing window of the sightings ``seen (n, f, 2)``; short windows are void."""
    n, n_frames, _ = seen.shape
    index = np.arange(n_frames)
    # Moments of the window about its middle, from running sums; frames count as units of time.
    sums = [np.cumsum(seen * (index[:, None] ** power), axis=1) for power in range(3)]
    sums = [np.concatenate([np.zeros((n, 1, 2)), total], axis=1) for total in sums]
    first = np.maximum(index + 1 - sensing.window[:, None], 0)
    rows = np.arange(n)[:, None]
    m0, m1, m2 = (total[:, 1:] - total[rows, first] for total in sums)
    w = sensing.window[:, None, None].astype(float)
    middle = index[None, :, None] - (w - 1.0) / 2.0
    slope = (m1 - middle * m0) * 12.0 / (w * (w * w - 1.0))
    bend_norm = w * (w * w - 1.0) * (w * w - 4.0) / 180.0
    mean_sq = (w * w - 1.0) / 12.0
    bend = (m2 - 2.0 * middle * m1 + middle * middle * m0 - mean_sq * m0) / bend_norm
    told = sensing.told_sd_m[:, None]
    chi_sq = (bend * bend).sum(axis=2) * bend_norm[..., 0] / (told * told)
    is_bent = sensing.is_adaptive[:, None] & (chi_sq > _BENT)
    bend = np.where(is_bent[..., None], bend, 0.0)
    end = (w - 1.0) / 2.0
    step = sensing.frame_s[:, None, None]
    return Fit(
        position=m0 / w + slope * end + bend * (end * end - mean_sq),
        velocity=(slope + 2.0 * bend * end) / step,
        acc=2.0 * bend / step**2,
        is_bent=is_bent,
    )


def covariance(motion: Fit, sensing: Sensing, rows: Tuple[Array, Array]) -> Array:
    """Return cov (r, 6, 6) of position and velocity for (scene, frame) rows, as published."""
    scene = rows[0]
    line = end_covariance(sensing.told_sd_m, sensing.window, sensing.frame_s, order=2)
    curve = end_covariance(sensing.told_sd_m, sensing.window, sensing.frame_s, order=3)
    velocity = motion.velocity[rows]
    speed_sq = (velocity * velocity).sum(axis=1)
    is_bent = motion.is_bent[rows]
    is_moving = speed_sq > 18.0 * line[scene, 3, 3]
    owns_up = sensing.is_adaptive[scene] & ~is_bent & is_moving
    off_x, off_v = _unseen_bend(sensing)
    extra = np.zeros_like(line)
    axes = np.arange(3)
    extra[:, axes, axes] = (off_x * off_x)[:, None]
    extra[:, axes, axes + 3] = extra[:, axes + 3, axes] = (off_x * off_v)[:, None]
    extra[:, axes + 3, axes + 3] = (off_v * off_v)[:, None]
    chosen = np.where(is_bent[:, None, None], curve[scene], line[scene])
    cov: Array = chosen + np.where(owns_up[:, None, None], extra[scene], 0.0)
    return cov


def moving_speed_sd(sensing: Sensing) -> Array:
    """Return the sd (n,) of velocity published for a straight path of something that moves."""
    line = end_covariance(sensing.told_sd_m, sensing.window, sensing.frame_s, order=2)
    off_v = np.where(sensing.is_adaptive, _unseen_bend(sensing)[1], 0.0)
    sd: Array = np.sqrt(line[:, 3, 3] + off_v * off_v)
    return sd


def end_covariance(sd_m: Array, window: Array, frame_s: Array, order: int) -> Array:
    """Return cov (n, 6, 6) of position and velocity at the newest end of a polynomial fit."""
    cov = np.zeros((len(window), 6, 6))
    axes = np.arange(3)
    for width in np.unique(window):
        design = np.vander(np.arange(1.0 - width, 1.0), order, increasing=True)
        unit = np.linalg.inv(design.T @ design)
        mine = window == width
        variance, step = sd_m[mine] ** 2, frame_s[mine]
        block = np.zeros((len(step), 6, 6))
        block[:, axes, axes] = (unit[0, 0] * variance)[:, None]
        cross = (unit[0, 1] * variance / step)[:, None]
        block[:, axes, axes + 3] = block[:, axes + 3, axes] = cross
        block[:, axes + 3, axes + 3] = (unit[1, 1] * variance / step**2)[:, None]
        cov[mine] = block
    return cov


def _unseen_bend(sensing: Sensing) -> Tuple[Array, Array]:
    """Return the sd (n,) of position and velocity that a bend too weak to be noticed leaves."""
    span = (sensing.window - 1) * sensing.frame_s
    acc_sd = 26.8 * sensing.told_sd_m / np.sqrt(sensing.window) / span**2
    acc_sd = np.minimum(acc_sd, _MAX_UNSEEN_M_S2)
    return acc_sd * span * span / 12.0, acc_sd * span / 2.0
