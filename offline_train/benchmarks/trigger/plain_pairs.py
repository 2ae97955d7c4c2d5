"""Peer of the device's pair geometry and of its 12 features: one pair at a time, in plain Python.

The formulas as one would write them down, with no array and nothing shared between them. Tests
compare the device's rows with it, and the bench takes it as the yardstick of a noisy machine.
Source: ours.
"""

import math
from typing import Iterator, List, NamedTuple, Sequence, Tuple

from apex_edge.triggers.approach import N_CHORDS, Z_EARLY, Pairs

Vector = List[float]
Matrix = List[List[float]]
_SD_FLOOR_M = 1e-4
_PRODUCT_SD = 4.0


class PlainPair(NamedTuple):
    """One pair: vectors of d numbers, ``cov`` 2d rows of 2d numbers; units as in Pairs."""

    offset_m: Vector
    mover_vel_m_s: Vector
    target_vel_m_s: Vector
    decel_m_s2: float
    radius_m: float
    cov: Matrix


class PlainApproach(NamedTuple):
    """Closest approach of one pair; units as in Approach."""

    dca_m: float
    tca_s: float
    ttc_s: float
    left_m: float
    miss_sd_m: float
    sight_sd_m: float


def pairs_in(pairs: Pairs) -> Iterator[PlainPair]:
    """Yield the pairs one by one."""
    for row in range(len(pairs.radius_m)):
        yield PlainPair(
            pairs.offset_m[row].tolist(),
            pairs.mover_vel_m_s[row].tolist(),
            pairs.target_vel_m_s[row].tolist(),
            float(pairs.decel_m_s2[row]),
            float(pairs.radius_m[row]),
            pairs.cov[row].tolist(),
        )


def closest(pair: PlainPair, horizon_s: float) -> PlainApproach:
    """Return the closest approach of one pair, chord by chord."""
    stop_s = _stop_time(pair)
    dca_m, tca_s, ttc_s = math.inf, 0.0, math.inf
    for begin_s, end_s in _spans(stop_s, horizon_s):
        start, end = _place(pair, stop_s, begin_s), _place(pair, stop_s, end_s)
        step = [b - a for a, b in zip(start, end)]
        share = _nearest_share(start, step)
        gap = _length([a + share * s for a, s in zip(start, step)])
        if gap < dca_m:
            dca_m, tca_s = gap, begin_s + share * (end_s - begin_s)
        entry = _entry_share(start, step, pair.radius_m)
        ttc_s = min(ttc_s, begin_s + entry * (end_s - begin_s))
    if _length(pair.offset_m) <= pair.radius_m:
        ttc_s = 0.0
    sight = _unit(pair.offset_m)
    heading = _unit([t - m for t, m in zip(pair.target_vel_m_s, pair.mover_vel_m_s)])
    spread = _carried(pair.cov, min(tca_s, stop_s))
    far_spread = _carried(pair.cov, min(horizon_s, stop_s))
    return PlainApproach(
        dca_m=dca_m,
        tca_s=tca_s,
        ttc_s=ttc_s,
        left_m=_dot(_place(pair, stop_s, horizon_s), sight),
        miss_sd_m=math.sqrt(max(0.0, _across(spread, heading))),
        sight_sd_m=math.sqrt(max(0.0, _along(far_spread, sight))),
    )


def early_contact(pair: PlainPair, found: PlainApproach, horizon_s: float) -> float:
    """Return the pessimistic time to contact of one pair."""
    n_dims = len(pair.offset_m)
    if not found.tca_s > 0.0:
        return math.inf
    heading = _unit([m - t for t, m in zip(pair.target_vel_m_s, pair.mover_vel_m_s)])
    ahead = _dot(pair.offset_m, heading)
    across = [o - ahead * h for o, h in zip(pair.offset_m, heading)]
    miss = _length(across)
    keep = max(0.0, 1.0 - Z_EARLY * found.miss_sd_m / miss) if miss > 0.0 else 0.0
    speed_cov = [row[n_dims:] for row in pair.cov[n_dims:]]
    speed_sd = math.sqrt(max(0.0, _along(speed_cov, heading)))
    place_var = sum(pair.cov[axis][axis] for axis in range(n_dims)) / n_dims
    worst = pair._replace(
        offset_m=[ahead * h + keep * c for h, c in zip(heading, across)],
        mover_vel_m_s=[m + Z_EARLY * speed_sd * h for m, h in zip(pair.mover_vel_m_s, heading)],
        radius_m=pair.radius_m + Z_EARLY * math.sqrt(max(0.0, place_var)),
    )
    return closest(worst, horizon_s).ttc_s


