"""What all trained triggers share: the model's domain, the fallback outside it, the drift alarm.

A trained model speaks only for what its training covered. Elsewhere, and everywhere while the
drift alarm is on, the analytic k-sigma rule judges, flagged.
Source: ours.
"""

import logging
from abc import abstractmethod

import numpy as np

from apex_edge.triggers.analytic import k_sigma_rule
from apex_edge.triggers.base import Evidence, Trigger, TriggerConfig, Verdict
from apex_edge.triggers.drift import DriftMonitor, DriftRules
from apex_edge.triggers.feature_sets import model_features
from apex_edge.triggers.models import TriggerModel
from apex_edge.types import Array, DifferenceGraph, HazardScores

logger = logging.getLogger(__name__)

_SAME_S = 1e-6


class LearntTrigger(Trigger):
    """Judge pairs by a trained model where it reaches, and by the k-sigma rule where not.

    Parameters
    ----------
    config : see TriggerConfig.
    model : the checked model.
    name : of its file, for the log.
    """

    def __init__(self, config: TriggerConfig, model: TriggerModel, name: str) -> None:
        super().__init__(config, model.feature_set.windows)
        self._model = model
        self._t_s = -np.inf
        rules = DriftRules(config.drift_window_s, config.drift_min_pairs, config.drift_share)
        self._drift = DriftMonitor(rules, name)
        gate = {key: getattr(config, key, None) for key in model.gate}
        if gate != model.gate:
            logger.warning(
                "%s: the recall was certified for %s, the settings say %s; it no longer holds",
                name,
                model.gate,
                gate,
            )

    @property
    def is_drifting(self) -> bool:
        """Say whether so many pairs are unlike the training set that the rule judges them all."""
        return self._drift.is_drifting

    def reset(self) -> None:
        """Forget earlier frames, as at start-up."""
        super().reset()
        self._drift.reset()

    def score(self, diff: DifferenceGraph, horizon_s: float) -> HazardScores:
        """Score the edges of ``diff.graph``; call once per frame, in order."""
        self._t_s = diff.t_s
        return super().score(diff, horizon_s)

    @abstractmethod
    def logit(self, evidence: Evidence, features: Array) -> Array:
        """Return the model's logit (m,) of m pairs and their features (m, k)."""

    def judge(self, evidence: Evidence) -> Verdict:
        """Apply the model, and the analytic rule where it does not reach."""
        model = self._model
        features = model_features(model.feature_set.name, evidence)
        known = self._is_known(evidence, features)
        rule = k_sigma_rule(evidence, self.config.k_sigma)
        if not known.any():
            return Verdict(rule.probability, rule.is_hit, ~known)
        # Rows with a NaN go through the net too; what comes out of them, or of those that share
        # a star with them, is not used.
        with np.errstate(invalid="ignore", over="ignore"):
            logit = self.logit(evidence, features)
        known = known & np.isfinite(logit)
        return Verdict(
            probability=np.where(known, model.probability(logit), rule.probability),
            is_hit=np.where(known, logit >= model.threshold, rule.is_hit),
            is_fallback=~known,
        )

    def _is_known(self, evidence: Evidence, features: Array) -> Array:
        """Say which pairs (m,) the model may judge, and count those unlike its training set.

        A track too young for the shortest window is no drift, nor is another horizon.
        """
        model = self._model
        is_old = evidence.n_samples >= model.min_samples
        known: Array = model.is_in_domain(
            features, evidence.pairs.radius_m, evidence.n_samples
        ) & np.isfinite(features).all(axis=1)
        if abs(evidence.horizon_s - model.horizon_s) > _SAME_S:
            return np.zeros(len(known), dtype=bool)
        n_judged = int(np.count_nonzero(is_old))
        n_outside = n_judged - int(np.count_nonzero(is_old & known))
        if self._drift.update(self._t_s, n_judged, n_outside):
            return np.zeros(len(known), dtype=bool)
        return known
