"""The paper's forward Euler, stepped for all blockers at once: the oracle of the kernel.

``pos[t+1] = pos[t] + v[t] dt``, ``v[t+1] = v[t] + a[t] dt``. Every candidate has its own copy of
the mover (struct of arrays), so nothing is assumed about the path; the buffers are kept between
calls and no step allocates. Source: APEX section "Limitations" (deployment).
"""

from typing import Optional, Tuple

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


class _Movers:
    """One mover per blocker: its state, what happened to it, and room to compute in; all (n,)."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.x, self.y, self.vx, self.vy, self.came_x, self.came_y = np.empty((6, n))
        self.gap2, self.far2, self.least2, self.last2, self.land2, self.work = np.empty((6, n))
        self.is_live, self.is_free, self.is_rolling = np.empty((3, n), dtype=bool)
        self.hits, self.meets, self.mask = np.empty((3, n), dtype=bool)
        self.enters, self.blocks, self.collides, self.least_at = np.empty((4, n), dtype=np.int64)

    def start(self, problem: RolloutProblem) -> None:
        """Set all movers to the problem's state."""
        self.x[:], self.y[:] = problem.mover_pos_m[:2]
        self.vx[:], self.vy[:] = problem.mover_vel_m_s[:2]
        self.came_x[:], self.came_y[:] = problem.mover_vel_m_s[:2]
        for steps in (self.enters, self.blocks, self.collides):
            steps[:] = NEVER
        self.least_at[:] = 0
        for square in (self.least2, self.last2, self.land2):
            square[:] = np.inf
        for flags in (self.is_live, self.is_free, self.is_rolling):
            flags[:] = True


class EulerSim(PhysicsSim):
    """Roll out every candidate step by step."""

    def __init__(self) -> None:
        self._movers: Optional[_Movers] = None

    def outcomes(self, problem: RolloutProblem, tip_xy_m: Array, arrival_s: Array) -> Outcomes:
        """Find what happens with each of n blockers; see ``PhysicsSim.outcomes``."""
        n = len(arrival_s)
        # One more mover, whose blocker is out of the world: the path without any arm.
        arrives = np.append(arrival_steps(arrival_s, problem), NEVER)
        tips = np.full((2, n + 1), np.inf)
        tips[:, :n] = tip_xy_m.T
        if self._movers is None or self._movers.n != n + 1:
            self._movers = _Movers(n + 1)
        movers = self._movers
        movers.start(problem)
        target_x, target_y = (float(v) for v in problem.target_pos_m[:2])
        target_vx, target_vy = (float(v) for v in problem.target_vel_m_s[:2])
        for step in range(problem.n_steps + 1):
            _measure(movers, tips, (target_x, target_y))
            _note_events(movers, problem, arrives, step)
            _advance(movers, problem)
            target_x += target_vx * problem.dt_s
            target_y += target_vy * problem.dt_s
        return _collect(movers, problem, tips, n)


def _measure(m: _Movers, tips: Array, target: Tuple[float, float]) -> None:
    """Fill the squared distances to the blocker (gap2) and to the target (far2)."""
    np.subtract(m.x, tips[0], out=m.work)
    np.multiply(m.work, m.work, out=m.gap2)
    np.subtract(m.y, tips[1], out=m.work)
    np.multiply(m.work, m.work, out=m.work)
    np.add(m.gap2, m.work, out=m.gap2)
    np.subtract(m.x, target[0], out=m.work)
    np.multiply(m.work, m.work, out=m.far2)
    np.subtract(m.y, target[1], out=m.work)
    np.multiply(m.work, m.work, out=m.work)
    np.add(m.far2, m.work, out=m.far2)


