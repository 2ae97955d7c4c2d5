"""Distillation: a small model learns what a large one, or the simulated truth, says of each pair.

The student is fitted with soft cross-entropy, so it takes over the teacher's doubt and its
probability still means what it says. It goes both ways: a graph model can teach the linear one,
and the linear one can label data for a graph model. Source: ours; the paper names the two models
and not how one could become the other.
"""

import numpy as np

from apex_edge.errors import ApexError
from apex_edge.types import Array


def soft_target(teacher: Array, truth: Array, mix_truth: float) -> Array:
    """Return what the student is to say (r,): the teacher's probability mixed with the truth.

    Parameters
    ----------
    teacher : (r,) probability in [0, 1].
    truth : (r,) bool, or a probability.
    mix_truth : share of the truth; 0 = the teacher alone, 1 = the truth alone.

    Raises
    ------
    ApexError : a share or a probability outside [0, 1], or arrays of unequal length.
    """
    if not 0.0 <= mix_truth <= 1.0:
        raise ApexError(f"share of truth {mix_truth}: must lie between 0 and 1")
    if len(teacher) != len(truth):
        raise ApexError(f"{len(teacher)} rows have a teacher but {len(truth)} a truth")
    target: Array = (1.0 - mix_truth) * teacher + mix_truth * truth.astype(np.float64)
    if not np.all((target >= 0.0) & (target <= 1.0)):
        raise ApexError("the teacher must give probabilities between 0 and 1")
    return target
