"""Soft labels: the chance of contact, from perturbed MuJoCo roll-outs of what was measured.

A hard label says what happened once; the device cannot know that, since it sees a noisy state and
neither the kind of the body nor anybody's intent. Here each row is rolled out from states drawn
from its own covariance, with kinds drawn from a prior, and the label is the share that touches.

Before the first touch a ball or a block on a table runs along a line under a constant force of
friction, so each mover is a body on a MuJoCo rail with friction loss: the same motion as with
wheels on the ground (held to it by a test) at a ninth of the cost. What matters of the kind is the
way left until it rests. No simulator knows what a hand means to do: half of all movers run on at
constant speed, the other half come to rest after a way that is log-uniform from 2 cm to 1.5 m; a
slowing down that perception has proven is taken from a normal about what it measured. Where that
prior is wrong the labels are wrong with it: mix the truth in (``distill.soft_target``) and look at
their own calibration. Source: ours.
"""

from dataclasses import dataclass, replace
from typing import Any, Tuple

import numpy as np

from apex_edge.triggers.approach import Pairs
from apex_edge.types import Array
from offline_train.extras import module
from offline_train.trigger.observe import Observed

N_ROLLOUTS = 32
_N_SLOTS = 128
# Pairs side by side in one model, so far apart that they never meet.
_APART_M = 20.0
# After each part those that touched, or came to rest, make room.
_PART_S = 0.5
_STEP_S = (0.005, 0.05)
# Way per step, in combined radii: a graze is missed by less than 1 % of the radius.
_WAY_PER_STEP = 0.25
# Sizes are set per roll-out, but the boxes of the broad phase stay as compiled: for the largest.
_LARGEST_M = 0.5
_MASS_KG = 0.02
_RUNS_ON_SHARE = 0.5
_WAY_LEFT_M = (0.02, 1.5)
# A target slower than so many sd of its velocity lies still.
_STILL_SD = 3.0
# Of a parabola over a window T: sd of the acceleration = 1.94 sd_v / T, and T = 4.62 sd_p / sd_v.
_ACC_SD = 0.42
_PROVEN_SD = 1.6449


@dataclass(frozen=True)
class Launches:
    """m movers that start at the origin along +x, and their targets.

    ``speed_m_s``, ``decel_m_s2 (m,)`` of the movers; ``target_m``, ``target_vel_m_s (m, 2)``;
    ``radius_m (m,)`` of both together; ``horizon_s (m,)``.
    """

    speed_m_s: Array
    decel_m_s2: Array
    target_m: Array
    target_vel_m_s: Array
    radius_m: Array
    horizon_s: Array


def soften(
    seen: Observed, rows: Array, rng: np.random.Generator, n_rollouts: int = N_ROLLOUTS
) -> Observed:
    """Return the same rows with ``soft`` filled in for the given row indices.

    Raises
    ------
    MissingExtraError : MuJoCo is not installed.
    """
    horizon_s = seen.horizon_s[seen.pair[rows]]
    soft = seen.soft.copy()
    soft[rows] = probability(seen.geometry.take(rows), horizon_s, rng, n_rollouts)
    return replace(seen, soft=soft)


def probability(pairs: Pairs, horizon_s: Array, rng: np.random.Generator, n: int) -> Array:
    """Return the share (m,) of ``n`` roll-outs of each pair that touch within ``horizon_s (m,)``.

    Raises
    ------
    MissingExtraError : MuJoCo is not installed.
    """
    is_hit = touches(launch(pairs, horizon_s, rng, n))
    share: Array = is_hit.reshape(-1, n).mean(axis=1)
    return share


def launch(pairs: Pairs, horizon_s: Array, rng: np.random.Generator, n: int) -> Launches:
    """Draw ``n`` states and laws of motion of each pair; those of one pair lie together."""
    many = pairs.take(np.repeat(np.arange(len(pairs.radius_m)), n))
    half_var = 0.25 * np.einsum("mii->m", many.cov[:, 2:, 2:])
    target_speed = np.linalg.norm(many.target_vel_m_s, axis=1)
    is_still = target_speed < _STILL_SD * np.sqrt(half_var)
    offset, velocity = _perturb(many, is_still, rng)
    target_vel = np.where(is_still[:, None], 0.0, many.target_vel_m_s)
    speed = np.linalg.norm(velocity, axis=1)
    ahead = velocity / np.where(speed > 0.0, speed, 1.0)[:, None]
    return Launches(
        speed_m_s=speed,
        decel_m_s2=_decel(many, speed, rng),
        target_m=_turned(offset, ahead),
        target_vel_m_s=_turned(target_vel, ahead),
        radius_m=many.radius_m,
        horizon_s=np.repeat(horizon_s, n),
    )


def touches(launches: Launches) -> Array:
    """Roll out in MuJoCo and say which (m,) touch within their horizon.

    Raises
    ------
    MissingExtraError : MuJoCo is not installed.
    """
    slots = _Slots(min(_N_SLOTS, max(1, len(launches.speed_m_s))))
    place = np.zeros((len(launches.speed_m_s), 3))
    place[:, 1:] = launches.target_m
    motion = np.column_stack([launches.speed_m_s, launches.target_vel_m_s])
    # Touching from the start needs no simulation.
    is_hit = np.linalg.norm(launches.target_m, axis=1) <= launches.radius_m
    left_s = np.where(is_hit, 0.0, launches.horizon_s)
    pace = (np.abs(motion[:, 0]) + np.linalg.norm(motion[:, 1:], axis=1)) / launches.radius_m
    order = np.argsort(pace, kind="stable")
    while len(order):
        for first in range(0, len(order), slots.n):
            rows = order[first : first + slots.n]
            found = slots.run(launches, rows, (place, motion), (left_s, pace))
            is_hit[rows] |= found
            left_s[rows] = np.where(found, 0.0, left_s[rows] - _PART_S)
        is_moving = np.any(np.abs(motion[order]) > 1e-4, axis=1)
        order = order[(left_s[order] > 1e-9) & is_moving]
    return is_hit


