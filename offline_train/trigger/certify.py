"""Certify the threshold of a model document on events it has not seen; nothing else changes.

``apex train calibrate`` uses it on generated data, ``apex train recalibrate`` on recordings of the
user's own rig. Gate and vote are those of the document. Source: ours.
"""

from dataclasses import replace
from typing import Any, Dict, Mapping

import numpy as np

from apex_edge.errors import WeightsError
from apex_edge.triggers import model_file
from apex_edge.triggers.base import TriggerConfig
from offline_train.trigger.calibrate import (
    Promise,
    TooFewEventsError,
    calibrate,
    certified_rank,
    event_scores,
    smallest_alpha,
)
from offline_train.trigger.export import certificate
from offline_train.trigger.observe import Observed
from offline_train.trigger.scoring import RULE_SURE, device_scorer

_MOST_EVENTS = 100000


def certify(
    fields: Mapping[str, Any], seen: Observed, promise: Promise, origin: Mapping[str, Any]
) -> Dict[str, Any]:
    """Return the fields with a threshold certified on ``seen``, signed anew.

    ``origin`` says what ``seen`` is and goes into the provenance, under ``certified_on``. Figures
    that a document holds from an earlier threshold are kept under that name.

    Raises
    ------
    TooFewEventsError : fewer events than the promise needs (the message says how many), or too
        many that the model never announces, or that are all outside its domain.
    WeightsError : the fields make no model, or rows are judged for another horizon.
    """
    config = gate_of(fields)
    score = device_scorer(fields)(seen)
    n_events = len(event_scores(seen, score, config, promise.lead_s))
    needed = events_needed(promise)
    if n_events < needed:
        raise TooFewEventsError(
            f"{n_events} events (contacts whose mover was in plain view long enough before) "
            f"cannot certify a recall of {1.0 - promise.alpha:.3f} at {promise.confidence:.0%} "
            f"confidence: {needed} are needed; with {n_events} at best --alpha "
            f"{_best_alpha(n_events, promise):.3f}"
        )
    threshold = calibrate(seen, score, config, promise)
    if abs(threshold.logit) >= RULE_SURE:
        size = np.abs(event_scores(seen, score, config, promise.lead_s))
        n_rule = int(np.sum((size >= RULE_SURE) & np.isfinite(size)))
        raise TooFewEventsError(
            f"{n_rule} of {n_events} events are outside the model's domain, where the k-sigma rule "
            "decides: no threshold can be certified; train a model for this rig"
        )
    old = fields["threshold"]
    made = dict(fields, threshold=certificate(threshold, promise))
    made["provenance"] = dict(fields["provenance"], certified_on=dict(origin))
    if old is not None:
        made["metrics"] = {"at_earlier_threshold": fields["metrics"]}
        made["provenance"]["earlier_threshold"] = old["logit"]
        made["provenance"]["earlier_sha256"] = fields.get("sha256", "")
    made["sha256"] = model_file.digest(made)
    return made


def gate_of(fields: Mapping[str, Any]) -> TriggerConfig:
    """Return the settings with the gate and vote of a document.

    Raises
    ------
    WeightsError : it names a setting that this program does not have.
    """
    try:
        return replace(TriggerConfig(), **fields["gate"])
    except TypeError as error:
        raise WeightsError(f"gate: {error}") from error


def events_needed(promise: Promise) -> int:
    """Return the fewest events that can certify a promise, with none of them missed."""
    low, high = 1, _MOST_EVENTS
    while low < high:
        middle = (low + high) // 2
        if certified_rank(middle, promise.alpha, promise.confidence) >= 1:
            high = middle
        else:
            low = middle + 1
    return low


def _best_alpha(n_events: int, promise: Promise) -> float:
    return smallest_alpha(n_events, 0, promise.confidence) if n_events else 1.0
