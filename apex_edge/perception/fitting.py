"""Weighted least squares of a line or a parabola through the sightings of one object.

Small arrays, many times a frame: plain sums where a numpy call would cost more. Source: ours.
"""

from typing import NamedTuple, Optional, Sequence, Tuple

import numpy as np

from apex_edge.types import Array

LINE, PARABOLA = 2, 3
_PRIOR_DOF = 4.0  # weight of the stated noise against the residuals


class Sample(NamedTuple):
    """One sighting: capture time, position (d,) and the sd of its noise (one axis)."""

    t_s: float
    x: Array
    sd: float


class Points(NamedTuple):
    """Sightings as arrays: ``t_s (n,)`` before the newest (<= 0), ``x (n, d)``, ``var (n,)``."""

    newest_s: float
    t_s: Array
    x: Array
    var: Array


class Fit(NamedTuple):
    """Polynomial ``beta (p, d)`` about ``t_s`` with ``unit_cov (p, p)`` and ``noise_var (d,)``.

    ``held_acc (d,)`` is an acceleration that was taken as known, beside the polynomial. ``misfit``
    is the sum of squared residuals over the expected variance, ``lean`` the same of the sum of the
    newest three: large when the motion has just begun to leave the fit. ``worst`` is the sample
    whose removal would lower the misfit most, by ``gain``.
    """

    t_s: float
    beta: Array
    held_acc: Array
    unit_cov: Array
    noise_var: Array
    misfit: float
    dof: int
    lean: float
    worst: int
    gain: float

    @property
    def order(self) -> int:
        """Return the number of coefficients: 2 a line, 3 a parabola."""
        return len(self.beta)

    @property
    def acc(self) -> Array:
        """Return the acceleration (d,)."""
        if self.order == LINE:
            return self.held_acc
        result: Array = self.held_acc + 2.0 * self.beta[2]
        return result


def points(samples: Sequence[Sample], sd: Array, stamp_sd_s: float) -> Points:
    """Gather samples; ``sd (n,)`` is their noise, to which the jitter of the stamps is added."""
    newest_s = samples[-1].t_s
    t = np.array([sample.t_s for sample in samples]) - newest_s
    x = np.array([sample.x for sample in samples])
    var = sd * sd
    span = -float(t[0])
    if span > 0.0 and stamp_sd_s > 0.0:
        way = x[-1] - x[0]
        var = var + float(way @ way) * (stamp_sd_s / span) ** 2
    return Points(newest_s, t, x, var)


def solve(seen: Points, order: int, speed_sd: float, held_acc: Optional[Array] = None) -> Fit:
    """Fit a polynomial of ``order`` coefficients about the newest sample.

    The speed has a weak prior of sd ``speed_sd``, so that one or two sightings already give an
    honest state. With ``held_acc`` (d,) that acceleration is taken out first.
    """
    t, x, var = seen.t_s, seen.x, seen.var
    n, dim = x.shape
    if held_acc is None:
        held_acc = np.zeros(dim)
    else:
        x = x - 0.5 * t[:, None] ** 2 * held_acc
    scale = float(var.sum()) / n
    weight = scale / var
    rows = np.ones((n, order))
    rows[:, 1] = t
    if order == PARABOLA:
        rows[:, 2] = t * t
    weighted = rows * weight[:, None]
    normal = weighted.T @ rows
    normal[1, 1] += scale / speed_sd**2
    unit_cov = np.linalg.inv(normal)
    beta = unit_cov @ (weighted.T @ x)
    residual = x - rows @ beta
    square = (residual * residual).sum(axis=1) * weight
    # deleting a sample lowers the sum by its own square over one minus its leverage, exactly
    leverage = ((weighted @ unit_cov) * rows).sum(axis=1)
    gain = square / np.maximum(1.0 - leverage, 1e-6)
    worst = int(gain.argmax())
    dof = max(0, n - order)
    by_axis = weight @ (residual * residual)
    newest = residual[-3:].sum(axis=0)
    return Fit(
        t_s=seen.newest_s,
        beta=beta,
        held_acc=held_acc,
        unit_cov=unit_cov,
        noise_var=(_PRIOR_DOF * scale + by_axis) / (_PRIOR_DOF + dof),
        misfit=float(square.sum()) / scale,
        dof=dof * dim,
        lean=float(newest @ newest) / (3.0 * scale),
        worst=worst,
        gain=float(gain[worst]) / scale,
    )


def at(fit: Fit, dt_s: float) -> Tuple[Array, Array, Tuple[float, float, float]]:
    """Return position (d,) and velocity (d,) ``dt_s`` after the newest sample, and unit variances.

    The variances are those of position, position with velocity, and velocity, for noise 1.
    """
    beta, unit, held = fit.beta, fit.unit_cov, fit.held_acc
    if fit.order == LINE:
        u00, u01, u11 = float(unit[0, 0]), float(unit[0, 1]), float(unit[1, 1])
        variances = (u00 + 2.0 * dt_s * u01 + dt_s * dt_s * u11, u01 + dt_s * u11, u11)
        speed = beta[1] + dt_s * held
        return beta[0] + dt_s * beta[1] + (0.5 * dt_s * dt_s) * held, speed, variances
    row_x = np.array([1.0, dt_s, dt_s * dt_s])
    row_v = np.array([0.0, 1.0, 2.0 * dt_s])
    ahead = unit @ row_v
    variances = (float(row_x @ unit @ row_x), float(row_x @ ahead), float(row_v @ ahead))
    return row_x @ beta, row_v @ beta, variances
