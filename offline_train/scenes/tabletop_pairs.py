"""Pairs on a tabletop: uniform motion, rolling to rest, a hand's committed moves, or rest.

What the shipped linear trigger learns from. Distances in metres, planar. Source: ours.
"""

from dataclasses import dataclass, fields
from typing import Tuple

import numpy as np

from apex_edge.types import Array
from offline_train.scenes.truth import LOOK_AHEAD_S, Truth, first_contact

NAME = "tabletop-pairs"
VERSION = 1
UNIFORM, ROLLING, HAND, STILL = 0, 1, 2, 3
KINDS = ("uniform", "rolling", "hand", "still")
_KIND_SHARE = (0.35, 0.25, 0.28, 0.12)


@dataclass(frozen=True)
class Scenes:
    """n pairs, mover and target, each with its own law of motion.

    ``kind (n,)``; ``start_m``, ``heading (n, 2)`` unit; ``speed_m_s (n,)`` at the start or, for a
    hand, its mean; ``decel_m_s2 (n,)``; ``t_start_s``, ``length_m (n,)`` of a hand's move;
    ``wobble_m``, ``wobble_rad_s (n,)`` of a hand, sideways; ``target_m``,
    ``target_vel_m_s (n, 2)``; ``radius_m (n,)`` of both together.
    """

    kind: Array
    start_m: Array
    heading: Array
    speed_m_s: Array
    decel_m_s2: Array
    t_start_s: Array
    length_m: Array
    wobble_m: Array
    wobble_rad_s: Array
    target_m: Array
    target_vel_m_s: Array
    radius_m: Array

    def take(self, rows: Array) -> "Scenes":
        """Return the scenes chosen by a mask or by indices."""
        return Scenes(**{spec.name: getattr(self, spec.name)[rows] for spec in fields(self)})


def draw(rng: np.random.Generator, frame_s: Array, n_frames: int) -> Truth:
    """Draw one pair per scene and follow it; ``frame_s (s,)`` is the time between frames."""
    return follow(draw_scenes(rng, len(frame_s)), frame_s, n_frames)


def follow(scenes: Scenes, frame_s: Array, n_frames: int) -> Truth:
    """Return the paths of the scenes at their frame times, and their contacts."""
    mover, target = place(scenes, np.arange(n_frames) * frame_s[:, None])
    until_s = float(n_frames * frame_s.max()) + LOOK_AHEAD_S
    contact = first_contact(lambda t_s: place(scenes, t_s), scenes.radius_m, until_s)
    return Truth(
        centre_m=target,
        other_m=mover[:, None],
        contact_s=contact[:, None],
        radius_m=scenes.radius_m[:, None],
        kind=scenes.kind[:, None],
        frame_s=frame_s,
    )


def draw_scenes(rng: np.random.Generator, n: int) -> Scenes:
    """Draw the laws of motion of n scenes.

    60 % are aimed near the target (lateral miss up to 0.2 m), the rest anywhere.
    """
    kind = rng.choice(4, size=n, p=_KIND_SHARE)
    distance = rng.uniform(0.06, 0.6, n)
    bearing = rng.uniform(-np.pi, np.pi, n)
    start = distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    miss = rng.uniform(-0.2, 0.2, n) * rng.choice([0.25, 1.0], size=n)
    is_aimed = rng.random(n) < 0.6
    aim = bearing + np.pi + np.arcsin(np.clip(miss / distance, -1.0, 1.0))
    angle = np.where(is_aimed, aim, rng.uniform(-np.pi, np.pi, n))
    speed = np.exp(rng.uniform(np.log(0.015), np.log(0.4), n))
    target_speed = np.where(rng.random(n) < 0.2, rng.uniform(0.02, 0.15, n), 0.0)
    drift = rng.uniform(-np.pi, np.pi, n)
    is_hand = kind == HAND
    # A hand commits to a distance: past the target, up to it, or short of it.
    length = np.maximum(0.03, distance + rng.uniform(-0.25, 0.15, n))
    # A ball stops somewhere between far short of the target and far beyond it.
    run = distance * rng.uniform(0.4, 2.5, n)
    return Scenes(
        kind=kind,
        start_m=start,
        heading=np.column_stack([np.cos(angle), np.sin(angle)]),
        speed_m_s=np.where(kind == STILL, 0.0, np.where(is_hand, np.maximum(speed, 0.04), speed)),
        decel_m_s2=np.where(kind == ROLLING, speed * speed / (2.0 * run), 0.0),
        t_start_s=np.where(is_hand, rng.uniform(0.0, 1.5, n), 0.0),
        length_m=length,
        wobble_m=np.where(is_hand, rng.uniform(0.0, 0.002, n), 0.0),
        wobble_rad_s=rng.uniform(3.0, 12.0, n),
        target_m=np.zeros((n, 2)),
        target_vel_m_s=target_speed[:, None] * np.column_stack([np.cos(drift), np.sin(drift)]),
        radius_m=rng.uniform(0.024, 0.06, n),
    )


def place(scenes: Scenes, t_s: Array) -> Tuple[Array, Array]:
    """Return mover and target positions (n, f, 2) at the times ``t_s (n, f)``."""
    speed, decel = scenes.speed_m_s[:, None], scenes.decel_m_s2[:, None]
    stop = np.where(decel > 0.0, speed / np.where(decel > 0.0, decel, 1.0), np.inf)
    moved = np.minimum(t_s, stop)
    free = moved * (speed - 0.5 * decel * moved)
    is_hand = (scenes.kind == HAND)[:, None]
    length = scenes.length_m[:, None]
    duration = length / np.where(speed > 0.0, speed, 1.0)
    share = np.clip((t_s - scenes.t_start_s[:, None]) / duration, 0.0, 1.0)
    reached = length * share**3 * (10.0 - 15.0 * share + 6.0 * share * share)
    travel = np.where(is_hand, reached, free)
    # The wobble lives only while the hand moves.
    sway = scenes.wobble_m[:, None] * np.sin(scenes.wobble_rad_s[:, None] * t_s)
    sway = sway * 4.0 * share * (1.0 - share)
    side = np.column_stack([-scenes.heading[:, 1], scenes.heading[:, 0]])
    mover = (
        scenes.start_m[:, None]
        + travel[..., None] * scenes.heading[:, None]
        + sway[..., None] * side[:, None]
    )
    target = scenes.target_m[:, None] + t_s[..., None] * scenes.target_vel_m_s[:, None]
    return mover, target
