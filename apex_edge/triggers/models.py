"""The trained models of the device: features in, logits and domain out. No files here.

Source: ours.
"""

from dataclasses import dataclass
from typing import Any, Callable, Dict, NamedTuple, Tuple, Union

import numpy as np

from apex_edge.triggers.approach import Approach, Pairs
from apex_edge.triggers.features import (
    FEATURE_NAMES,
    FEATURE_SET,
    FEATURE_UNITS,
    FEATURE_VERSION,
    edge_features,
)
from apex_edge.triggers.graph_net import GraphNet
from apex_edge.triggers.stars import NODE_NAMES, stars
from apex_edge.types import Array


class FeatureSet(NamedTuple):
    """A named set of pair features, and how they are computed from (pairs, approach, horizon)."""

    name: str
    version: int
    names: Tuple[str, ...]
    units: Tuple[str, ...]
    compute: Callable[[Pairs, Approach, float], Array]


FEATURE_SETS = {
    FEATURE_SET: FeatureSet(
        FEATURE_SET, FEATURE_VERSION, FEATURE_NAMES, FEATURE_UNITS, edge_features
    )
}


@dataclass(frozen=True)
class Columns:
    """Clip and standardise: ``(clip(x, lo, hi) - mean) / scale``; arrays (k,)."""

    lo: Array
    hi: Array
    mean: Array
    scale: Array

    def clipped(self, values: Array) -> Array:
        """Return the values (m, k) within ``lo`` and ``hi``; NaN stays NaN."""
        # np.clip takes three times as long on a few rows.
        limited: Array = np.minimum(np.maximum(values, self.lo), self.hi)
        return limited

    def __call__(self, values: Array) -> Array:
        """Return the standardised values (m, k)."""
        standard: Array = (self.clipped(values) - self.mean) / self.scale
        return standard


@dataclass(frozen=True)
class TriggerModel:
    """What every trained model has; ``columns`` are those of ``feature_set``.

    ``threshold`` is a logit; NaN when nothing has certified one yet, and then nothing fires.
    ``domain`` maps a feature, or ``radius_m``, to the range the training covered;
    ``training_range`` maps every feature to the range seen in training; ``min_samples`` is the
    shortest window trained on. ``certificate`` and ``gate`` say what recall was certified, and
    under which gate and vote. ``platt`` (a, b): the probability is sigmoid(a * logit + b).
    """

    feature_set: FeatureSet
    horizon_s: float
    columns: Columns
    threshold: float
    domain: Dict[str, Tuple[float, float]]
    training_range: Dict[str, Tuple[float, float]]
    min_samples: int
    certificate: Dict[str, Any]
    gate: Dict[str, Any]
    platt: Tuple[float, float]

    def is_in_domain(self, features: Array, radius_m: Array, n_samples: Array) -> Array:
        """Say which pairs (m,) lie inside what the training covered."""
        inside = n_samples >= self.min_samples
        names = self.feature_set.names
        for name, (low, high) in self.domain.items():
            column = radius_m if name == "radius_m" else features[:, names.index(name)]
            inside = inside & (column >= low) & (column <= high)
        result: Array = inside
        return result

    def probability(self, logit: Array) -> Array:
        """Return the calibrated probability (m,) of contact."""
        slope, offset = self.platt
        chance: Array = 0.5 * (1.0 + np.tanh(0.5 * (slope * logit + offset)))
        return chance


@dataclass(frozen=True)
class LinearWeights(TriggerModel):
    """A linear model: ``logit = columns(x) @ weight + bias``; ``weight (k,)``."""

    weight: Array
    bias: float

    def logit(self, features: Array) -> Array:
        """Return the logit (m,) of features (m, k)."""
        result: Array = self.columns(features) @ self.weight + self.bias
        return result


@dataclass(frozen=True)
class GraphWeights(TriggerModel):
    """A graph net over stars; ``node_columns`` are those of ``net.spec.node_names``."""

    net: GraphNet
    node_columns: Columns

    def logit(self, features: Array, pairs: Pairs, mover: Array) -> Array:
        """Return the logit (m,) of the pairs of one frame, all stars in one batch.

        Parameters
        ----------
        features : (m, k) of the pairs.
        pairs : m pairs.
        mover : (m,) identity of each pair's mover.
        """
        found = stars(pairs, mover)
        wanted = [NODE_NAMES.index(name) for name in self.net.spec.node_names]
        nodes = self.node_columns(found.nodes[:, wanted])
        return self.net.logits(nodes, found.edges, self.columns(features))


Model = Union[LinearWeights, GraphWeights]
