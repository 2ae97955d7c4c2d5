"""Join what several sources say of one range; ours.

Weights are inverse variances. Sources that contradict each other are never averaged: the mean of
two places is a place where nothing is.
"""

import math
from typing import NamedTuple, Optional, Sequence

GATE_SIGMA = 4.0


class Estimate(NamedTuple):
    """One source's word: the object's centre is ``reach_m`` along the unit-depth ray."""

    reach_m: float
    sd_m: float
    radius_m: float

    @property
    def gate_m(self) -> float:
        """Return the largest error that this estimate's sd still explains."""
        return GATE_SIGMA * self.sd_m


def fuse(measured: Sequence[Estimate], assumed: Optional[Estimate] = None) -> Optional[Estimate]:
    """Return the weighted mean of all that agree, or None when nothing was said.

    The best measurement stands; another is averaged in when they agree within four sigma of both,
    and dropped when not. An assumption never overrules a measurement, however small its sd.
    The radius is that of the last in ``measured`` that agrees: give the one that knows it last.
    """
    ordered = sorted(measured, key=lambda estimate: estimate.sd_m)
    if not ordered:
        return assumed
    others = ordered[1:] + ([assumed] if assumed is not None else [])
    kept = [ordered[0]] + [other for other in others if _agree(ordered[0], other)]
    weights = [1.0 / estimate.sd_m**2 for estimate in kept]
    reach = sum(w * estimate.reach_m for w, estimate in zip(weights, kept)) / sum(weights)
    radius = [estimate.radius_m for estimate in measured if estimate in kept][-1]
    return Estimate(reach, math.sqrt(1.0 / sum(weights)), radius)


def _agree(one: Estimate, other: Estimate) -> bool:
    return abs(one.reach_m - other.reach_m) <= GATE_SIGMA * math.hypot(one.sd_m, other.sd_m)
