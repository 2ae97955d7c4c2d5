"""Make and write the device's model document: hash, golden vectors, provenance, no wall clock.

The same seed and the same library versions give the same bytes; a time stamp would spoil that, so
the file has none (the commit that brings it in has one).
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Dict, Mapping, Optional

from apex_edge.triggers import model_file
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.feature_sets import FeatureSet
from apex_edge.triggers.graph_net import GraphSpec
from apex_edge.triggers.models import Columns
from apex_edge.triggers.weights import check
from apex_edge.types import Array
from offline_train.trigger.calibrate import VISIBLE_S, Promise, Threshold
from offline_train.trigger.fit import LinearFit
from offline_train.trigger.golden import with_golden
from offline_train.trigger.observe import Watching

GATE_KEYS = ("min_speed_m_s", "min_speed_sd", "persist_hits", "persist_frames")
# Beyond these the model extrapolates. Small distance and small sd are no extrapolation: touching
# is certain, and z and reach are clipped. The value says whether the low end counts as well.
_DOMAIN = {"distance": False, "closing": True, "speed": False, "sigma": False}
# Of a set with windows, the middle one speaks for all.
_DOMAIN_WINDOW = 1


@dataclass(frozen=True)
class Trained:
    """What a document holds of a trained model.

    ``keys`` are those of its kind; ``columns`` clip and standardise the features of
    ``feature_set``; ``low``, ``high (k,)`` are the training ranges before clipping.
    """

    keys: Dict[str, Any]
    feature_set: FeatureSet
    columns: Columns
    low: Array
    high: Array


def linear(fit: LinearFit, feature_set: FeatureSet) -> Trained:
    """Return what is written of a linear model on a set of features."""
    return Trained(
        keys={"kind": "linear", "weights": fit.weight.tolist(), "bias": fit.bias},
        feature_set=feature_set,
        columns=Columns(fit.clip_lo, fit.clip_hi, fit.mean, fit.scale),
        low=fit.low,
        high=fit.high,
    )


def graph_keys(spec: GraphSpec, layers: Mapping[str, Array], nodes: Columns) -> Dict[str, Any]:
    """Return the keys of a graph net, for ``Trained.keys``; ``nodes`` standardises its nodes."""
    return {
        "kind": "graph",
        "graph": {
            **asdict(spec),
            "layers": {name: array.tolist() for name, array in layers.items()},
            "node_scaler": _plain(nodes),
        },
    }


def document(
    trained: Trained,
    threshold: Optional[Threshold],
    promise: Promise,
    config: TriggerConfig,
    notes: Dict[str, Any],
) -> Dict[str, Any]:
    """Build all fields of a model document, signed.

    ``threshold`` None = not certified yet, and no device will use it. ``notes`` holds ``radius_m``
    (smallest, largest), ``watching`` (how the training scenes were watched; None = as usual),
    ``provenance`` and ``metrics``.

    Raises
    ------
    WeightsError : the device would not build this model.
    """
    low, high = trained.low.tolist(), trained.high.tolist()
    known = trained.feature_set
    ranges = {name: [low[i], high[i]] for i, name in enumerate(known.names)}
    suffix = f"_{known.windows[_DOMAIN_WINDOW]}" if known.windows else ""
    domain = {
        name + suffix: [ranges[name + suffix][0] if both else 0.0, ranges[name + suffix][1]]
        for name, both in _DOMAIN.items()
    }
    domain["radius_m"] = notes["radius_m"]
    columns = _plain(trained.columns)
    watching = notes.get("watching") or Watching()
    fields: Dict[str, Any] = {
        "format": model_file.FORMAT,
        "format_version": model_file.FORMAT_VERSION,
        **trained.keys,
        "feature_set": known.name,
        "feature_version": known.version,
        "feature_names": list(known.names),
        "feature_units": list(known.units),
        "dims": 2,
        "horizon_s": watching.horizon_s,
        "fps_range": list(watching.fps),
        "windows": list(watching.window),
        "scaler": {key: columns[key] for key in ("mean", "scale")},
        "clip": {key: columns[key] for key in ("lo", "hi")},
        "threshold": None if threshold is None else certificate(threshold, promise),
        "gate": {key: getattr(config, key) for key in GATE_KEYS},
        "training_range": ranges,
        "domain": domain,
        "noise_model": {"kind": "white, per axis", "sd_m": list(watching.noise_m)},
        "provenance": notes["provenance"],
        "metrics": notes["metrics"],
    }
    fields = with_golden(fields, watching.horizon_s)
    fields["sha256"] = model_file.digest(fields)
    return fields


def write(fields: Dict[str, Any], path: Path) -> None:
    """Check the fields as the device would, then write the file whole or not at all.

    Raises
    ------
    WeightsError : the device would refuse the file, if only its threshold were certified.
    RecordingError : it cannot be written.
    """
    check(fields, str(path))
    model_file.write(fields, path)


def _plain(columns: Columns) -> Dict[str, Any]:
    return {name: array.tolist() for name, array in asdict(columns).items()}


def certificate(threshold: Threshold, promise: Promise) -> Dict[str, Any]:
    """Return what a document says of a certified threshold."""
    return {
        "logit": threshold.logit,
        "alpha": promise.alpha,
        "confidence": promise.confidence,
        "lead_s": promise.lead_s,
        "visible_s": VISIBLE_S,
        "n_pos": threshold.n_pos,
        "n_contacts": threshold.n_contacts,
        "k": threshold.k,
        "unit": "event",
    }
