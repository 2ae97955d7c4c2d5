"""Committed motion around a resting centre: hands that go through with a move, and rolling balls.

A hand that moves has a goal: the centre, a place short of it, or one beyond that it passes on the
way to. No trigger can know a stop that is still to come, so a stop short looks like a hit for a
while. ``KINDS`` is how a body moves and what comes of it: what passes within 90 mm without contact
is a near miss, whatever it was aimed at. Distances in metres, planar. Source: ours.
"""

from dataclasses import dataclass, fields
from typing import Tuple

import numpy as np

from apex_edge.types import Array
from offline_train.scenes.truth import LOOK_AHEAD_S, Truth, passing

NAME = "committed"
VERSION = 1
KINDS = (
    "hand hit",
    "hand near miss",
    "hand far",
    "ball hit",
    "ball near miss",
    "ball far",
    "static",
)
N_OTHERS = 4
NEAR_M = 0.09
_HIT, _NEAR, _FAR = 0, 1, 2
_STATIC = KINDS.index("static")
_REACH, _SHORT, _PASS, _ROLL, _AWAY, _STILL = range(6)
# Chosen on training seeds: 11 % of the frames in which a body moves are within 5 s of its contact,
# and plain closest approach on an 11-frame line has the average precision (.62) of the study the
# goals come from.
_PLAN_SHARE = (0.14, 0.08, 0.13, 0.2, 0.3, 0.15)
_HAND_SPEED_M_S = (0.06, 0.4)
_BALL_SPEED_M_S = (0.06, 0.5)
_START_S = 4.0
_CENTRE_SHARE = 0.1


@dataclass(frozen=True)
class Moves:
    """n pairs of a moving body and the centre.

    ``is_ball``, ``is_still (n,)``; ``start_m (n, 2)``, ``heading (n, 2)`` unit; ``t_start_s (n,)``
    when it sets off. A hand covers ``length_m (n,)`` in ``duration_s (n,)`` along a minimum-jerk
    course and sways by ``wobble_m`` at ``wobble_rad_s (n,)``. A ball starts at ``speed_m_s (n,)``
    and slows down by ``decel_m_s2 (n,)``. ``centre_vel_m_s (n, 2)``; ``radius_m (n,)`` of both.
    """

    is_ball: Array
    is_still: Array
    start_m: Array
    heading: Array
    t_start_s: Array
    length_m: Array
    duration_s: Array
    wobble_m: Array
    wobble_rad_s: Array
    speed_m_s: Array
    decel_m_s2: Array
    centre_vel_m_s: Array
    radius_m: Array

    def take(self, rows: Array) -> "Moves":
        """Return the pairs chosen by a mask or by indices."""
        return Moves(**{spec.name: getattr(self, spec.name)[rows] for spec in fields(self)})


def draw(rng: np.random.Generator, frame_s: Array, n_frames: int) -> Truth:
    """Draw one scene of four bodies per ``frame_s (s,)`` and follow it."""
    n = len(frame_s)
    moves = draw_moves(rng, n)
    times = np.arange(n_frames) * frame_s[:, None]
    other, centre = place(moves, np.repeat(times, N_OTHERS, axis=0))
    until_s = float(n_frames * frame_s.max()) + LOOK_AHEAD_S
    contact, nearest = passing(lambda t_s: place(moves, t_s), moves.radius_m, until_s)
    shape = (n, N_OTHERS)
    return Truth(
        centre_m=centre.reshape(*shape, n_frames, 2)[:, 0],
        other_m=other.reshape(*shape, n_frames, 2),
        contact_s=contact.reshape(shape),
        radius_m=moves.radius_m.reshape(shape),
        kind=_kind(moves, contact, nearest).reshape(shape),
        frame_s=frame_s,
    )


