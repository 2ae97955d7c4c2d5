"""The vote over frames: a pair fires when the judgement said hit in n of the last m frames.

Source: APEX section "Trigger"; the vote is ours.
"""

from typing import Dict, Tuple

import numpy as np

from apex_edge.types import Array

# Above, it pays to look first which pairs the vote has to do with: 60 us against 0.7 us a pair.
_MANY_PAIRS = 100


class Persistence:
    """n-of-m vote per pair of tracks; a pair that left the graph starts anew."""

    def __init__(self, n_hits: int, n_frames: int) -> None:
        self._n_hits = n_hits
        self._mask = (1 << n_frames) - 1
        self._history: Dict[Tuple[int, int], int] = {}

    def reset(self) -> None:
        """Forget all pairs."""
        self._history = {}

    def update(self, ids: Array, is_hit: Array) -> Array:
        """Take in one frame, ``ids (m, 2)`` and ``is_hit (m,)``; return who fires (m,)."""
        is_fired = np.zeros(len(ids), dtype=bool)
        history: Dict[Tuple[int, int], int] = {}
        if not self._history and not is_hit.any():
            return is_fired
        # Few of the 1225 pairs of 50 objects have a hit or a past; the loop is for those.
        rows = np.arange(len(ids))
        if len(ids) > _MANY_PAIRS:
            past_ids = np.array(list(self._history), dtype=np.int64).reshape(-1, 2)
            rows = np.flatnonzero(is_hit | np.isin(_pair_keys(ids), _pair_keys(past_ids)))
        for row, (first, second) in zip(rows.tolist(), np.sort(ids[rows], axis=1).tolist()):
            past = self._history.get((first, second), 0)
            bits = ((past << 1) | int(is_hit[row])) & self._mask
            if bits:
                history[(first, second)] = bits
                is_fired[row] = bin(bits).count("1") >= self._n_hits
        self._history = history
        return is_fired


def _pair_keys(ids: Array) -> Array:
    """Return one number (m,) per pair ``ids (m, 2)``, the same either way round.

    Two pairs may share one when a track id is above 2^31: a key finds rows, it does not name them.
    """
    keys: Array = (np.minimum(ids[:, 0], ids[:, 1]) << 32) + np.maximum(ids[:, 0], ids[:, 1])
    return keys
