"""Position, velocity and acceleration of one object from its sightings, at capture time.

Sequential gated least squares: a sample within the gate joins the window; one outside waits; when
the newest three waiting agree on a line (or the newest four sightings on a parabola) they become
the window and the motion is flagged as a manoeuvre. A lone outlier is dropped. The window grows
while a line, or a parabola where that fits clearly better, explains it, and shrinks when not.

Measured before building (40 000 simulated tracks, 0.5 px): 100 ms after a bounce 9.5 px/s error
against 606 for the paper's two windows of five; 5 % outliers 2.0 against 34. Source: ours; the
mean of the last five positions (``smooth``) is APEX's "five-frame sliding window".
"""

import math
from collections import deque
from statistics import median
from typing import Deque, List, Optional, Tuple

import numpy as np

from apex_edge.perception.estimator import PAPER_WINDOW, Estimator, Motion, MotionRules
from apex_edge.perception.fitting import LINE, PARABOLA, Fit, Sample, at, points, solve
from apex_edge.types import Array

_GATE_SHARE = {1: 1.0, 2: 1.21, 3: 1.38}  # same probability as one axis at 4 sigma
_CURVED = {
    1: 12.0,
    2: 16.0,
    3: 18.0,
}  # chi-square of curvature that one line in 2000 shows by chance
_MISFIT_SIGMA = 4.0
_LEAN_SHARE = 0.4  # the newest samples pull the fit, so their residuals are small
# Of the noise (between what is stated and what was shown) per frame: what has just begun to move is
# seen late, and by more than its noise at rest lets think.
_ONSET = 0.1
_MIN_NOISE, _N_NOISE = 8, 25
_MIN_NOISE_RATIO, _MAX_NOISE_RATIO = 0.3, 4.0  # of the stated noise, for gates and fits
_LEAST_NOISE = 0.05  # of the stated noise, for what is told
_NOISE_MARGIN = 1.4
_SCALE_SD = 0.02  # of the speed: calibration, and a bias that changes along the way
_LONE_DOUBT = 0.5  # of a first miss's square: as often an outlier as the start of something new
_MIN_CURVED, _SURE_CURVED = 5, 3  # samples, and fits in a row, before a curve is remembered
# Times the misfit that is agreement: surely a line; still nearer the truth than what went before.
_PLAIN_LINE, _POOR_LINE = 0.35, 2.0
_BORROWED_SD = 3.0
_BENT = 4.0  # by which a bend once seen must fit better, 2 sd
_FORGET = 10  # samples that a plain line explains, and the remembered acceleration is no more
# Sd of a measured acceleration over sd(x) / sqrt(n) / T^2 is sqrt(720) = 26.8; real paths are
# straighter than that more often than not.
_UNNOTICED = 16.0
_LEAST_STEP_S = 1e-6  # between two sightings; no camera is faster
_CHANGE_S = 2.0  # mean time between changes of motion on a table
# Innovations are held against what was predicted of them, and the covariance grows with their mean
# square, capped so that an outlier or a bounce counts as little more than a poor sighting.
_N_DISTRUST, _DISTRUST_PRIOR = 20, 4
_DISTRUST_CAP, _MAX_DISTRUST = 9.0, 25.0


