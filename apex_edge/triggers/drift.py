"""Notice that what is seen has left what a model was trained on.

A certificate of recall holds for scenes like those of the training. The ranges of the model's
domain leave out one training value in a thousand at either end, so a pair outside them is seldom
chance; but frames of one approach are alike, and one odd throw is no drift. The alarm therefore
needs a share of the pairs judged over a sliding window of capture time, and ends below half that
share.
Source: ours.
"""

import logging
from collections import deque
from typing import Deque, NamedTuple, Tuple

logger = logging.getLogger(__name__)


class DriftRules(NamedTuple):
    """``window_s`` looked back; ``min_pairs`` in it before it says anything; ``share`` outside."""

    window_s: float
    min_pairs: int
    share: float


class DriftMonitor:
    """Count how many judged pairs lie outside the model's domain; ``update`` once per frame."""

    def __init__(self, rules: DriftRules, model_name: str) -> None:
        self._rules = rules
        self._model_name = model_name
        self._is_drifting = False
        self._frames: Deque[Tuple[float, int, int]] = deque()
        self._n_pairs = 0
        self._n_outside = 0

    @property
    def is_drifting(self) -> bool:
        """Say whether the alarm is on."""
        return self._is_drifting

    def reset(self) -> None:
        """Forget what was counted; the alarm is off."""
        self._is_drifting = False
        self._forget()

    def update(self, t_s: float, n_pairs: int, n_outside: int) -> bool:
        """Take in the pairs judged in one frame at capture time ``t_s``; return ``is_drifting``.

        A clock that steps back starts the count anew; the alarm stays as it is.
        """
        if self._frames and t_s < self._frames[-1][0]:
            self._forget()
        if n_pairs:
            self._frames.append((t_s, n_pairs, n_outside))
            self._n_pairs += n_pairs
            self._n_outside += n_outside
        while self._frames and self._frames[0][0] < t_s - self._rules.window_s:
            _, n_old, n_old_outside = self._frames.popleft()
            self._n_pairs -= n_old
            self._n_outside -= n_old_outside
        if self._n_pairs >= self._rules.min_pairs:
            self._decide(self._n_outside / self._n_pairs)
        return self._is_drifting

    def _forget(self) -> None:
        self._frames.clear()
        self._n_pairs = self._n_outside = 0

    def _decide(self, share: float) -> None:
        limit = self._rules.share
        if not self._is_drifting and share > limit:
            self._is_drifting = True
            logger.warning(
                "%s: %.0f %% of the %d pairs of the last %g s are unlike the training set; "
                "the analytic rule judges until fewer than %.1f %% are",
                *(self._model_name, 100.0 * share, self._n_pairs, self._rules.window_s),
                50.0 * limit,
            )
        elif self._is_drifting and share < 0.5 * limit:
            self._is_drifting = False
            logger.warning(
                "%s: only %.1f %% of the last pairs are unlike the training set; "
                "the model judges again",
                self._model_name,
                100.0 * share,
            )
