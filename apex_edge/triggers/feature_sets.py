"""The named sets of pair features a model may be trained on; one registry for trainer and device.

Source: ours.
"""

from typing import Callable, Dict, NamedTuple, Sequence, Tuple

from apex_edge.triggers.approach import Approach, Pairs
from apex_edge.triggers.base import Evidence
from apex_edge.triggers.features import (
    FEATURE_NAMES,
    FEATURE_SET,
    FEATURE_UNITS,
    FEATURE_VERSION,
    edge_features,
)
from apex_edge.triggers.wide import WIDE_NAMES, WIDE_SET, WIDE_UNITS, WIDE_VERSION, wide_features
from apex_edge.triggers.windows import WINDOWS
from apex_edge.types import Array


class FeatureSet(NamedTuple):
    """A named set of k pair features.

    ``windows`` are the frames of the line fits it needs besides the tracks' own motion, often
    none. ``compute`` maps (pairs, approach, horizon_s, the pairs as each window sees them) to
    (m, k).
    """

    name: str
    version: int
    names: Tuple[str, ...]
    units: Tuple[str, ...]
    windows: Tuple[int, ...]
    compute: Callable[[Pairs, Approach, float, Sequence[Pairs]], Array]


def _fused(pairs: Pairs, approach: Approach, horizon_s: float, windows: Sequence[Pairs]) -> Array:
    return edge_features(pairs, approach, horizon_s)


def _wide(pairs: Pairs, approach: Approach, horizon_s: float, windows: Sequence[Pairs]) -> Array:
    return wide_features(windows, horizon_s)


FEATURE_SETS: Dict[str, FeatureSet] = {
    FEATURE_SET: FeatureSet(FEATURE_SET, FEATURE_VERSION, FEATURE_NAMES, FEATURE_UNITS, (), _fused),
    WIDE_SET: FeatureSet(WIDE_SET, WIDE_VERSION, WIDE_NAMES, WIDE_UNITS, WINDOWS, _wide),
}


def model_features(name: str, evidence: Evidence) -> Array:
    """Return the features (m, k) of a set by name; KeyError when there is none of that name."""
    return FEATURE_SETS[name].compute(
        evidence.pairs, evidence.approach, evidence.horizon_s, evidence.windows
    )