class MotionEstimator(Estimator):
    """Follow one object; feed sightings in time order with ``add``, ask with ``predict``."""

    def __init__(self, rules: MotionRules) -> None:
        """Start with no sighting."""
        self._rules = rules
        self._window: List[Sample] = []
        self._waiting: List[Sample] = []
        self._recent: Deque[Sample] = deque(maxlen=PAPER_WINDOW)
        self._noise: Deque[float] = deque(maxlen=_N_NOISE)
        self._shown_sd = 0.0
        self._known_acc: Optional[Array] = None
        self._n_curved = self._n_straight = 0
        self._innovations: Deque[float] = deque(maxlen=_N_DISTRUST)
        self._distrust = 1.0
        self._is_borrowed = False  # the window starts with a sighting from before the restart
        self._fit: Optional[Fit] = None
        self._state: Optional[Motion] = None
        self._state_t_s = 0.0
        self._n_since_manoeuvre = 1 << 30

    @property
    def n_samples(self) -> int:
        """Return the number of sightings behind the present fit."""
        return len(self._window)

    @property
    def last_t_s(self) -> float:
        """Return the capture time of the newest sighting (-inf without one)."""
        return self._recent[-1].t_s if self._recent else float("-inf")

    @property
    def is_manoeuvre(self) -> bool:
        """Say whether the motion just changed and the fit is still young or in doubt."""
        return len(self._waiting) >= 2 or self._n_since_manoeuvre <= 2

    def smooth(self) -> Array:
        """Return the mean (d,) of the last five sightings. Source: APEX, five-frame window."""
        result: Array = np.array([s.x for s in self._recent]).sum(axis=0) / len(self._recent)
        return result

    def clear(self) -> None:
        """Forget every sighting."""
        self._window, self._waiting, self._fit = [], [], None
        self._recent.clear()
        self._noise.clear()
        self._innovations.clear()
        self._shown_sd, self._distrust, self._known_acc = 0.0, 1.0, None
        self._n_since_manoeuvre = 1 << 30

    def add(self, t_s: float, x: Array, sd: float) -> None:
        """Take a sighting at capture time ``t_s``; one not newer than the last is ignored."""
        if not t_s - self.last_t_s > _LEAST_STEP_S or not np.all(np.isfinite(x)):
            return
        if t_s - self.last_t_s > self._rules.max_gap_s:
            self.clear()
        sample = Sample(t_s, np.asarray(x, dtype=np.float64), sd)
        self._note_innovation(sample)
        self._note_noise(sample)
        self._recent.append(sample)
        self._n_since_manoeuvre += 1
        if self._fit is None or self._is_inside(sample):
            first = 1 if self._is_borrowed else 0
            self._window = (self._window[first:] + [sample])[-self._rules.window :]
            self._waiting, self._is_borrowed = [], False
        else:
            self._waiting.append(sample)
            self._try_restart()
        self._refit()
        self._state = None

    def predict(self, t_s: float) -> Motion:
        """Return the state at ``t_s``, its covariance growing since the last sighting.

        Raises
        ------
        ValueError : nothing was seen yet.
        """
        if self._fit is None:
            raise ValueError("no sighting to predict from")
        if self._state is None or self._state_t_s != t_s:
            self._state, self._state_t_s = self._state_at(t_s, self._fit), t_s
        return self._state

    def _state_at(self, t_s: float, fit: Fit) -> Motion:
        # Plain floats where arrays are tiny: this runs a few times per object and frame, and a
        # numpy call costs more than the sums in it.
        rules, dim = self._rules, fit.beta.shape[1]
        position, velocity, (unit_x, unit_xv, unit_v) = at(fit, t_s - fit.t_s)
        unseen = max(0.0, t_s - self.last_t_s)
        off_x, off_v = self._unseen_curve(fit, velocity, t_s - fit.t_s)
        new_x, new_xv, new_v = self._unseen_change(unseen)
        var_v = off_v**2 + _SCALE_SD**2 * float(velocity @ velocity) + self._onset_sd() ** 2
        cov = np.zeros((2 * dim, 2 * dim))
        is_young = len(self._window) < rules.min_samples
        for axis, noise in enumerate(fit.noise_var.tolist()):
            other = dim + axis
            cov[axis, axis] = self._distrust * (unit_x * noise + off_x**2) + new_x
            if is_young:
                cov[other, other] = rules.speed_sd**2
            else:
                both = self._distrust * (unit_xv * noise + off_x * off_v) + new_xv
                cov[axis, other] = cov[other, axis] = both
                cov[other, other] = self._distrust * (unit_v * noise + var_v) + new_v
        if is_young:
            velocity = np.zeros(dim)
        return Motion(position, velocity, fit.acc, cov)

    def noise_sd(self, sd: float) -> float:
        """Return the noise (one axis) that a sighting stated with ``sd`` is believed to have."""
        return math.sqrt(self._distrust) * self._shown(sd)

    def _shown(self, sd: float) -> float:
        """Return the noise that the track has shown, within reason of what is stated."""
        if self._shown_sd <= 0.0:
            return sd
        return min(max(self._shown_sd, _LEAST_NOISE * sd), _MAX_NOISE_RATIO * sd)

    def _unseen_change(self, unseen_s: float) -> Tuple[float, float, float]:
        """Return the variances of x, x with v, and v that a change of motion may have made.

        Since the last sighting one may have begun, at any time, with a chance that grows with the
        time; and sightings outside the gate say that one has.
        """
        chance = self._rules.acc_sd**2 * min(1.0, unseen_s / _CHANGE_S)
        var_x, var_xv = chance * unseen_s**4 / 20.0, chance * unseen_s**3 / 8.0
        var_v = chance * unseen_s**2 / 3.0
        gap2, since_s = self._doubt()
        if since_s > 0.0:
            # the miss grew since the last sighting inside, and goes on growing
            rate2 = gap2 / since_s**2
            var_x += gap2 + rate2 * unseen_s**2 + 2.0 * gap2 / since_s * unseen_s
            var_xv += gap2 / since_s + rate2 * unseen_s
            var_v += rate2
        return var_x, var_xv, var_v

    def _onset_sd(self) -> float:
        """Return the sd of the speed that motion begun within the last frames leaves."""
        samples = self._window
        span = samples[-1].t_s - samples[0].t_s
        noise = math.sqrt(self._shown(samples[-1].sd) * samples[-1].sd)
        return _ONSET * noise * (len(samples) - 1) / span if span > 0.0 else 0.0

    def _doubt(self) -> Tuple[float, float]:
        """Return the mean square by which the newest miss is off, and for how long already."""
        if not self._waiting or self._fit is None:
            return 0.0, 0.0
        newest = self._waiting[-1]
        gap = newest.x - at(self._fit, newest.t_s - self._fit.t_s)[0]
        share = 1.0 if len(self._waiting) >= 2 else _LONE_DOUBT
        return share * float(gap @ gap) / len(gap), newest.t_s - self._fit.t_s

    def _unseen_curve(self, fit: Fit, velocity: Array, ahead_s: float) -> Tuple[float, float]:
        """Return the sd of x and of v that a curvature too weak to be noticed leaves.

        ``ahead_s`` after the newest sample. A line over T seconds with an acceleration of one sd
        of what could have been measured is off by a T / 2 in speed at its end. An object at rest
        has none: friction needs motion.
        """
        n, dim = len(self._window), len(velocity)
        span = self._window[-1].t_s - self._window[0].t_s
        noise = float(fit.noise_var.sum()) / dim
        most = max(self._rules.acc_sd, self._rules.curve_sd) if n >= 4 else self._rules.curve_sd
        if fit.order != LINE or fit.held_acc.any() or n < 3 or span <= 0.0:
            return 0.0, 0.0
        if float(velocity @ velocity) <= 9.0 * dim * noise * float(fit.unit_cov[1, 1]):
            return 0.0, 0.0
        acc = min(most, _UNNOTICED * math.sqrt(noise / n) / span**2)
        ahead_s = max(ahead_s, 0.0)
        off_x = span * span / 12.0 + 0.5 * span * ahead_s + 0.5 * ahead_s * ahead_s
        return acc * off_x, acc * (0.5 * span + ahead_s)

    def _noise_sd(self, stated: Array) -> Array:
        """Return the noise (n,) of sightings: what the track has shown, near what is stated."""
        if self._shown_sd <= 0.0:
            return stated
        # The shown sd is itself off by a quarter: believe less noise only where it is clearly less.
        shown = np.maximum(self._shown_sd, np.minimum(stated, _NOISE_MARGIN * self._shown_sd))
        result: Array = np.clip(shown, _MIN_NOISE_RATIO * stated, _MAX_NOISE_RATIO * stated)
        return result

    def _note_noise(self, sample: Sample) -> None:
        """Keep how far the newest sighting lies off the parabola through the three before it."""
        if len(self._recent) < 3:
            return
        last = list(self._recent)[-3:]
        t = np.array([s.t_s - sample.t_s for s in last])
        weights = np.array(
            [
                t[1] * t[2] / ((t[0] - t[1]) * (t[0] - t[2])),
                t[0] * t[2] / ((t[1] - t[0]) * (t[1] - t[2])),
                t[0] * t[1] / ((t[2] - t[0]) * (t[2] - t[1])),
            ]
        )
        miss = sample.x - weights @ np.array([s.x for s in last])
        scale = np.sqrt(1.0 + float(weights @ weights))
        self._noise.append(median(np.abs(miss).tolist()) / scale)
        if len(self._noise) >= _MIN_NOISE:
            # a bounce spoils three of them: while they are few the stated noise has a say
            n_stated = max(0, 2 * _MIN_NOISE - len(self._noise))
            shown2 = (median(self._noise) / 0.6745) ** 2 * len(self._noise)
            self._shown_sd = math.sqrt(
                (shown2 + n_stated * sample.sd**2) / (len(self._noise) + n_stated)
            )

    def _note_innovation(self, sample: Sample) -> None:
        """Hold a new sighting against what was predicted of it."""
        is_young = len(self._window) < self._rules.min_samples
        if self._fit is None or is_young or self._waiting:
            return  # a prediction in doubt says nothing of the fit
        state, dim = self.predict(sample.t_s), len(sample.x)
        miss = sample.x - state.x
        variance = np.diag(state.cov)[:dim] + self.noise_sd(sample.sd) ** 2
        share = self._distrust * float(np.mean(miss * miss / variance))
        self._innovations.append(min(share, _DISTRUST_CAP * self._distrust))
        n_prior = max(0, _DISTRUST_PRIOR - len(self._innovations) // 4)
        mean = (sum(self._innovations) + n_prior) / (len(self._innovations) + n_prior)
        self._distrust = min(max(mean, 1.0), _MAX_DISTRUST)

    def _is_inside(self, sample: Sample) -> bool:
        """Say whether a sighting is within the gate, as wide as the stated noise makes it."""
        state = self.predict(sample.t_s)
        dim = len(sample.x)
        fit = self._fit
        assert fit is not None
        unseen = max(0.0, sample.t_s - self.last_t_s)
        unit_x = at(fit, sample.t_s - fit.t_s)[2][0]
        off_x, _ = self._unseen_curve(fit, state.v, sample.t_s - fit.t_s)
        drift_x = 0.5 * self._rules.acc_sd * unseen * unseen
        noise = float(self._noise_sd(np.array(sample.sd)))
        variance = unit_x * fit.noise_var + off_x**2 + noise**2 + drift_x**2
        variance = variance + float(state.v @ state.v) * self._rules.stamp_sd_s**2
        miss = sample.x - state.x
        limit = self._rules.gate_sigma**2 * _GATE_SHARE.get(dim, 1.5)
        return bool(np.sum(miss * miss / variance) <= limit)

    def _try_restart(self) -> None:
        """Start anew from the newest sightings once they agree among themselves.

        Three on a line, of which the gate kept two or more out; one that it let in is given back as
        soon as there are three without it. Five on a parabola, where three are no line, or a
        doubtful one of what may be falling. Never four on a parabola: two before and two after a
        reversal lie on a perfect one, twice too fast.
        """
        newest, n_waiting = list(self._recent), len(self._waiting)
        if n_waiting < 2 or len(newest) < 3:
            return
        bend = self._disagreement(newest[-3:], LINE)
        doubtful = _PLAIN_LINE if self._rules.curve_sd > 0.0 else _POOR_LINE
        is_curve = len(newest) == PAPER_WINDOW and self._disagreement(newest, PARABOLA) <= 1.0
        if bend > doubtful and is_curve:
            self._restart(newest)
        elif n_waiting >= PAPER_WINDOW or bend <= _POOR_LINE:
            first, *rest = newest[-3:]
            if n_waiting == 2 and bend > _PLAIN_LINE:
                first = first._replace(sd=_BORROWED_SD * first.sd)  # rather before than after it
            self._restart([first, *rest])

    def _restart(self, samples: List[Sample]) -> None:
        self._is_borrowed = 3 == len(samples) > len(self._waiting)
        self._window, self._waiting = list(samples), []
        self._n_since_manoeuvre = 0

    def _disagreement(self, samples: List[Sample], order: int) -> float:
        """Return the misfit of a few sightings over what is taken for agreement."""
        fit = self._straightest(samples) if order == LINE else self._solve(samples, order)
        most = self._rules.gate_sigma**2 * _GATE_SHARE.get(fit.beta.shape[1], 1.5) * 0.6
        return fit.misfit / most

    def _refit(self) -> None:
        """Fit the window; while it does not hold together, drop what spoils it.

        That is one sample, where the rest agrees without it: the gate of a young track is wide
        enough for an outlier. Else it is the older half.
        """
        while True:
            fit = self._best_fit(self._window)
            if self._holds(fit) or len(self._window) <= 3:
                break
            if self._is_lone_outlier(fit):
                self._window = [s for i, s in enumerate(self._window) if i != fit.worst]
                continue
            if len(self._window) <= 4:
                break
            self._window = self._window[-max(4, len(self._window) // 2) :]
            self._n_since_manoeuvre = min(self._n_since_manoeuvre, 1)
        self._fit = fit
        self._note_acceleration(fit)

    def _holds(self, fit: Fit) -> bool:
        limit = 1.0 + _MISFIT_SIGMA * math.sqrt(2.0 / max(1, fit.dof))
        dim = fit.beta.shape[1]
        return fit.misfit <= limit * fit.dof and fit.lean <= _LEAN_SHARE * _CURVED.get(dim, 16.0)

    def _is_lone_outlier(self, fit: Fit) -> bool:
        """Say whether all samples but the worst, an old one, agree."""
        dof = fit.dof - fit.beta.shape[1]
        is_newest = fit.worst == len(self._window) - 1
        if dof <= 0 or is_newest or fit.gain < self._rules.gate_sigma**2:
            return False
        limit = 1.0 + _MISFIT_SIGMA * math.sqrt(2.0 / dof)
        return fit.misfit - fit.gain <= limit * dof

    def _best_fit(self, samples: List[Sample]) -> Fit:
        """Return the simplest fit that does: line, line under the known acceleration, parabola."""
        line = self._straightest(samples)
        needed = _CURVED.get(line.beta.shape[1], 16.0)
        if len(samples) < 4 or line.misfit <= needed:
            return line  # no curve can gain more than the whole misfit
        curve = self._solve(samples, PARABOLA)
        is_curved = line.misfit - curve.misfit > needed
        return curve if is_curved else line

    def _straightest(self, samples: List[Sample]) -> Fit:
        """Return a line, or while young one bent by the acceleration seen before a bounce."""
        line = self._solve(samples, LINE)
        if self._known_acc is None or not 3 <= len(samples) <= _MIN_CURVED:
            return line
        bent = self._solve(samples, LINE, self._known_acc)
        return bent if bent.misfit < line.misfit - _BENT else line

    def _note_acceleration(self, fit: Fit) -> None:
        """Remember what bends the path: gravity is the same after a bounce."""
        is_curved = fit.order == PARABOLA and len(self._window) >= _MIN_CURVED
        self._n_curved = self._n_curved + 1 if is_curved else 0
        if self._n_curved >= _SURE_CURVED:
            self._known_acc, self._n_straight = fit.acc, 0
        elif self._known_acc is not None and not fit.held_acc.any():
            self._n_straight += 1
            if self._n_straight >= _FORGET:
                self._known_acc = None

    def _solve(self, samples: List[Sample], order: int, held_acc: Optional[Array] = None) -> Fit:
        sd = self._noise_sd(np.array([sample.sd for sample in samples]))
        seen = points(samples, sd, self._rules.stamp_sd_s)
        return solve(seen, order, self._rules.speed_sd, held_acc)
