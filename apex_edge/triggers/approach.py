"""Closest approach of pairs of objects: how near, when, how sure, and how soon at worst.

One piece of geometry serves every trigger and the trainer. The mover runs straight on, at constant
speed or slowing down at a constant rate until it rests (a ball that rolls out before it gets there
is no hazard); the other runs at constant velocity. At constant speed, the normal case, the relative
path is one straight line with a closed form; only the rows that slow down are cut into chords.
Works in any number of dimensions d; the triggers use the table plane, d = 2.

A numpy call on the 49 pairs of a star costs what it costs however few numbers it works on, so the
straight path is worked out in few calls on whole rows of m. Closest approach, features and logit
of 49 pairs took 480 us with einsum over (m, d) and chords for every row, and take 70 us like this,
100 times one product of 50 numbers (Python 3.7, numpy 1.21). Of one pair they take 60 us: almost
all is the calling.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple, Tuple

import numpy as np

from apex_edge.types import Array

# One-sided 5 % quantile of the normal distribution, in standard deviations.
Z_EARLY = 1.6449
# Chords of a slowing path. Only a moving target sees the chord error: at most
# speed * stop_time / (8 * n^2), 1 mm for 0.4 m/s over 5 s. A resting target sees none.
N_CHORDS = 16
_EDGE = 1e-9
# Added to a length, or to its square, that is divided by: too small to change any but zero, and
# what zero divides is zero too. Takes a third of the time of np.where.
TINY = 1e-150
TINY_SQ = 1e-300
# As arrays: a Python number is made into one at every call, 0.2 us.
_ZERO = np.array(0.0)
_TINY_SQ, _STILL_SQ = np.array(TINY_SQ), np.array(2.0 * TINY_SQ)


@dataclass(frozen=True)
class Pairs:
    """m pairs of objects, target as seen from the mover, in d dimensions.

    ``offset_m (m, d)`` target minus mover; ``mover_vel_m_s``, ``target_vel_m_s (m, d)``;
    ``decel_m_s2 (m,)`` >= 0, of the mover against its own velocity; ``radius_m (m,)`` sum of both
    radii; ``cov (m, 2d, 2d)`` of the relative position and velocity.
    """

    offset_m: Array
    mover_vel_m_s: Array
    target_vel_m_s: Array
    decel_m_s2: Array
    radius_m: Array
    cov: Array

    def take(self, rows: Array) -> "Pairs":
        """Return the pairs chosen by a mask or by indices."""
        return Pairs(
            self.offset_m[rows],
            self.mover_vel_m_s[rows],
            self.target_vel_m_s[rows],
            self.decel_m_s2[rows],
            self.radius_m[rows],
            self.cov[rows],
        )


class Approach(NamedTuple):
    """Closest approach of m pairs within a horizon.

    ``tca_s (m,)`` time of the closest approach (the first, if several). As of now, each (m,):
    ``distance_m`` between centres, ``speed_m_s`` relative, ``closing_m_s`` > 0 when nearing.
    ``near_m (2, m)`` distance at the closest approach, and what is left along today's line of
    sight at the horizon; ``sd_m (2, m)`` sd of the two: of the miss, read across the relative
    velocity, where an error changes the miss and not only its time, and along the line of sight.
    Both carry the covariance forward for as long as an error of velocity acts (a resting mover has
    stopped drifting). A row with a NaN in its input has NaN.
    """

    tca_s: Array
    distance_m: Array
    speed_m_s: Array
    closing_m_s: Array
    near_m: Array
    sd_m: Array

    @property
    def dca_m(self) -> Array:
        """Return the distance (m,) between centres at the closest approach."""
        dca: Array = self.near_m[0]
        return dca

    @property
    def miss_sd_m(self) -> Array:
        """Return the sd (m,) of the miss distance."""
        sd: Array = self.sd_m[0]
        return sd

    def take(self, rows: Array) -> "Approach":
        """Return the pairs chosen by a mask or by indices."""
        return Approach(*[column[..., rows] for column in self])


def closest(pairs: Pairs, horizon_s: float) -> Approach:
    """Find the closest approach of each pair within the horizon.

    Source: APEX section "Trigger" asks which relations matter; the geometry is ours
    (DCA and TCA as in conjunction assessment).
    """
    straight = _in_plane if pairs.offset_m.shape[1] == 2 else _in_space
    found, arms, length_sq = straight(pairs, horizon_s)
    slowing = pairs.decel_m_s2.nonzero()[0]
    if len(slowing):
        path = _chord_approach(pairs.take(slowing), horizon_s)
        found.tca_s[slowing], found.near_m[:, slowing] = path.tca_s, path.near_m
        some = arms[..., slowing]
        np.multiply(some[0], path.drift_s, some[1])
        sd = _spread_sd(pairs.cov[slowing], some, length_sq[:, slowing], path.drift_s)
        found.sd_m[:, slowing] = sd
    return found


def _in_plane(pairs: Pairs, horizon_s: float) -> Tuple[Approach, Array, Array]:
    """Return the approach along straight paths, and what ``_spread_sd`` reads it along."""
    n = len(pairs.radius_m)
    arms, near, drift = np.empty((2, 2, 2, n)), np.empty((2, n)), np.empty((2, n))
    now, later = arms
    tca, end = drift
    end.fill(horizon_s)
    velocity_x, velocity_y = (pairs.mover_vel_m_s - pairs.target_vel_m_s).T
    across_x, offset_x, across_y, offset_y = now.reshape(4, n)
    now[:, 1] = pairs.offset_m.T
    across_x[:] = velocity_y
    np.negative(velocity_x, across_y)
    squares = now * now
    length_sq = squares[0] + squares[1]
    length_sq += _TINY_SQ
    speed, distance = np.sqrt(length_sq)
    nearing = velocity_x * offset_x + velocity_y * offset_y
    np.minimum(np.maximum(nearing / length_sq[0], _ZERO), end, out=tca)
    np.multiply(now, drift, later)
    # What is left of the offset after tca * velocity; the carried arm holds the two, turned.
    np.hypot(offset_x + later[1, 0], offset_y - later[0, 0], near[0])
    closing = nearing / distance
    np.subtract(distance, closing * end, near[1])
    sd = _spread_sd(pairs.cov, arms, length_sq, drift)
    return Approach(tca, distance, speed, closing, near, sd), arms, length_sq


def _in_space(pairs: Pairs, horizon_s: float) -> Tuple[Approach, Array, Array]:
    """Do the same in any number of dimensions, where across the velocity is no single line."""
    n, n_dims = pairs.offset_m.shape
    offset, velocity = pairs.offset_m.T, (pairs.mover_vel_m_s - pairs.target_vel_m_s).T
    now = np.stack([velocity, offset], axis=1)
    length_sq = _dot(now, now) + _TINY_SQ
    speed, distance = np.sqrt(length_sq)
    nearing = _dot(velocity, offset)
    tca = np.minimum(np.maximum(nearing / length_sq[0], 0.0), horizon_s)
    drift = np.array([tca, np.full(n, horizon_s)])
    arms = np.array([now, now * drift])
    gap = offset - tca * velocity
    closing = nearing / distance
    near = np.array([np.sqrt(_dot(gap, gap)), distance - horizon_s * closing])
    sd = _spread_sd(pairs.cov, arms, length_sq, drift)
    return Approach(tca, distance, speed, closing, near, sd), arms, length_sq


def first_contact(pairs: Pairs, approach: Approach, horizon_s: float) -> Array:
    """Return the time to contact (m,): 0 when touching now, inf when none within the horizon."""
    distance, speed, radius = approach.distance_m, approach.speed_m_s, pairs.radius_m
    nearing = approach.closing_m_s * distance
    disc = nearing * nearing + speed * speed * (radius * radius - distance * distance)
    entry = (nearing - np.sqrt(np.maximum(disc, 0.0))) / (speed * speed + TINY_SQ)
    contact: Array = np.where(approach.near_m[0] <= radius, np.maximum(0.0, entry), np.inf)
    slowing = pairs.decel_m_s2.nonzero()[0]
    if len(slowing):
        contact[slowing] = _chord_contact(pairs.take(slowing), horizon_s)
    return contact


def early_contact(pairs: Pairs, approach: Approach, horizon_s: float) -> Array:
    """Return the pessimistic time to contact (m,): real contact is later in about 95 % of cases.

    The mover is taken faster by 1.64 sd of the relative speed, the miss smaller by 1.64 sd of the
    miss distance, and the radius larger by 1.64 sd of the relative position. inf when even then
    nothing touches within the horizon, or when the two are not nearing at all.
    """
    n_dims = pairs.offset_m.shape[1]
    offset = pairs.offset_m.T
    heading = (pairs.mover_vel_m_s - pairs.target_vel_m_s).T / approach.speed_m_s
    ahead = _dot(offset, heading)
    across = offset - ahead * heading
    gap = np.sqrt(_dot(across, across))
    miss = np.maximum(gap - Z_EARLY * approach.sd_m[0], 0.0)
    cov = pairs.cov.transpose(1, 2, 0)
    speed_var = _variance(cov[n_dims:, n_dims:], heading)
    place_var = _trace(cov[:n_dims, :n_dims]) / n_dims
    extra = Z_EARLY * np.sqrt(np.maximum(speed_var, 0.0))
    radius = pairs.radius_m + Z_EARLY * np.sqrt(np.maximum(place_var, 0.0))
    early = _line_contact((ahead, miss), approach.speed_m_s + extra, radius, horizon_s)
    slowing = pairs.decel_m_s2.nonzero()[0]
    if len(slowing):
        keep = miss / (gap + TINY)
        worst = Pairs(
            offset_m=(keep * across + ahead * heading).T,
            mover_vel_m_s=pairs.mover_vel_m_s + (extra * heading).T,
            target_vel_m_s=pairs.target_vel_m_s,
            decel_m_s2=pairs.decel_m_s2,
            radius_m=radius,
            cov=pairs.cov,
        )
        early[slowing] = _chord_contact(worst.take(slowing), horizon_s)
    result: Array = np.where(approach.tca_s > 0.0, early, np.inf)
    return result


def _line_contact(
    place: Tuple[Array, Array], speed: Array, radius: Array, horizon_s: float
) -> Array:
    """Return when (m,) something at ``place``, ahead and aside, that comes straight on touches."""
    ahead, miss = place
    left = ahead - speed * np.minimum(np.maximum(0.0, ahead / speed), horizon_s)
    room = radius * radius - miss * miss
    entry = (ahead - np.sqrt(np.maximum(room, 0.0))) / speed
    contact: Array = np.where(left * left <= room, np.maximum(0.0, entry), np.inf)
    return contact


def _dot(a: Array, b: Array) -> Array:
    """Return the product summed over the components, (d, ..., m) -> (..., m)."""
    product = a * b
    total: Array = product[0]
    for component in product[1:]:
        total += component
    return total


def _spread_sd(cov: Array, arms: Array, length_sq: Array, drift_s: Array) -> Array:
    """Return the sd (2, m) of the miss and of the distance along the line of sight.

    P = Ppp + t (Ppv + Pvp) + t^2 Pvv, read along a direction u, is the whole covariance read along
    (u, t u): both directions at once, in two products and one sum.

    Parameters
    ----------
    cov : (m, 2d, 2d).
    arms : (2, d, 2, m), u and t u of both directions: in the plane across the velocity, else
        along it, and along the offset.
    length_sq : (2, m) of u. drift_s : (2, m) the times t.
    """
    n_dims = arms.shape[1]
    rows = cov.transpose(1, 2, 0)
    variance = _variance(rows[:, :, None], arms.reshape(2 * n_dims, 2, -1))
    variance /= length_sq
    if n_dims != 2:
        variance[0] = (_carried_trace(rows, drift_s[0]) - variance[0]) / max(n_dims - 1, 1)
    still = (length_sq[0] <= _STILL_SQ).nonzero()[0]
    if len(still):
        variance[0, still] = _carried_trace(rows[:, :, still], drift_s[0, still]) / n_dims
    sd: Array = np.sqrt(np.maximum(variance, _ZERO))
    return sd


def _variance(cov: Array, direction: Array) -> Array:
    """Return u' P u for ``cov (k, k, ..., m)`` and ``direction u (k, ..., m)``, as (..., m)."""
    outer = direction[:, None] * direction
    outer *= cov
    n_products = len(direction) ** 2
    total = _ones(n_products).dot(outer.reshape(n_products, -1))
    variance: Array = total.reshape(direction.shape[1:])
    return variance


