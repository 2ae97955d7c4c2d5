"""Clip and standardise columns, as every exported model does before its weights."""

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from apex_edge.types import Array

# Beyond 4 sd these say no more; unlimited they drown a linear model.
LIMITED = ("z", "reach", "z_pos", "reach_pos")
LIMIT_SD = 4.0
# Stands for "no limit" in a file that allows finite numbers only.
_FAR = 1e12


@dataclass(frozen=True)
class Scaler:
    """(clip(x, lo, hi) - mean) / scale, column by column; arrays (k,)."""

    lo: Array
    hi: Array
    mean: Array
    scale: Array

    def apply(self, values: Array) -> Array:
        """Return the standardised values (m, k)."""
        scaled: Array = (np.clip(values, self.lo, self.hi) - self.mean) / self.scale
        return scaled


def identity(n_columns: int) -> Scaler:
    """Return a scaler that leaves n columns as they are."""
    zero, one = np.zeros(n_columns), np.ones(n_columns)
    return Scaler(-_FAR * one, _FAR * one, zero, one)


def fitted(values: Array, names: Sequence[str]) -> Scaler:
    """Return the scaler of training values (m, k): their range, mean and sd after clipping.

    Columns named in ``LIMITED`` are clipped to ``LIMIT_SD``; a constant column keeps scale 1.
    """
    lo, hi = values.min(axis=0), values.max(axis=0)
    limited = np.array([name in LIMITED for name in names], dtype=bool)
    lo = np.where(limited, np.maximum(lo, -LIMIT_SD), lo)
    hi = np.where(limited, np.minimum(hi, LIMIT_SD), hi)
    hi = np.maximum(lo, hi)
    clipped = np.clip(values, lo, hi)
    spread = clipped.std(axis=0)
    return Scaler(lo, hi, clipped.mean(axis=0), np.where(spread > 0.0, spread, 1.0))
