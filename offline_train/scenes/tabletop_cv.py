"""Four bodies around a centre on a tabletop, all at constant velocity: noise alone is the riddle.

With exact states closest approach would be right every time; what is left is what the velocity
noise of the window costs. Distances in metres, planar. Source: ours.
"""

from typing import Tuple

import numpy as np

from apex_edge.types import Array
from offline_train.scenes.truth import LOOK_AHEAD_S, Truth, passing

NAME = "tabletop-cv"
VERSION = 1
UNIFORM, STILL = 0, 1
KINDS = ("uniform", "still")
N_OTHERS = 4
RADIUS_M = 0.045
_SPEED_M_S = (0.015, 0.4)
_CENTRE_SPEED_M_S = (0.02, 0.1)
_DISTANCE_M = (0.06, 0.5)
_STILL_SHARE = 0.15
_AIMED_SHARE = 0.5
_CENTRE_SHARE = 0.3
_MISS_M = 0.2


def draw(rng: np.random.Generator, frame_s: Array, n_frames: int) -> Truth:
    """Draw one scene per ``frame_s (s,)`` and follow it.

    Half of the others are aimed at the centre's first place, with a lateral miss up to 0.2 m.
    """
    n = len(frame_s)
    shape = (n, N_OTHERS)
    bearing = rng.uniform(-np.pi, np.pi, shape)
    distance = rng.uniform(_DISTANCE_M[0], _DISTANCE_M[1], shape)
    miss = rng.uniform(-_MISS_M, _MISS_M, shape)
    aim = bearing + np.pi + np.arcsin(np.clip(miss / distance, -1.0, 1.0))
    is_aimed = rng.random(shape) < _AIMED_SHARE
    angle = np.where(is_aimed, aim, rng.uniform(-np.pi, np.pi, shape))
    low, high = np.log(_SPEED_M_S)
    is_still = rng.random(shape) < _STILL_SHARE
    speed = np.where(is_still, 0.0, np.exp(rng.uniform(low, high, shape)))
    drifts = rng.random(n) < _CENTRE_SHARE
    drift = np.where(drifts, rng.uniform(*_CENTRE_SPEED_M_S, n), 0.0)
    start = distance[..., None] * _heading(bearing)
    velocity = speed[..., None] * _heading(angle)
    centre_velocity = drift[:, None] * _heading(rng.uniform(-np.pi, np.pi, n))
    times = np.arange(n_frames) * frame_s[:, None]

    def place(t_s: Array) -> Tuple[Array, Array]:
        moving = t_s.reshape(n, N_OTHERS, -1, 1)
        other = start[:, :, None] + moving * velocity[:, :, None]
        centre = moving * centre_velocity[:, None, None]
        return other.reshape(n * N_OTHERS, -1, 2), centre.reshape(n * N_OTHERS, -1, 2)

    radius = np.full(shape, RADIUS_M)
    until_s = float(n_frames * frame_s.max()) + LOOK_AHEAD_S
    return Truth(
        centre_m=times[..., None] * centre_velocity[:, None],
        other_m=start[:, :, None] + times[:, None, :, None] * velocity[:, :, None],
        contact_s=passing(place, radius.ravel(), until_s)[0].reshape(shape),
        radius_m=radius,
        kind=np.where(is_still, STILL, UNIFORM),
        frame_s=frame_s,
    )


def _heading(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
