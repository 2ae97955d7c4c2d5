"""Score rows with a model document, as the device would: one way for linear and graph models."""

from typing import Any, Callable, Mapping

import numpy as np

from apex_edge.errors import WeightsError
from apex_edge.triggers import weights
from apex_edge.triggers.feature_sets import FeatureSet
from apex_edge.triggers.models import GraphWeights, Model
from apex_edge.triggers.stars import nodes_as, stars
from apex_edge.types import Array
from offline_train.trigger.observe import Observed

RULE_SURE = 1e6
"""Stands for a logit above (or, negative, below) any threshold: the k-sigma rule has spoken."""
_CHUNK = 20000

Scorer = Callable[[Observed], Array]


def scorer(fields: Mapping[str, Any]) -> Scorer:
    """Return a function from rows to the model's logits (r,).

    Raises
    ------
    WeightsError : the fields make no model; later, that rows are judged for another horizon.
    """
    model = weights.check(fields, "model")

    def score(seen: Observed) -> Array:
        return logits(model, seen)

    return score


def device_scorer(fields: Mapping[str, Any]) -> Scorer:
    """Return a function from rows to what the device compares with the threshold (r,).

    Outside the model's domain the k-sigma rule decides whatever the threshold; there the score is
    plus or minus ``RULE_SURE``. Rows count as having enough samples: younger tracks have none.
    """
    model = weights.check(fields, "model")

    def score(seen: Observed) -> Array:
        features = _features(model, seen)
        samples = np.full(len(seen.pair), model.min_samples)
        is_known = model.is_in_domain(features, seen.geometry.radius_m, samples)
        is_known = is_known & np.all(np.isfinite(features), axis=1)
        by_rule = np.where(seen.rule_hit, RULE_SURE, -RULE_SURE)
        chosen: Array = np.where(is_known, logits(model, seen), by_rule)
        return chosen

    return score


def logits(model: Model, seen: Observed) -> Array:
    """Return the model's logit (r,) of each row, frame by frame.

    Raises
    ------
    WeightsError : rows are judged for another horizon, or were watched without wide features.
    """
    features = _features(model, seen)
    if not isinstance(model, GraphWeights):
        return model.logit(features)
    logit = np.zeros(len(seen.pair))
    group, mover = seen.group, seen.bodies[:, 0]
    # The rows of one frame make one set of stars and must not be torn apart.
    order = np.argsort(group, kind="stable")
    ends = np.flatnonzero(np.r_[group[order][1:] != group[order][:-1], True]) + 1
    first = 0
    while first < len(order):
        last = int(ends[min(np.searchsorted(ends, first + _CHUNK), len(ends) - 1)])
        rows = order[first:last]
        found = stars(seen.geometry.take(rows), mover[rows], group[rows])
        nodes = model.node_columns(nodes_as(found.nodes, model.net.spec.node_names))
        logit[rows] = model.net.logits(nodes, found.edges, model.columns(features[rows]))
        first = last
    return logit


def _features(model: Model, seen: Observed) -> Array:
    horizons = np.unique(seen.horizon_s)
    if len(horizons) and not np.allclose(horizons, model.horizon_s, rtol=0.0, atol=1e-6):
        raise WeightsError(
            f"the model looks {model.horizon_s:g} s ahead, the data {horizons.tolist()} s"
        )
    return features_of(model.feature_set, seen)


def features_of(known: FeatureSet, seen: Observed) -> Array:
    """Return the columns (r, k) of a feature set.

    Raises
    ------
    WeightsError : the rows have no wide features.
    """
    if not known.windows:
        return seen.features
    if not seen.wide.shape[1]:
        raise WeightsError(
            "the model needs wide features, but the scenes were watched without; "
            "apex train generate --wide makes them"
        )
    return seen.wide
