"""The linear trigger: logistic regression on 12 pair features, weights trained off the device.

Source: APEX section "Limitations" (a lightweight linear classifier stands in for the graph network
where PyTorch cannot be installed); features, certificate and fallback are ours.
"""

import logging
from pathlib import Path
from typing import Optional, Union

import numpy as np

from apex_edge.triggers.analytic import k_sigma_rule
from apex_edge.triggers.base import Evidence, Trigger, TriggerConfig, Verdict
from apex_edge.triggers.features import edge_features
from apex_edge.triggers.weights import SHIPPED, load_linear

logger = logging.getLogger(__name__)


class LinearTrigger(Trigger):
    """Judge pairs by exported weights; outside their domain by the k-sigma rule, flagged.

    Parameters
    ----------
    config : see TriggerConfig; None = defaults.
    weights_path : None = ``config.weights``, and if that is empty the shipped file.

    Raises
    ------
    WeightsError : the weights file is damaged or of another format.
    """

    def __init__(
        self,
        config: Optional[TriggerConfig] = None,
        weights_path: Optional[Union[str, Path]] = None,
    ) -> None:
        super().__init__(config)
        self.weights_path = Path(weights_path or self.config.weights or SHIPPED)
        self.weights = load_linear(self.weights_path)
        gate = {key: getattr(self.config, key, None) for key in self.weights.gate}
        if gate != self.weights.gate:
            logger.warning(
                "%s: the recall was certified for %s, the settings say %s; it no longer holds",
                self.weights_path.name,
                self.weights.gate,
                gate,
            )

    def judge(self, evidence: Evidence) -> Verdict:
        """Apply the weights, and the analytic rule where they do not reach."""
        features = edge_features(evidence.pairs, evidence.approach, evidence.horizon_s)
        known = self.weights.is_in_domain(
            features, evidence.pairs.radius_m, evidence.n_samples
        ) & np.all(np.isfinite(features), axis=1)
        if abs(evidence.horizon_s - self.weights.horizon_s) > 1e-6:
            known[:] = False
        logit = self.weights.logit(features)
        rule = k_sigma_rule(evidence, self.config.k_sigma)
        probability = self.weights.probability(logit)
        return Verdict(
            probability=np.where(known, probability, rule.probability),
            is_hit=np.where(known, logit >= self.weights.threshold, rule.is_hit),
            is_fallback=~known,
        )
