"""Simulated truth: a free block in the middle of a table and three others that may reach it.

Balls roll out, blocks are flicked and slide, a finger pushes a block, a hand moves one, some lie
still. Whatever the bodies do to each other on the way is simulated, and contact is MuJoCo's. A
passive block almost never reaches anything by itself (1 % did in a trial with free speeds), so
flicked bodies are given the speed for a way between far too short and far beyond. Source: APEX
section "Simulate"; the scenes are ours.
"""

import math
from typing import List, Tuple

import numpy as np

from apex_edge.types import Array
from offline_train.scenes.mujoco_world import (
    DRIVEN,
    FLICKED,
    GRAVITY_M_S2,
    LEAST_ROLLING_M_S2,
    PUSHED,
    Body,
    Run,
    run,
)
from offline_train.scenes.truth import LOOK_AHEAD_S, Truth

NAME = "mujoco"
VERSION = 1
BALL, BLOCK, PUSH, HAND, STILL = 0, 1, 2, 3, 4
KINDS = ("ball", "block", "pushed", "hand", "still")
N_OTHERS = 3
_KIND_SHARE = (0.30, 0.15, 0.20, 0.25, 0.10)
_AIMED_SHARE = 0.7
_LEAST_GAP_M = 0.03
# A square seen from above, as the disc of its area, which is how perception sizes it.
_DISC_OF_SQUARE = 2.0 / math.sqrt(math.pi)


def draw(rng: np.random.Generator, frame_s: Array, n_frames: int) -> Truth:
    """Draw one table per scene and simulate it; ``frame_s (s,)`` is the time between frames.

    Raises
    ------
    MissingExtraError : MuJoCo is not installed.
    """
    tables = [draw_bodies(rng) for _ in frame_s]
    paths, contacts = [], []
    for (bodies, _), step_s in zip(tables, frame_s.tolist()):
        done = run(bodies, (n_frames - 1) * step_s + LOOK_AHEAD_S)
        paths.append(_at(done, np.arange(n_frames) * step_s))
        contacts.append(done.contact_s)
    path = np.stack(paths)
    size = np.array([[disc_m(body) for body in bodies] for bodies, _ in tables])
    return Truth(
        centre_m=path[:, 0],
        other_m=path[:, 1:],
        contact_s=np.stack(contacts),
        radius_m=size[:, :1] + size[:, 1:],
        kind=np.array([kinds for _, kinds in tables]),
        frame_s=frame_s,
    )


def draw_bodies(rng: np.random.Generator) -> Tuple[List[Body], List[int]]:
    """Draw the bodies of one table, the centre first, and the kind of each other one."""
    half_m = float(rng.uniform(0.012, 0.02))
    turn, grip = float(rng.uniform(-np.pi, np.pi)), float(rng.uniform(0.15, 0.35))
    bodies, kinds = [Body(False, FLICKED, 0.0, 0.0, turn, half_m, grip)], []
    while len(kinds) < N_OTHERS:
        kind = int(rng.choice(len(KINDS), p=_KIND_SHARE))
        body = _draw_other(rng, kind)
        if all(_gap_m(body, other) > _LEAST_GAP_M for other in bodies):
            bodies.append(body)
            kinds.append(kind)
    return bodies, kinds


def disc_m(body: Body) -> float:
    """Return the radius that perception gives a body."""
    return body.half_m if body.is_ball else _DISC_OF_SQUARE * body.half_m


def _draw_other(rng: np.random.Generator, kind: int) -> Body:
    distance = float(rng.uniform(0.08, 0.6))
    bearing = float(rng.uniform(-np.pi, np.pi))
    is_ball = kind == BALL or (kind == STILL and rng.random() < 0.5)
    rest = Body(
        is_ball=is_ball,
        mode={PUSH: PUSHED, HAND: DRIVEN}.get(kind, FLICKED),
        x_m=distance * math.cos(bearing),
        y_m=distance * math.sin(bearing),
        heading_rad=_aim(rng, distance, bearing),
        half_m=float(rng.uniform(0.01, 0.02)),
        friction=float(rng.uniform(0.05, 0.35)),
    )
    start_s = float(rng.uniform(0.2, 2.0))
    if kind == STILL:
        return rest
    if kind in (BALL, BLOCK):
        # Somewhere between far short of the centre and far beyond it.
        way = distance * float(rng.uniform(0.4, 2.5))
        start_s = start_s if rng.random() < 0.5 else 0.0
        if kind == BLOCK:
            speed = math.sqrt(2.0 * rest.friction * GRAVITY_M_S2 * way)
            return rest._replace(speed_m_s=speed, start_s=start_s)
        speed = math.exp(float(rng.uniform(math.log(0.04), math.log(0.4))))
        slow = max(0.5 * speed * speed / way, LEAST_ROLLING_M_S2)
        return rest._replace(friction=slow, speed_m_s=speed, start_s=start_s)
    # A hand commits to a distance: past the centre, up to it, or short of it.
    return rest._replace(
        speed_m_s=math.exp(float(rng.uniform(math.log(0.04), math.log(0.3)))),
        start_s=start_s,
        length_m=max(0.03, distance + float(rng.uniform(-0.25, 0.15))),
        side_m=rest.half_m * float(rng.uniform(-0.2, 0.2)),
    )


def _aim(rng: np.random.Generator, distance: float, bearing: float) -> float:
    """Return a heading: mostly towards the centre with a lateral miss, else anywhere."""
    miss = float(rng.uniform(-0.15, 0.15)) * float(rng.choice([0.25, 1.0]))
    anywhere = float(rng.uniform(-np.pi, np.pi))
    if rng.random() >= _AIMED_SHARE:
        return anywhere
    return bearing + math.pi + math.asin(min(max(miss / distance, -1.0), 1.0))


def _gap_m(one: Body, other: Body) -> float:
    apart = math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
    return apart - math.sqrt(2.0) * (one.half_m + other.half_m)


def _at(done: Run, t_s: Array) -> Array:
    """Return positions (b, f, 2) at the times ``t_s (f,)``, between the steps on a line."""
    return np.stack(
        [
            np.column_stack([np.interp(t_s, done.t_s, place[:, axis]) for axis in range(2)])
            for place in done.pos_m
        ]
    )
