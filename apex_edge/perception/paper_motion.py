"""The paper's own smoothing, to compare with: means of five frames, as its text and code have it.

The position is the mean of the last five sightings, two frames late and never brought forward; the
speed the difference between that mean and the one of the five before, over five frame periods. It
needs ten sightings. Source: APEX appendix D, "five-frame sliding window", and its released code;
the stated covariance is ours and counts the known lag as error.
"""

from collections import deque
from typing import Deque

import numpy as np

from apex_edge.perception.estimator import PAPER_WINDOW, Estimator, Motion, MotionRules
from apex_edge.perception.fitting import Sample
from apex_edge.types import Array


class PaperMotion(Estimator):
    """Two windows of five frames."""

    def __init__(self, rules: MotionRules) -> None:
        """Start with no sighting."""
        self._rules = rules
        self._seen: Deque[Sample] = deque(maxlen=2 * PAPER_WINDOW)

    @property
    def n_samples(self) -> int:
        """Return the number of sightings kept, ten at most."""
        return len(self._seen)

    @property
    def is_manoeuvre(self) -> bool:
        """Never say so: the paper does not look for it."""
        return False

    def add(self, t_s: float, x: Array, sd: float) -> None:
        """Take a sighting; a gap clears what was before (the paper's code mixes both sides)."""
        last_s = self._seen[-1].t_s if self._seen else t_s
        if (self._seen and not t_s > last_s) or not np.all(np.isfinite(x)):
            return
        if t_s - last_s > self._rules.max_gap_s:
            self._seen.clear()
        self._seen.append(Sample(t_s, np.asarray(x, dtype=np.float64), sd))

    def predict(self, t_s: float) -> Motion:
        """Return the mean of the last five, whatever ``t_s`` is."""
        if not self._seen:
            raise ValueError("no sighting to predict from")
        seen = list(self._seen)
        newer, older = seen[-PAPER_WINDOW:], seen[:-PAPER_WINDOW]
        x, dim, n = self.smooth(), len(seen[0].x), len(newer)
        noise_var = sum(s.sd**2 for s in newer) / n**2
        velocity, speed_var = np.zeros(dim), self._rules.speed_sd**2
        if len(older) == PAPER_WINDOW:
            step_s = (sum(s.t_s for s in newer) - sum(s.t_s for s in older)) / PAPER_WINDOW
            velocity = (x - sum(s.x for s in older) / PAPER_WINDOW) / step_s
            speed_var = 2.0 * noise_var / step_s**2
        lag_s = t_s - sum(s.t_s for s in newer) / n
        late_var = lag_s**2 * (velocity**2 + speed_var)
        cov = np.diag(np.concatenate([noise_var + late_var, np.full(dim, speed_var)]))
        return Motion(x, velocity, np.zeros(dim), cov)

    def smooth(self) -> Array:
        """Return the mean (d,) of the last five sightings."""
        newer = list(self._seen)[-PAPER_WINDOW:]
        result: Array = np.array([s.x for s in newer]).sum(axis=0) / len(newer)
        return result
