"""The graph trigger: a trained graph net over the star of each mover, in plain numpy.

Source: APEX section "Trigger" (motion attention over the difference graph); node and edge features,
certificate and fallback are ours.
"""

import logging
from pathlib import Path
from typing import Optional, Union

import numpy as np

from apex_edge.triggers.analytic import k_sigma_rule
from apex_edge.triggers.base import Evidence, Trigger, TriggerConfig, Verdict
from apex_edge.triggers.weights import SHIPPED_GRAPH, load_graph

logger = logging.getLogger(__name__)


class GraphTrigger(Trigger):
    """Judge pairs by a trained graph net; outside its domain by the k-sigma rule, flagged.

    Parameters
    ----------
    config : see TriggerConfig; None = defaults.
    weights_path : None = ``config.weights``, and if that is empty the shipped file.

    Raises
    ------
    WeightsError : the model file is damaged, or of another format or kind.
    """

    def __init__(
        self,
        config: Optional[TriggerConfig] = None,
        weights_path: Optional[Union[str, Path]] = None,
    ) -> None:
        super().__init__(config)
        self.weights_path = Path(weights_path or self.config.weights or SHIPPED_GRAPH)
        self.weights = load_graph(self.weights_path)
        gate = {key: getattr(self.config, key, None) for key in self.weights.gate}
        if gate != self.weights.gate:
            logger.warning(
                "%s: the recall was certified for %s, the settings say %s; it no longer holds",
                self.weights_path.name,
                self.weights.gate,
                gate,
            )

    def judge(self, evidence: Evidence) -> Verdict:
        """Apply the net to all stars of the frame; outside its domain the analytic rule."""
        model = self.weights
        features = model.feature_set.compute(evidence.pairs, evidence.approach, evidence.horizon_s)
        known = model.is_in_domain(features, evidence.pairs.radius_m, evidence.n_samples) & np.all(
            np.isfinite(features), axis=1
        )
        if abs(evidence.horizon_s - model.horizon_s) > 1e-6:
            known[:] = False
        logit = model.logit(features, evidence.pairs, evidence.mover_id)
        known &= np.isfinite(logit)
        rule = k_sigma_rule(evidence, self.config.k_sigma)
        return Verdict(
            probability=np.where(known, model.probability(logit), rule.probability),
            is_hit=np.where(known, logit >= model.threshold, rule.is_hit),
            is_fallback=~known,
        )
