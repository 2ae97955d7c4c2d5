"""The k-sigma rule: fire when the closest approach lies within the radius plus k sd of the miss.

It needs no training and is what the linear trigger falls back to outside its domain. A bare
probability would fall as the noise grows (dilution) and silence the alarm; the k-sigma test fails
toward firing instead. Source: ours; conjunction assessment uses the same pair of measures.
"""

import math

import numpy as np

from apex_edge.triggers.base import Evidence, Trigger, Verdict
from apex_edge.triggers.features import SD_FLOOR_M, reach_sds
from apex_edge.types import Array


class AnalyticTrigger(Trigger):
    """Judge pairs by closest approach alone."""

    def judge(self, evidence: Evidence) -> Verdict:
        """Apply the k-sigma rule."""
        return k_sigma_rule(evidence, self.config.k_sigma)


def k_sigma_rule(evidence: Evidence, k_sigma: float) -> Verdict:
    """Judge pairs by z = (radius - closest approach) / sd >= -k.

    The probability is the normal mass inside the combined radius at the closest approach, times
    that of getting there within the horizon.
    """
    dca, radius = evidence.approach.dca_m, evidence.pairs.radius_m
    sigma = np.maximum(evidence.approach.miss_sd_m, SD_FLOOR_M)
    inside = _normal_cdf((radius - dca) / sigma) - _normal_cdf((-radius - dca) / sigma)
    probability = inside * _normal_cdf(reach_sds(evidence.pairs, evidence.approach))
    is_hit = dca - radius <= k_sigma * sigma
    return Verdict(probability, is_hit, np.zeros(len(dca), dtype=bool))


def _normal_cdf(x: Array) -> Array:
    return np.array([0.5 * math.erfc(-value / math.sqrt(2.0)) for value in x.tolist()])
