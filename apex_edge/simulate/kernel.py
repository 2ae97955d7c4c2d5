"""Exact roll-outs without a time loop: all blockers share one free path.

A blocker cannot bend the mover's path, it can only end it. So the path is computed once, in closed
form; the collision without an arm is one number; and each blocker needs only the step at which
the path enters its disc. On a straight path that step is found by bisection over the distance
travelled and then checked exactly at its neighbours; on a curved one all steps are tested, for the
few blockers near the path, in blocks of bounded size. The flags equal those of the stepped
Euler, see ``apex bench rollout``. Source: ours; the motion is APEX section "Limitations".
"""

import math
from dataclasses import dataclass
from typing import Tuple

import numpy as np

from apex_edge.simulate.base import PhysicsSim
from apex_edge.simulate.problem import (
    CONTACT_EPS_M,
    NEVER,
    STOP_RATIO,
    Outcomes,
    RolloutProblem,
    arrival_steps,
    describe_hits,
)
from apex_edge.types import Array

# Doubles in one block of the curved test: 1 MB, which stays in a small processor's cache.
_BLOCK = 131072
_NEIGHBOURS = np.array([[-1], [0], [1]])


@dataclass(frozen=True)
class _Path:
    """Positions at steps 0..n: ``xy (2, n + 1)``; ``came (2, n + 1)`` velocity that led there
    (``(2, 1)`` when it never changes).

    ``along (n + 1,)`` is the distance travelled in direction ``unit (2,)``, never falling; it has
    length 0 on a curved path.
    """

    xy: Array
    came: Array
    along: Array
    unit: Array


class KernelSim(PhysicsSim):
    """Roll out all candidates from one shared path, with no loop over time."""

    def outcomes(self, problem: RolloutProblem, tip_xy_m: Array, arrival_s: Array) -> Outcomes:
        """Find what happens with each of n blockers; see ``PhysicsSim.outcomes``."""
        mover = _braked_path(problem)
        target = _steady_path(problem)
        distance = np.hypot(mover.xy[0] - target.xy[0], mover.xy[1] - target.xy[1])
        free_hit = _first(distance <= problem.contact_m + CONTACT_EPS_M)
        tips = np.ascontiguousarray(tip_xy_m.T)
        arrives = arrival_steps(arrival_s, problem)
        enter = _first_inside(mover, tips, np.zeros(len(arrives), dtype=np.int64), problem.block_m)
        blocked = enter.copy()
        # It came by before the arm: is it still there, or does it come again?
        missed = np.flatnonzero((enter < arrives) & (arrives <= problem.n_steps))
        blocked[enter < arrives] = NEVER
        if len(missed):
            again = _first_inside(mover, tips[:, missed], arrives[missed], problem.block_m)
            blocked[missed] = again
        blocked[blocked >= free_hit] = NEVER
        enter[enter >= free_hit] = NEVER
        end = np.minimum(np.minimum(blocked, free_hit), problem.n_steps)
        least, least_at = _running_minimum(distance)
        lands = np.minimum(arrives, end)
        gap = np.hypot(mover.xy[0, lands] - tips[0], mover.xy[1, lands] - tips[1])
        offset, deflected = _hits(problem, mover, target, tips, blocked)
        found = Outcomes(
            collision_step=np.where(blocked == NEVER, free_hit, NEVER),
            blocked_step=blocked,
            enter_step=enter,
            min_distance_m=least[end],
            min_step=least_at[end],
            final_distance_m=distance[end],
            landing_gap_m=np.where(arrives == NEVER, np.inf, gap - problem.block_m),
            offset_ratio=offset,
            deflected_gap_m=deflected,
            free_collision_step=free_hit,
        )
        if problem.target_vel_m_s[:2].any():
            _let_target_run_on(found, problem, mover, target)
        return found


def _braked_path(problem: RolloutProblem) -> _Path:
    """Evaluate the mover's Euler path in closed form: p0 + k v dt + k (k - 1) / 2 a dt^2."""
    x, y = (float(c) for c in problem.mover_pos_m[:2])
    vx, vy = (float(c) for c in problem.mover_vel_m_s[:2])
    ax, ay = (float(c) for c in problem.mover_acc_m_s2[:2])
    dt, speed, push = problem.dt_s, math.hypot(vx, vy), math.hypot(ax, ay)
    step = np.arange(problem.n_steps + 1, dtype=np.float64)
    forward = ax * vx + ay * vy
    if forward < 0.0:
        step = np.minimum(step, math.ceil((1.0 - STOP_RATIO) * speed * speed / (-forward * dt)))
    time_s = step * dt
    lag = step * (step - 1.0) * (0.5 * dt * dt)
    before_s = np.maximum(time_s - dt, 0.0)
    lead = (vx, vy, speed) if speed > 0.0 else (ax, ay, push)
    ux, uy = (lead[0] / lead[2], lead[1] / lead[2]) if lead[2] > 0.0 else (1.0, 0.0)
    along = np.empty(0)
    if abs(ux * ay - uy * ax) <= 1e-12 * push:
        along = np.maximum.accumulate(speed * time_s + (ux * ax + uy * ay) * lag)
    return _Path(
        np.array([x + vx * time_s + ax * lag, y + vy * time_s + ay * lag]),
        np.array([vx + ax * before_s, vy + ay * before_s]),
        along,
        np.array([ux, uy]),
    )