def draw_moves(rng: np.random.Generator, n_scenes: int) -> Moves:
    """Draw the moves of the 4 n bodies of n scenes.

    A reach ends inside the centre, a stop short ends 10 to 120 mm before contact, a pass goes by
    5 to 60 mm beside contact, a roll is aimed up to 0.2 m beside the middle and runs out of speed
    somewhere; the rest heads elsewhere, half of it hands and half balls.
    """
    n = n_scenes * N_OTHERS
    plan = rng.choice(len(_PLAN_SHARE), size=n, p=_PLAN_SHARE)
    radius = rng.uniform(0.035, 0.06, n)
    distance = rng.uniform(0.15, 0.6, n)
    bearing = rng.uniform(-np.pi, np.pi, n)
    inside = radius * rng.uniform(0.0, 0.8, n)
    outside = radius + rng.uniform(0.005, 0.06, n)
    beside = np.select([plan == _PASS, plan == _ROLL], [outside, rng.uniform(0.0, 0.2, n)], inside)
    beside = np.minimum(beside, 0.9 * distance)
    turn = np.where(plan == _AWAY, rng.uniform(0.6, np.pi, n), np.arcsin(beside / distance))
    angle = bearing + np.pi + turn * rng.choice([-1.0, 1.0], size=n)
    ahead = np.sqrt(distance**2 - beside**2)
    length = np.select(
        [plan == _REACH, plan == _SHORT, plan == _PASS],
        [
            ahead + radius * rng.uniform(-0.5, 0.3, n),
            ahead - radius - rng.uniform(0.01, 0.12, n),
            ahead + rng.uniform(0.02, 0.3, n),
        ],
        rng.uniform(0.1, 0.6, n),
    )
    length = np.maximum(length, 0.03)
    speed = np.exp(rng.uniform(*np.log(_BALL_SPEED_M_S), n))
    drift = np.where(rng.random(n_scenes) < _CENTRE_SHARE, rng.uniform(0.01, 0.05, n_scenes), 0.0)
    drift_vel = drift[:, None] * _heading(rng.uniform(-np.pi, np.pi, n_scenes))
    return Moves(
        is_ball=(plan == _ROLL) | ((plan == _AWAY) & (rng.random(n) < 0.5)),
        is_still=plan == _STILL,
        start_m=distance[:, None] * _heading(bearing),
        heading=_heading(angle),
        t_start_s=rng.uniform(0.0, _START_S, n),
        length_m=length,
        duration_s=length / np.exp(rng.uniform(*np.log(_HAND_SPEED_M_S), n)),
        wobble_m=rng.uniform(0.0, 0.004, n),
        wobble_rad_s=rng.uniform(3.0, 12.0, n),
        speed_m_s=speed,
        decel_m_s2=speed * speed / (2.0 * distance * rng.uniform(0.4, 2.5, n)),
        centre_vel_m_s=np.repeat(drift_vel, N_OTHERS, axis=0),
        radius_m=radius,
    )


def place(moves: Moves, t_s: Array) -> Tuple[Array, Array]:
    """Return the positions (n, f, 2) of the bodies and of their centres at ``t_s (n, f)``."""
    since = np.maximum(t_s - moves.t_start_s[:, None], 0.0)
    share = np.minimum(since / moves.duration_s[:, None], 1.0)
    reached = moves.length_m[:, None] * share**3 * (10.0 - 15.0 * share + 6.0 * share * share)
    # The wobble lives only while the hand moves.
    sway = moves.wobble_m[:, None] * np.sin(moves.wobble_rad_s[:, None] * t_s)
    sway = sway * 4.0 * share * (1.0 - share)
    speed, decel = moves.speed_m_s[:, None], moves.decel_m_s2[:, None]
    rolling = np.minimum(since, speed / decel)
    rolled = rolling * (speed - 0.5 * decel * rolling)
    is_ball, moves_at_all = moves.is_ball[:, None], ~moves.is_still[:, None]
    along = np.where(is_ball, rolled, reached) * moves_at_all
    across = np.where(is_ball, 0.0, sway) * moves_at_all
    side = np.column_stack([-moves.heading[:, 1], moves.heading[:, 0]])
    body = (
        moves.start_m[:, None]
        + along[..., None] * moves.heading[:, None]
        + across[..., None] * side[:, None]
    )
    return body, t_s[..., None] * moves.centre_vel_m_s[:, None]


def _kind(moves: Moves, contact_s: Array, nearest_m: Array) -> Array:
    is_hit = np.isfinite(contact_s)
    passing_by = np.where(is_hit, _HIT, np.where(nearest_m < NEAR_M, _NEAR, _FAR))
    first = np.where(moves.is_ball, KINDS.index("ball hit"), KINDS.index("hand hit"))
    kind: Array = np.where(moves.is_still, _STATIC, first + passing_by)
    return kind


def _heading(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)