@lru_cache(maxsize=None)
def _ones(n: int) -> Array:
    """Return n ones; the product with them sums rows in a third of the time of np.sum."""
    return np.ones(n)


def _trace(cov: Array) -> Array:
    total: Array = cov[0, 0].copy()
    for axis in range(1, len(cov)):
        total += cov[axis, axis]
    return total


def _carried_trace(cov: Array, drift_s: Array) -> Array:
    """Return the trace (m,) of the covariance (2d, 2d, m) of place, carried forward."""
    n_dims = len(cov) // 2
    place, cross = cov[:n_dims, :n_dims], cov[:n_dims, n_dims:] + cov[n_dims:, :n_dims]
    rate = _trace(cross) + drift_s * _trace(cov[n_dims:, n_dims:])
    carried: Array = _trace(place) + drift_s * rate
    return carried


class _Chords(NamedTuple):
    """Closest approach of m slowing pairs.

    ``tca_s (m,)``; ``near_m (2, m)`` as in Approach; ``drift_s (2, m)``, how long an error of
    velocity acts until the closest approach and until the horizon.
    """

    tca_s: Array
    near_m: Array
    drift_s: Array


def _chord_approach(pairs: Pairs, horizon_s: float) -> _Chords:
    """Find the closest approach of pairs whose mover slows down."""
    stop = _stop_time(pairs)
    times, offsets = _knots(pairs, stop, horizon_s)
    start, step = offsets[:, :-1], np.diff(offsets, axis=1)
    step_sq, along = _squares(step, step), _squares(start, step)
    share = np.clip(-along / (step_sq + TINY_SQ), 0.0, 1.0)
    close = start + share[..., None] * step
    gaps = np.sqrt(_squares(close, close))
    rows = np.arange(len(gaps))
    best = np.argmin(gaps, axis=1)
    tca = times[rows, best] + share[rows, best] * np.diff(times, axis=1)[rows, best]
    offset = pairs.offset_m[:, None]
    left = (_squares(offsets[:, -1:], offset) / np.sqrt(_squares(offset, offset) + TINY_SQ))[:, 0]
    return _Chords(
        tca_s=tca,
        near_m=np.array([gaps[rows, best], left]),
        drift_s=np.minimum([tca, np.full(len(tca), horizon_s)], stop),
    )


