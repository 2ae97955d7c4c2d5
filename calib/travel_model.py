"""How a servo gets to its target: dead time, then a ramp that is either lagged or trapezoidal.

Times in seconds, angles in radians; pure functions. Source: ours (textbook step responses).
"""

import math
from typing import Callable, NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.types import Array

LAG, TRAPEZOID = "lag", "trapezoid"
KINDS = (LAG, TRAPEZOID)
_Rest = Callable[[Array], Array]
_SMALLEST = 1e-4
_STEPS = 60


class Travel(NamedTuple):
    """``shape`` is the time constant in s of kind "lag", the acceleration of "trapezoid"."""

    kind: str
    dead_s: float
    rate_rad_s: float
    shape: float

    def way_rad(self, t_s: Array, turn_rad: Array) -> Array:
        """Return how far (n,) a servo has got ``t_s`` (n,) after a command to turn (n,)."""
        since = np.maximum(t_s - self.dead_s, 0.0)
        if self.kind == LAG:
            return _lagged(since, turn_rad, self.rate_rad_s, self.shape)
        return _trapezoid(since, turn_rad, self.rate_rad_s, self.shape)

    def arrival_s(self, turn_rad: float, within_rad: float) -> float:
        """Return when a servo stands within an angle of its target, from the command on."""
        if self.kind == LAG:
            ramp_s = turn_rad / self.rate_rad_s
            return self.dead_s + max(ramp_s + self.settle_s(within_rad), 0.0)
        peak = min(self.rate_rad_s, math.sqrt(self.shape * turn_rad))
        whole_s = turn_rad / peak + peak / self.shape
        return self.dead_s + whole_s - math.sqrt(2.0 * within_rad / self.shape)

    def settle_s(self, within_rad: float) -> float:
        """Return how long after the ramp's end a lagging servo is within an angle."""
        if self.kind != LAG:
            return 0.0
        return self.shape * math.log(max(self.shape * self.rate_rad_s / within_rad, 1.0))


def _lagged(since: Array, turn: Array, rate: float, tau: float) -> Array:
    ramp_s = turn / rate
    rising = rate * (since + tau * np.expm1(-since / tau))
    left = rate * tau * -np.expm1(-ramp_s / tau)
    falling = turn - left * np.exp(-np.maximum(since - ramp_s, 0.0) / tau)
    result: Array = np.where(since < ramp_s, rising, falling)
    return result


def _trapezoid(since: Array, turn: Array, rate: float, accel: float) -> Array:
    peak = np.minimum(rate, np.sqrt(accel * turn))
    ramp_s = peak / accel
    whole_s = turn / peak + ramp_s
    left = np.maximum(whole_s - since, 0.0)
    speeding = 0.5 * accel * since**2
    steady = peak * (since - 0.5 * ramp_s)
    braking = turn - 0.5 * accel * left**2
    result: Array = np.where(since < ramp_s, speeding, np.where(left > ramp_s, steady, braking))
    return result


class Fitted(NamedTuple):
    """A fit: residuals (n,) in rad and the standard deviations of dead time and rate."""

    travel: Travel
    residual_rad: Array
    sd_dead_s: float
    sd_rate_rad_s: float


def fit(t_s: Array, way_rad: Array, turn_rad: Array, first: Travel) -> Fitted:
    """Fit a model of ``first``'s kind to ways (n,) at times (n,) of turns (n,), all positive.

    Levenberg-Marquardt on dead time and the logarithms of the other two.
    """
    at = np.array([first.dead_s, math.log(first.rate_rad_s), math.log(first.shape)])

    def rest(x: Array) -> Array:
        gap: Array = _model(first.kind, x).way_rad(t_s, turn_rad) - way_rad
        return gap

    residual, damping = rest(at), 1e-2
    for _ in range(_STEPS):
        slope = _slopes(rest, at, residual)
        normal = slope.T @ slope
        step = _solve(normal + damping * np.diag(np.diag(normal) + 1e-12), -slope.T @ residual)
        if step is None:
            break
        tried = at + np.clip(step, -0.5, 0.5)
        after = rest(tried)
        if after @ after < residual @ residual:
            is_done = residual @ residual - after @ after < 1e-10 * (residual @ residual)
            at, residual, damping = tried, after, damping * 0.3
            if is_done:
                break
        else:
            damping *= 4.0
            if damping > 1e8:
                break
    slope = _slopes(rest, at, residual)
    spread = np.linalg.pinv(slope.T @ slope) * (residual @ residual) / max(1, len(residual) - 3)
    sd = np.sqrt(np.maximum(np.diag(spread), 0.0))
    found = _model(first.kind, at)
    return Fitted(found, residual, float(sd[0]), float(sd[1]) * found.rate_rad_s)


def _model(kind: str, x: Array) -> Travel:
    rate, shape = np.exp(np.clip(x[1:], -12.0, 12.0))
    return Travel(kind, float(x[0]), float(rate), max(float(shape), _SMALLEST))


def _slopes(rest: _Rest, at: Array, residual: Array) -> Array:
    columns = []
    for i in range(len(at)):
        moved = at.copy()
        moved[i] += 1e-5
        columns.append((rest(moved) - residual) / 1e-5)
    result: Array = np.column_stack(columns)
    return result


def _solve(matrix: Array, right: Array) -> Optional[Array]:
    try:
        result: Array = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return None
    return result if np.isfinite(result).all() else None


def first_guess(kind: str, t_s: Array, way_rad: Array, turn_rad: Array) -> Travel:
    """Return a model to start from: the middle of the rise tells rate and dead time."""
    share = way_rad / turn_rad
    rises = (share > 0.15) & (share < 0.85)
    if rises.sum() >= 2 and np.ptp(t_s[rises]) > 0.0:
        design = np.column_stack([way_rad[rises], np.ones(int(rises.sum()))])
        slow, late = np.linalg.lstsq(design, t_s[rises], rcond=None)[0]
    else:
        slow, late = 0.3, 0.0
    rate = 1.0 / max(float(slow), 1e-3)
    shape_s = 0.03
    dead_s = max(float(late) - shape_s, 0.0)
    return Travel(kind, dead_s, rate, shape_s if kind == LAG else rate / shape_s)


def crossing(t_s: Array, way_rad: Array, turn_rad: float, within_rad: float) -> Tuple[float, float]:
    """Return when a recorded step first stays within an angle of its target, and the gap before."""
    is_off = np.abs(way_rad - turn_rad) > within_rad
    if not is_off.any():
        return float(t_s[0]), 0.0
    last = int(np.flatnonzero(is_off)[-1])
    if last + 1 >= len(t_s):
        return math.nan, math.nan
    return float(t_s[last + 1]), float(t_s[last + 1] - t_s[last])
