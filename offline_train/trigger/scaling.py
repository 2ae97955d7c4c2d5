"""Find the clip and scale of columns, which every exported model applies before its weights."""

from typing import Sequence, Tuple

import numpy as np

from apex_edge.triggers.models import Columns
from apex_edge.types import Array

# Beyond 4 sd these say no more; unlimited they drown a linear model.
LIMITED = ("z", "reach", "z_pos", "reach_pos")
LIMIT_SD = 4.0
_OUTLIERS = 0.001
# Stands for "no limit" in a file that allows finite numbers only.
_FAR = 1e12


def identity(n_columns: int) -> Columns:
    """Return what leaves n columns as they are."""
    zero, one = np.zeros(n_columns), np.ones(n_columns)
    return Columns(-_FAR * one, _FAR * one, zero, one)


def spread(values: Array) -> Tuple[Array, Array]:
    """Return the range (k,), (k,) of the columns of training values (m, k).

    All but one value in a thousand at either end: a lone outlier is no ground a model knows.
    """
    low, high = np.quantile(values, [_OUTLIERS, 1.0 - _OUTLIERS], axis=0)
    return low, high


def fitted(values: Array, names: Sequence[str], limit_sd: float = LIMIT_SD) -> Columns:
    """Return the clip and scale of training values (m, k): range, and mean and sd after clipping.

    Columns named in ``LIMITED`` are clipped to ``limit_sd``; a constant column keeps scale 1.
    """
    lo, hi = values.min(axis=0), values.max(axis=0)
    limited = np.array([name in LIMITED for name in names], dtype=bool)
    lo = np.where(limited, np.maximum(lo, -limit_sd), lo)
    hi = np.where(limited, np.minimum(hi, limit_sd), hi)
    hi = np.maximum(lo, hi)
    columns = Columns(lo, hi, np.zeros(len(lo)), np.ones(len(lo)))
    clipped = columns.clipped(values)
    spread = clipped.std(axis=0)
    return Columns(lo, hi, clipped.mean(axis=0), np.where(spread > 0.0, spread, 1.0))
