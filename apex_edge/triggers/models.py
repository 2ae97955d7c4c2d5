"""The trained models of the device: features in, logits and domain out. No files here.

Source: ours.
"""

from dataclasses import dataclass, field
from typing import Any, Dict, Optional, Tuple, Union

import numpy as np

from apex_edge.triggers.approach import Pairs
from apex_edge.triggers.feature_sets import FeatureSet
from apex_edge.triggers.graph_net import GraphNet
from apex_edge.triggers.stars import nodes_as, stars
from apex_edge.types import Array


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


class Domain:
    """What the training covered: ``ranges`` of features and of ``radius_m``; the rest is free.

    Parameters
    ----------
    ranges : lowest and highest value by name.
    names : of the k features.
    min_samples : shortest window trained on.
    """

    def __init__(
        self, ranges: Dict[str, Tuple[float, float]], names: Tuple[str, ...], min_samples: int
    ) -> None:
        self.ranges = ranges
        self.min_samples = min_samples
        # As rows: one comparison for all columns in place of one for each.
        free = (-np.inf, np.inf)
        self._low, self._high = np.array([ranges.get(name, free) for name in names]).T
        self._radius_m = ranges.get("radius_m", free)

    def holds(self, features: Array, radius_m: Array, n_samples: Array) -> Array:
        """Say which pairs (m,) lie inside, by ``features (m, k)``; NaN does not."""
        is_low, is_high = features >= self._low, features <= self._high
        inside: Array = np.logical_and.reduce(is_low & is_high, axis=1)
        inside &= n_samples >= self.min_samples
        inside &= (radius_m >= self._radius_m[0]) & (radius_m <= self._radius_m[1])
        return inside


@dataclass(frozen=True)
class TriggerModel:
    """What every trained model has; ``columns`` are those of ``feature_set``.

    ``threshold`` is a logit; NaN when nothing has certified one yet, and then nothing fires.
    ``training_range`` maps every feature to the range seen in training. ``certificate`` and
    ``gate`` say what recall was certified, and under which gate and vote.
    ``chances`` (2, n), logits and the probabilities they mean, straight lines in between and level
    beyond; None = the sigmoid of the logit.
    """

    feature_set: FeatureSet
    horizon_s: float
    columns: Columns
    threshold: float
    domain: Domain
    training_range: Dict[str, Tuple[float, float]]
    certificate: Dict[str, Any]
    gate: Dict[str, Any]
    chances: Optional[Array]

    @property
    def min_samples(self) -> int:
        """Return the shortest window trained on."""
        return self.domain.min_samples

    def is_in_domain(self, features: Array, radius_m: Array, n_samples: Array) -> Array:
        """Say which pairs (m,) lie inside what the training covered."""
        return self.domain.holds(features, radius_m, n_samples)

    def probability(self, logit: Array) -> Array:
        """Return the calibrated probability (m,) of contact."""
        if self.chances is None:
            chance: Array = 0.5 * (1.0 + np.tanh(0.5 * logit))
        else:
            chance = np.interp(logit, self.chances[0], self.chances[1])
        return chance


@dataclass(frozen=True)
class LinearWeights(TriggerModel):
    """A linear model: ``logit = columns(x) @ weight + bias``; ``weight (k,)``."""

    weight: Array
    bias: float
    _slope: Array = field(init=False, repr=False)
    _offset: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Fold the scaler into weights and bias."""
        slope = self.weight / self.columns.scale
        object.__setattr__(self, "_slope", slope)
        object.__setattr__(self, "_offset", self.bias - float(self.columns.mean @ slope))

    def logit(self, features: Array) -> Array:
        """Return the logit (m,) of features (m, k)."""
        # The scaler is folded into the weights: 7 us a call instead of 12 for 49 pairs.
        # Of the product dot takes half the time that @ does.
        result: Array = self.columns.clipped(features).dot(self._slope) + self._offset
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
        nodes = self.node_columns(nodes_as(found.nodes, self.net.spec.node_names))
        return self.net.logits(nodes, found.edges, self.columns(features))


Model = Union[LinearWeights, GraphWeights]
