"""Write a trained model as the device's JSON: hash, golden vectors, provenance, no wall clock.

The same seed and the same library versions give the same bytes; a time stamp would spoil that, so
the file has none (the commit that brings it in has one).
"""

import json
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, List

import numpy as np

from apex_edge.triggers import weights as device
from apex_edge.triggers.approach import Pairs, closest
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import (
    FEATURE_NAMES,
    FEATURE_SET,
    FEATURE_UNITS,
    FEATURE_VERSION,
    edge_features,
)
from apex_edge.types import Array
from offline_train.scenes import tabletop_pairs
from offline_train.trigger.calibrate import VISIBLE_S, Promise, Threshold
from offline_train.trigger.estimate import end_covariance
from offline_train.trigger.fit import LinearFit, sklearn_module
from offline_train.trigger.observe import Watching

WATCHING = Watching()
GATE_KEYS = ("min_speed_m_s", "min_speed_sd", "persist_hits", "persist_frames")
# Beyond these the model extrapolates. Small distance and small sd are no extrapolation: touching
# is certain, and z and reach are clipped.
_DOMAIN = {"distance": False, "closing": True, "speed": False, "sigma": False}


def document(
    fit: LinearFit,
    threshold: Threshold,
    promise: Promise,
    config: TriggerConfig,
    notes: Dict[str, Any],
) -> Dict[str, Any]:
    """Build all fields of a weights file; ``notes`` holds ``radius_m``, ``seed``, ``metrics``."""
    low, high = fit.low.tolist(), fit.high.tolist()
    ranges = {name: [low[i], high[i]] for i, name in enumerate(FEATURE_NAMES)}
    domain = {
        name: [ranges[name][0] if both else 0.0, ranges[name][1]] for name, both in _DOMAIN.items()
    }
    domain["radius_m"] = notes["radius_m"]
    fields: Dict[str, Any] = {
        "format": device.FORMAT,
        "format_version": device.FORMAT_VERSION,
        "kind": "linear",
        "feature_set": FEATURE_SET,
        "feature_version": FEATURE_VERSION,
        "feature_names": list(FEATURE_NAMES),
        "feature_units": list(FEATURE_UNITS),
        "dims": 2,
        "horizon_s": WATCHING.horizon_s,
        "fps_range": list(WATCHING.fps),
        "windows": list(WATCHING.window),
        "scaler": {"mean": fit.mean.tolist(), "scale": fit.scale.tolist()},
        "clip": {"lo": fit.clip_lo.tolist(), "hi": fit.clip_hi.tolist()},
        "weights": fit.weight.tolist(),
        "bias": fit.bias,
        "threshold": _certificate(threshold, promise),
        "gate": {key: getattr(config, key) for key in GATE_KEYS},
        "training_range": ranges,
        "domain": domain,
        "noise_model": {"kind": "white, per axis", "sd_m": list(WATCHING.noise_m)},
        "provenance": _provenance(notes["seed"]),
        "metrics": notes["metrics"],
        "golden": golden_vectors(fit),
    }
    fields["sha256"] = device.digest(fields)
    return fields


def write(fields: Dict[str, Any], path: Path) -> None:
    """Check the fields as the device would, then write the file whole or not at all.

    Raises
    ------
    WeightsError : the device would refuse the file.
    """
    text = json.dumps(fields, indent=1, sort_keys=True, allow_nan=False) + "\n"
    device.check(json.loads(text), str(path))
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="ascii")
    part.replace(path)


def golden_vectors(fit: LinearFit) -> List[Dict[str, Any]]:
    """Return six raw pairs with the features and the logit they must give on every device."""
    sd = np.array([0.0005, 0.001, 0.002, 0.003, 0.001, 0.0015])
    window = np.array([20, 10, 5, 7, 15, 12])
    cov = end_covariance(sd, window, np.full(6, 1.0 / 30.0), order=2)[:, [0, 1, 3, 4]][
        :, :, [0, 1, 3, 4]
    ]
    pairs = Pairs(
        offset_m=np.array(
            [[0.3, 0.0], [0.2, 0.1], [-0.15, 0.25], [0.1, -0.3], [0.4, 0.02], [0.06, 0.0]]
        ),
        mover_vel_m_s=np.array(
            [[0.1, 0.0], [0.08, 0.02], [-0.1, 0.1], [0.2, 0.1], [0.2, 0.0], [-0.05, 0.02]]
        ),
        target_vel_m_s=np.array(
            [[0, 0], [0, 0], [0.02, 0.05], [0, 0], [0.0, 0.02], [0, 0]], dtype=float
        ),
        decel_m_s2=np.array([0.0, 0.0, 0.0, 0.05, 0.04, 0.0]),
        radius_m=np.array([0.03, 0.035, 0.04, 0.05, 0.035, 0.03]),
        cov=2.0 * cov,
    )
    features = edge_features(pairs, closest(pairs, WATCHING.horizon_s), WATCHING.horizon_s)
    logit = fit.logit(features)
    return [
        _golden(pairs.take(np.array([row])), features[row], float(logit[row])) for row in range(6)
    ]


def _golden(pair: Pairs, features: Array, logit: float) -> Dict[str, Any]:
    case = {name: value[0].tolist() for name, value in asdict(pair).items()}
    return dict(case, horizon_s=WATCHING.horizon_s, features=features.tolist(), logit=logit)


def _certificate(threshold: Threshold, promise: Promise) -> Dict[str, Any]:
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


def _provenance(seed: int) -> Dict[str, Any]:
    return {
        "generator": tabletop_pairs.NAME,
        "generator_version": tabletop_pairs.VERSION,
        "seed": seed,
        "label": "true contact within the horizon",
        "libraries": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scikit-learn": sklearn_module("sklearn").__version__,
        },
    }
