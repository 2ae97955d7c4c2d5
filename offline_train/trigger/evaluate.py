"""Metrics on held-out scenes, with the speed-only and the analytic rule beside the model."""

from dataclasses import dataclass
from typing import Any, Dict, Tuple

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.types import Array
from offline_train.trigger.calibrate import event_scores, voted
from offline_train.trigger.fit import ROWS_PER_PAIR, LinearFit, sklearn_module, thin
from offline_train.trigger.observe import Observed

_N_BINS = 15


@dataclass(frozen=True)
class Model:
    """What is tested: a fit, its threshold (a logit), gate and vote, and the lead of an event."""

    fit: LinearFit
    threshold: float
    config: TriggerConfig
    lead_s: float


def evaluate(scenes: Observed, contacts: Observed, model: Model) -> Dict[str, Any]:
    """Return metrics by rule: "linear", "analytic" and "speed", all behind the same gate and vote.

    Frame figures are over a few frames per scene that pass the gate: ``pr_auc``, ``roc_auc``,
    ``fpr_at_recall_*``, ``ece``, ``brier``. Event figures: ``recall`` of the eligible events
    of ``contacts`` at least ``lead_s`` ahead; ``negative_frames`` share of all frames of ``scenes``
    without contact within the horizon that fire; ``false_scenes`` share of scenes without any
    contact that fire at all. The speed rule fires at the speed with the linear model's recall.
    """
    logit, early = (model.fit.logit(seen.features) for seen in (scenes, contacts))
    goal = _recall(contacts, (early, model.threshold), model)
    fast = np.sort(event_scores(contacts, contacts.speed_m_s, model.config, model.lead_s))
    equal = float(fast[int(round((1.0 - goal) * len(fast)))])
    cut = {"linear": model.threshold, "analytic": -model.config.k_sigma, "speed": equal}
    score = {"linear": logit, "analytic": _z(scenes), "speed": scenes.speed_m_s}
    on_contacts = {"linear": early, "analytic": _z(contacts), "speed": contacts.speed_m_s}
    rows = thin(scenes.pair, ROWS_PER_PAIR, 0)
    label = scenes.label[rows]
    report: Dict[str, Any] = {}
    for name in cut:
        report[name] = _frames(label, score[name][rows])
        report[name]["recall"] = _recall(contacts, (on_contacts[name], cut[name]), model)
        report[name].update(_false_alarms(scenes, (score[name], cut[name]), model))
    said = {"linear": 1.0 / (1.0 + np.exp(-logit)), "analytic": scenes.rule_probability}
    for name, probability in said.items():
        report[name]["ece"] = calibration_error(label, probability[rows])
        report[name]["brier"] = float(np.mean((probability[rows] - label) ** 2))
    report["n_events"] = len(fast)
    return report


def calibration_error(label: Array, probability: Array) -> float:
    """Return the expected calibration error over 15 equal bins."""
    bins = np.minimum((probability * _N_BINS).astype(int), _N_BINS - 1)
    gap = np.bincount(bins, weights=probability - label, minlength=_N_BINS)
    return float(np.abs(gap).sum() / len(label))


def _frames(label: Array, score: Array) -> Dict[str, float]:
    metrics = sklearn_module("sklearn.metrics")
    positive = np.sort(score[label])
    found = {
        "pr_auc": float(metrics.average_precision_score(label, score)),
        "roc_auc": float(metrics.roc_auc_score(label, score)),
    }
    for recall in (0.90, 0.95, 0.99):
        cut = positive[int((1.0 - recall) * len(positive))]
        found[f"fpr_at_recall_{recall:.2f}"] = float(np.mean(score[~label] >= cut))
    return found


def _z(seen: Observed) -> Array:
    z: Array = seen.features[:, FEATURE_NAMES.index("z")]
    return z


def _recall(contacts: Observed, rule: Tuple[Array, float], model: Model) -> float:
    scores = event_scores(contacts, rule[0], model.config, model.lead_s)
    return float(np.mean(scores >= rule[1]))


def _false_alarms(seen: Observed, rule: Tuple[Array, float], model: Model) -> Dict[str, float]:
    fires = voted(seen, rule[0], model.config) >= rule[1]
    time = np.arange(fires.shape[1]) * seen.frame_s[:, None]
    is_negative = seen.is_judged & ~(seen.contact_s[:, None] - time <= seen.horizon_s[:, None])
    is_harmless = ~np.isfinite(seen.contact_s)
    return {
        "negative_frames": float(fires[is_negative].mean()),
        "false_scenes": float(fires[is_harmless].any(axis=1).mean()),
    }