class _Slots:
    """One model of n pairs side by side, used again and again with other numbers."""

    def __init__(self, n: int) -> None:
        self._mujoco = module("mujoco")
        self._rollout: Any = module("mujoco.rollout").rollout
        self._model = self._mujoco.MjModel.from_xml_string(_xml(n))
        self._data = self._mujoco.MjData(self._model)
        self.n = n

    def run(
        self,
        launches: Launches,
        rows: Array,
        state: Tuple[Array, Array],
        pacing: Tuple[Array, Array],
    ) -> Array:
        """Run rows for one part; update ``state`` in place and return which touch (r,).

        ``state`` is way of the mover and place of the target (m, 3), and their velocities;
        ``pacing`` the time left and the pace in combined radii per second, (m,) each.
        """
        model, used = self._model, len(rows)
        part_s = np.minimum(pacing[0][rows], _PART_S)
        step_s = float(np.clip(_WAY_PER_STEP / max(pacing[1][rows].max(), 1e-9), *_STEP_S))
        n_steps = max(1, int(np.ceil(part_s.max() / step_s)))
        model.opt.timestep = step_s = max(float(part_s.max()), 1e-6) / n_steps
        model.geom_solref[:, 0] = 2.0 * step_s
        radius = np.full(self.n, 1e-3)
        radius[:used] = 0.5 * launches.radius_m[rows]
        model.geom_size[:, 0] = model.geom_rbound[:] = np.repeat(radius, 2)
        model.dof_frictionloss[: 3 * used : 3] = _MASS_KG * launches.decel_m_s2[rows]
        place, motion = np.zeros((self.n, 3)), np.zeros((self.n, 3))
        place[used:, 1] = 1.0
        place[:used], motion[:used] = state[0][rows], state[1][rows]
        start = np.concatenate([[0.0], place.ravel(), motion.ravel()])
        states, sensed = self._rollout(model, [self._data], start[None], nstep=n_steps)
        end = states[0, -1, 1:].reshape(2, self.n, 3)
        state[0][rows], state[1][rows] = end[0, :used], end[1, :used]
        time = np.arange(n_steps) * step_s
        is_in = (sensed[0, :, :used] > 0.0) & (time[:, None] <= part_s)
        found: Array = is_in.any(axis=0)
        return found


def _xml(n: int) -> str:
    bodies, sensors = [], []
    for slot in range(n):
        y = _APART_M * slot
        rail = '<joint type="slide" axis="1 0 0"/>'
        free = rail + '<joint type="slide" axis="0 1 0"/>'
        for name, joints, mask in (("m", rail, 'conaffinity="0"'), ("t", free, 'contype="0"')):
            bodies.append(
                f'<body pos="0 {y} 0">{joints}<geom name="{name}{slot}" type="sphere" '
                f'size="{_LARGEST_M}" mass="{_MASS_KG}" {mask}/></body>'
            )
        sensors.append(f'<contact geom1="m{slot}" geom2="t{slot}" data="found"/>')
    return (
        '<mujoco><option integrator="implicitfast" cone="elliptic" gravity="0 0 0"/><worldbody>'
        f"{''.join(bodies)}</worldbody><sensor>{''.join(sensors)}</sensor></mujoco>"
    )


def _perturb(pairs: Pairs, is_still: Array, rng: np.random.Generator) -> Tuple[Array, Array]:
    """Draw offset and mover velocity (m, 2) each from the covariance of the pair.

    Where the target lies still only the mover's half of the velocity's covariance is left.
    """
    share = np.where(is_still, 0.5, 1.0)[:, None, None]
    cov = pairs.cov.copy()
    cov[:, 2:, :] *= share
    cov[:, :2, 2:] *= share
    values, vectors = np.linalg.eigh(cov)
    spread = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    error = np.einsum("mij,mj->mi", spread, rng.normal(size=(len(cov), 4)))
    # The covariance is that of target minus mover.
    return pairs.offset_m + error[:, :2], pairs.mover_vel_m_s - error[:, 2:]


def _decel(pairs: Pairs, speed: Array, rng: np.random.Generator) -> Array:
    """Draw how hard each mover (m,) slows down; see the module's text."""
    n = len(speed)
    low, high = np.log(_WAY_LEFT_M)
    way = np.exp(rng.uniform(low, high, n))
    unknown = np.where(rng.random(n) < _RUNS_ON_SHARE, 0.0, 0.5 * speed * speed / way)
    place_var = 0.25 * np.einsum("mii->m", pairs.cov[:, :2, :2])
    speed_var = 0.25 * np.einsum("mii->m", pairs.cov[:, 2:, 2:])
    doubt = _ACC_SD * speed_var / np.sqrt(np.maximum(place_var, 1e-12))
    measured = pairs.decel_m_s2 + doubt * (_PROVEN_SD + rng.normal(size=n))
    decel: Array = np.where(pairs.decel_m_s2 > 0.0, np.maximum(measured, 0.0), unknown)
    return decel


def _turned(vectors: Array, ahead: Array) -> Array:
    """Return vectors (m, 2) in the frame whose x axis is ``ahead (m, 2)``."""
    along = np.einsum("mi,mi->m", vectors, ahead)
    left = vectors[:, 1] * ahead[:, 0] - vectors[:, 0] * ahead[:, 1]
    return np.column_stack([along, left])