def _chord_contact(pairs: Pairs, horizon_s: float) -> Array:
    """Return the time to contact (m,) of pairs whose mover slows down, inf when none."""
    times, offsets = _knots(pairs, _stop_time(pairs), horizon_s)
    entry = _entry(offsets[:, :-1], np.diff(offsets, axis=1), pairs.radius_m)
    moments = times[:, :-1] + entry * np.diff(times, axis=1)
    contact = np.min(np.where(np.isfinite(entry), moments, np.inf), axis=1)
    is_touching = np.sqrt(_squares(offsets[:, 0], offsets[:, 0])) <= pairs.radius_m
    result: Array = np.where(is_touching, 0.0, contact)
    return result


def _squares(a: Array, b: Array) -> Array:
    dot: Array = np.einsum("...d,...d->...", a, b)
    return dot


def _stop_time(pairs: Pairs) -> Array:
    speed: Array = np.sqrt(_squares(pairs.mover_vel_m_s, pairs.mover_vel_m_s))
    stop: Array = speed / pairs.decel_m_s2
    return stop


def _knots(pairs: Pairs, stop: Array, horizon_s: float) -> Tuple[Array, Array]:
    """Return times (m, k) and relative offsets (m, k, d) between which the path is straight."""
    bend = np.minimum(stop, horizon_s)
    times = bend[:, None] * np.linspace(0.0, 1.0, N_CHORDS + 1)
    times = np.column_stack([times, np.full(len(bend), horizon_s)])
    moved = np.minimum(times, stop[:, None])
    # Travel v t - a t^2 / 2, as a share of the velocity v; a = v / stop.
    moved = moved * (1.0 - 0.5 * moved / (stop[:, None] + TINY))
    offsets = (
        pairs.offset_m[:, None, :]
        + pairs.target_vel_m_s[:, None, :] * times[..., None]
        - pairs.mover_vel_m_s[:, None, :] * moved[..., None]
    )
    return times, offsets


def _entry(start: Array, step: Array, radius_m: Array) -> Array:
    """Return the share (m, k) of each chord at which it enters the radius, NaN if it does not."""
    step_sq, along = _squares(step, step), _squares(start, step)
    outside = _squares(start, start) - (radius_m * radius_m)[:, None]
    disc = along * along - step_sq * outside
    can = (disc >= 0.0) & (step_sq > 0.0) & (outside >= 0.0)
    root = np.sqrt(np.where(can, disc, 0.0))
    share = (-along - root) / np.where(can, step_sq, 1.0)
    is_in = can & (share >= -_EDGE) & (share <= 1.0 + _EDGE)
    entry: Array = np.where(is_in, np.clip(share, 0.0, 1.0), np.nan)
    return entry
