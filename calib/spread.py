"""How far values lie apart: the same few sums for every calibration. Source: textbook."""

import numpy as np

from apex_edge.types import Array


def rms(values: Array) -> float:
    """Return the root of the mean square over all values; NaN when there are none."""
    return float(np.sqrt(np.mean(np.square(values)))) if np.size(values) else float("nan")


def rms_length(vectors: Array) -> float:
    """Return the root of the mean squared length of vectors (n, k)."""
    return rms(np.linalg.norm(vectors, axis=-1))


def jackknife_sd(found: Array) -> Array:
    """Return the sd (...) of a result from those with one part of the data left out (n, ...)."""
    values = np.asarray(found, dtype=np.float64)
    result: Array = np.sqrt((len(values) - 1.0) * np.var(values, axis=0))
    return result