def features(pair: PlainPair, found: PlainApproach, horizon_s: float) -> List[float]:
    """Return the 12 features of one pair."""
    radius = pair.radius_m
    distance = _length(pair.offset_m)
    relative = [m - t for t, m in zip(pair.target_vel_m_s, pair.mover_vel_m_s)]
    speed = _length(relative)
    closing = _dot(relative, _unit(pair.offset_m))
    sigma = max(found.miss_sd_m, _SD_FLOOR_M)
    z = (radius - found.dca_m) / sigma
    reach = (radius - found.left_m) / max(found.sight_sd_m, _SD_FLOOR_M)
    product = 1.0
    for factor in (z, reach):
        product *= min(max(factor, -_PRODUCT_SD), _PRODUCT_SD)
    return [
        distance / radius,
        closing * horizon_s / radius,
        speed * horizon_s / radius,
        closing / speed if speed > 0.0 else 0.0,
        found.dca_m / radius,
        found.tca_s / horizon_s,
        z,
        reach,
        max(z, 0.0),
        max(reach, 0.0),
        sigma / radius,
        product,
    ]


def _stop_time(pair: PlainPair) -> float:
    if not pair.decel_m_s2 > 0.0:
        return math.inf
    return _length(pair.mover_vel_m_s) / pair.decel_m_s2


def _spans(stop_s: float, horizon_s: float) -> List[Tuple[float, float]]:
    """Return begin and end of the chords: one for a steady mover, then one at rest."""
    if stop_s == math.inf:
        return [(0.0, horizon_s)]
    bend_s = min(stop_s, horizon_s)
    knots = [bend_s * number / N_CHORDS for number in range(N_CHORDS + 1)]
    return list(zip(knots, knots[1:] + [horizon_s]))


def _place(pair: PlainPair, stop_s: float, time_s: float) -> Vector:
    """Return the offset at a time."""
    moved_s = min(time_s, stop_s)
    # v t - a t^2 / 2 in units of v, with a = v / stop; 0 / 0 for a mover that has stopped already
    moved_s *= 1.0 - (0.5 * moved_s / stop_s if stop_s > 0.0 else 0.0)
    return [
        offset + (target * time_s - mover * moved_s)
        for offset, target, mover in zip(pair.offset_m, pair.target_vel_m_s, pair.mover_vel_m_s)
    ]


def _nearest_share(start: Vector, step: Vector) -> float:
    step_sq = _dot(step, step)
    return min(max(-_dot(start, step) / step_sq, 0.0), 1.0) if step_sq > 0.0 else 0.0


def _entry_share(start: Vector, step: Vector, radius_m: float) -> float:
    """Return the share of a chord at which it enters the radius, inf if it does not."""
    step_sq, along = _dot(step, step), _dot(start, step)
    outside = _dot(start, start) - radius_m * radius_m
    disc = along * along - step_sq * outside
    if disc < 0.0 or outside < 0.0 or not step_sq > 0.0:
        return math.inf
    share = (-along - math.sqrt(disc)) / step_sq
    return min(max(share, 0.0), 1.0) if -1e-9 <= share <= 1.0 + 1e-9 else math.inf


def _carried(cov: Matrix, time_s: float) -> Matrix:
    n = len(cov) // 2
    return [
        [
            cov[i][j]
            + time_s * (cov[i][n + j] + cov[n + i][j])
            + time_s * time_s * cov[n + i][n + j]
            for j in range(n)
        ]
        for i in range(n)
    ]


def _across(spread: Matrix, heading: Vector) -> float:
    total = sum(spread[axis][axis] for axis in range(len(spread)))
    if not any(heading):
        return total / len(spread)
    return (total - _along(spread, heading)) / max(len(spread) - 1, 1)


def _along(spread: Matrix, direction: Vector) -> float:
    return sum(
        a * spread[i][j] * b for i, a in enumerate(direction) for j, b in enumerate(direction)
    )


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b))


def _length(vector: Sequence[float]) -> float:
    return math.sqrt(_dot(vector, vector))


def _unit(vector: Sequence[float]) -> Vector:
    length = _length(vector)
    return [value / length for value in vector] if length > 0.0 else [0.0] * len(vector)