def _steady_path(problem: RolloutProblem) -> _Path:
    """Evaluate the target's path at constant velocity."""
    start = problem.target_pos_m[:2].reshape(2, 1)
    velocity = problem.target_vel_m_s[:2].reshape(2, 1)
    length = float(np.hypot(velocity[0, 0], velocity[1, 0]))
    unit = velocity[:, 0] / length if length > 0.0 else np.array([1.0, 0.0])
    time_s = np.arange(problem.n_steps + 1, dtype=np.float64) * problem.dt_s
    return _Path(start + velocity * time_s, velocity, length * time_s, unit)


def _first(flags: Array) -> int:
    """Return the first true step, or NEVER."""
    step = int(np.argmax(flags))
    return step if flags[step] else NEVER


def _running_minimum(distance: Array) -> Tuple[Array, Array]:
    """Return the least distance so far and the step at which it was first reached, per step."""
    least = np.minimum.accumulate(distance)
    is_new = np.ones(len(distance), dtype=bool)
    is_new[1:] = distance[1:] < least[:-1]
    at = np.maximum.accumulate(np.where(is_new, np.arange(len(distance)), 0))
    return least, at


def _first_inside(path: _Path, centres: Array, start: Array, radius_m: float) -> Array:
    """Return the first step (n,) >= ``start`` with the path inside each disc, or NEVER.

    ``centres (2, n)``, ``start (n,)`` int64.
    """
    if len(path.along):
        return _first_inside_straight(path, centres, start, radius_m + CONTACT_EPS_M)
    return _first_inside_curved(path, centres, start, radius_m + CONTACT_EPS_M)


def _first_inside_straight(path: _Path, centres: Array, start: Array, radius_m: float) -> Array:
    """Bisect the distance travelled for the disc's near edge, then test the neighbouring steps."""
    steps = np.full(len(start), NEVER, dtype=np.int64)
    offset = centres - path.xy[:, :1]
    across = path.unit[0] * offset[1] - path.unit[1] * offset[0]
    half2 = radius_m * radius_m - across * across
    near = np.flatnonzero(half2 >= -1e-12)
    half = np.sqrt(np.maximum(half2[near], 0.0))
    entry = path.unit @ offset[:, near] - half
    guess = np.searchsorted(path.along, entry)
    last = path.xy.shape[1] - 1
    # Once past, a straight path never comes back: a later start needs only its own step tested.
    step = np.maximum(guess + _NEIGHBOURS, start[near])
    held = np.minimum(step, last)
    gap_x, gap_y = path.xy[0, held] - centres[0, near], path.xy[1, held] - centres[1, near]
    is_inside = (step <= last) & (gap_x * gap_x + gap_y * gap_y <= radius_m * radius_m)
    steps[near] = np.where(is_inside, step, NEVER).min(axis=0)
    return steps


def _first_inside_curved(path: _Path, centres: Array, start: Array, radius_m: float) -> Array:
    """Test every step for the discs that touch the path's bounding box, block by block."""
    steps = np.full(len(start), NEVER, dtype=np.int64)
    low = path.xy.min(axis=1)[:, None] - radius_m
    high = path.xy.max(axis=1)[:, None] + radius_m
    near = np.flatnonzero(((centres >= low) & (centres <= high)).all(axis=0))
    clock = np.arange(path.xy.shape[1])
    width = max(1, _BLOCK // len(clock))
    for first in range(0, len(near), width):
        part = near[first : first + width]
        gap_x = path.xy[0] - centres[0, part, None]
        gap_y = path.xy[1] - centres[1, part, None]
        is_inside = gap_x * gap_x + gap_y * gap_y <= radius_m * radius_m
        is_inside &= clock >= start[part, None]
        step = np.argmax(is_inside, axis=1)
        steps[part] = np.where(is_inside[np.arange(len(part)), step], step, NEVER)
    return steps


def _hits(
    problem: RolloutProblem, mover: _Path, target: _Path, tips: Array, blocked: Array
) -> Tuple[Array, Array]:
    """Return ``describe_hits`` for n tips, inf where the mover does not meet the tip."""
    offset, gap = np.full((2, len(blocked)), np.inf)
    hit = np.flatnonzero(blocked != NEVER)
    step = blocked[hit]
    place = mover.xy[:, step]
    offset[hit], gap[hit] = describe_hits(
        tips[:, hit] - place, mover.came[:, step], target.xy[:, step] - place, problem
    )
    return offset, gap


def _let_target_run_on(
    found: Outcomes, problem: RolloutProblem, mover: _Path, target: _Path
) -> None:
    """Add, in place, what a moving target does after the mover was stopped."""
    held = np.flatnonzero(found.blocked_step != NEVER)
    if not len(held):
        return
    start = found.blocked_step[held]
    place = mover.xy[:, start]
    hit = _first_inside(target, place, start, problem.contact_m)
    end = np.minimum(hit, problem.n_steps)
    along = target.unit @ (place - target.xy[:, :1])
    pass_by = np.searchsorted(target.along, along)
    for shift in (-1, 0):
        step = np.clip(pass_by + shift, start, end)
        distance = np.hypot(*(place - target.xy[:, step]))
        is_less = distance < found.min_distance_m[held]
        found.min_distance_m[held] = np.where(is_less, distance, found.min_distance_m[held])
        found.min_step[held] = np.where(is_less, step, found.min_step[held])
    found.final_distance_m[held] = np.hypot(*(place - target.xy[:, end]))
    found.collision_step[held] = hit
