"""Listen to what the tracker's motion estimators are told and what they had expected.

The innovations that say whether a covariance is honest must be those of the tracker itself, with
the noise it gave each sighting. So its estimators are replaced, for a while, by ones that also
take notes.
"""

from contextlib import contextmanager
from dataclasses import dataclass
from typing import Iterator, List, Optional

import numpy as np

from apex_edge.perception import tracking
from apex_edge.perception.estimator import Motion, MotionRules
from apex_edge.perception.motion import MotionEstimator
from apex_edge.types import Array


@dataclass(frozen=True)
class Note:
    """One sighting ``x (d,)`` at ``t_s`` taken by estimator ``source``.

    ``expected`` is the state predicted for it, None for the first one, from ``n_before`` of them;
    ``noise_sd`` what the estimator takes for the noise of this sighting; ``after`` the state then.
    """

    source: int
    t_s: float
    x: Array
    noise_sd: float
    n_before: int
    expected: Optional[Motion]
    after: Motion


@contextmanager
def listening() -> Iterator[List[Note]]:
    """Give a list that fills with a note per sighting of every tracker made meanwhile."""
    notes: List[Note] = []
    n_made = [0]

    class NotingEstimator(MotionEstimator):
        """The tracker's estimator, taking notes."""

        def __init__(self, rules: MotionRules) -> None:
            super().__init__(rules)
            self._number = n_made[0]
            self._max_gap_s = rules.max_gap_s
            n_made[0] += 1

        def add(self, t_s: float, x: Array, sd: float) -> None:
            is_new = t_s > self.last_t_s
            is_fresh = not self.n_samples or t_s - self.last_t_s > self._max_gap_s
            expected = None if is_fresh or not is_new else self.predict(t_s)
            noise_sd = self.noise_sd(sd)
            n_before = self.n_samples
            super().add(t_s, x, sd)
            if is_new:
                where = np.array(x, dtype=np.float64)
                after = self.predict(t_s)
                notes.append(Note(self._number, t_s, where, noise_sd, n_before, expected, after))

    original = tracking.MotionEstimator
    tracking.MotionEstimator = NotingEstimator  # type: ignore[misc]
    try:
        yield notes
    finally:
        tracking.MotionEstimator = original  # type: ignore[misc]