def _note_events(m: _Movers, problem: RolloutProblem, arrives: Array, step: int) -> None:
    """Write down contacts of this step; a collision ends a roll-out, a blocker ends the motion."""
    np.equal(arrives, step, out=m.mask)
    np.copyto(m.land2, m.gap2, where=m.mask)
    np.less_equal(m.far2, (problem.contact_m + CONTACT_EPS_M) ** 2, out=m.hits)
    np.logical_and(m.hits, m.is_live, out=m.hits)
    np.copyto(m.collides, step, where=m.hits)
    # least and last distance, this step included, until the collision
    np.less(m.far2, m.least2, out=m.mask)
    np.logical_and(m.mask, m.is_live, out=m.mask)
    np.copyto(m.least2, m.far2, where=m.mask)
    np.copyto(m.least_at, step, where=m.mask)
    np.copyto(m.last2, m.far2, where=m.is_live)
    np.greater(m.is_live, m.hits, out=m.is_live)  # live and not hit
    np.greater(m.is_free, m.hits, out=m.is_free)
    np.less_equal(m.gap2, (problem.block_m + CONTACT_EPS_M) ** 2, out=m.meets)
    np.logical_and(m.meets, m.is_free, out=m.meets)
    np.equal(m.enters, NEVER, out=m.mask)
    np.logical_and(m.mask, m.meets, out=m.mask)
    np.copyto(m.enters, step, where=m.mask)
    np.less_equal(arrives, step, out=m.mask)
    np.logical_and(m.mask, m.meets, out=m.mask)
    np.copyto(m.blocks, step, where=m.mask)
    np.greater(m.is_free, m.mask, out=m.is_free)


def _advance(m: _Movers, problem: RolloutProblem) -> None:
    """Move every mover that is free and rolling by one Euler step."""
    dt = problem.dt_s
    first_vx, first_vy = (float(v) for v in problem.mover_vel_m_s[:2])
    ax, ay = (float(v) for v in problem.mover_acc_m_s2[:2])
    np.logical_and(m.is_free, m.is_rolling, out=m.mask)
    np.copyto(m.came_x, m.vx, where=m.mask)
    np.copyto(m.came_y, m.vy, where=m.mask)
    np.multiply(m.vx, dt, out=m.work)
    np.add(m.x, m.work, out=m.x, where=m.mask)
    np.multiply(m.vy, dt, out=m.work)
    np.add(m.y, m.work, out=m.y, where=m.mask)
    np.add(m.vx, ax * dt, out=m.vx, where=m.mask)
    np.add(m.vy, ay * dt, out=m.vy, where=m.mask)
    if ax * first_vx + ay * first_vy < 0.0:
        np.multiply(m.vx, first_vx, out=m.work)
        np.multiply(m.vy, first_vy, out=m.far2)  # far2 is free until the next measurement
        np.add(m.work, m.far2, out=m.work)
        rest = STOP_RATIO * (first_vx * first_vx + first_vy * first_vy)
        np.greater(m.work, rest, out=m.mask)
        np.logical_and(m.is_rolling, m.mask, out=m.is_rolling)


def _collect(m: _Movers, problem: RolloutProblem, tips: Array, n: int) -> Outcomes:
    """Copy the outcome out of the buffers, without the extra mover."""
    offset, gap = np.full((2, n), np.inf)
    hit = np.flatnonzero(m.blocks[:n] != NEVER)
    place = np.stack([m.x[hit], m.y[hit]])
    came = np.stack([m.came_x[hit], m.came_y[hit]])
    then_s = m.blocks[hit] * problem.dt_s
    target = problem.target_pos_m[:2, None] + problem.target_vel_m_s[:2, None] * then_s
    offset[hit], gap[hit] = describe_hits(tips[:, hit] - place, came, target - place, problem)
    return Outcomes(
        collision_step=m.collides[:n].copy(),
        blocked_step=m.blocks[:n].copy(),
        enter_step=m.enters[:n].copy(),
        min_distance_m=np.sqrt(m.least2[:n]),
        min_step=m.least_at[:n].copy(),
        final_distance_m=np.sqrt(m.last2[:n]),
        landing_gap_m=np.sqrt(m.land2[:n]) - problem.block_m,
        offset_ratio=offset,
        deflected_gap_m=gap,
        free_collision_step=int(m.collides[n]),
    )
