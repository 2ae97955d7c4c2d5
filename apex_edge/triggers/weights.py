"""Read and check the weights of a linear trigger: versioned JSON, hash, ranges, golden vectors.

The hash covers the canonical bytes (sorted keys, no spaces, ASCII) of all other fields. The golden
vectors are raw pairs with the features and the logit they must give, so a change of the feature
code is found as surely as a damaged weight. Source: ours; the paper names no file format.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple, Union

import numpy as np

from apex_edge.errors import WeightsError
from apex_edge.triggers.approach import Pairs, closest
from apex_edge.triggers.features import (
    FEATURE_NAMES,
    FEATURE_SET,
    FEATURE_UNITS,
    FEATURE_VERSION,
    edge_features,
)
from apex_edge.types import Array

FORMAT = "apex-edge-trigger"
FORMAT_VERSION = 1
SHIPPED = Path(__file__).resolve().parent.parent / "data" / "trigger-linear.json"
# The same float64 operations on another machine may differ in the last bits, no more.
_GOLDEN_TOLERANCE = 1e-6
_KEYS = frozenset(
    ("format", "format_version", "kind", "feature_set", "feature_version", "feature_names")
    + ("feature_units", "dims", "horizon_s", "fps_range", "windows", "scaler", "clip", "weights")
    + ("bias", "threshold", "gate", "training_range", "domain", "noise_model", "provenance")
    + ("metrics", "golden", "sha256")
)


@dataclass(frozen=True)
class LinearWeights:
    """A checked linear model; arrays are (12,), in the order of FEATURE_NAMES.

    ``logit = ((clip(x, clip_lo, clip_hi) - mean) / scale) @ weight + bias``; ``threshold`` is a
    logit. ``domain`` maps a feature, or ``radius_m``, to the range the training covered;
    ``min_samples`` is the shortest window trained on. ``certificate`` and ``gate`` say what
    recall was certified, and under which gate and vote.
    """

    horizon_s: float
    mean: Array
    scale: Array
    clip_lo: Array
    clip_hi: Array
    weight: Array
    bias: float
    threshold: float
    domain: Dict[str, Tuple[float, float]]
    min_samples: int
    certificate: Dict[str, Any]
    gate: Dict[str, Any]

    def logit(self, features: Array) -> Array:
        """Return the logit (m,) of features (m, 12)."""
        clipped = np.clip(features, self.clip_lo, self.clip_hi)
        result: Array = ((clipped - self.mean) / self.scale) @ self.weight + self.bias
        return result

    def is_in_domain(self, features: Array, radius_m: Array, n_samples: Array) -> Array:
        """Say which pairs (m,) lie inside what the training covered."""
        inside = n_samples >= self.min_samples
        for name, (low, high) in self.domain.items():
            column = radius_m if name == "radius_m" else features[:, FEATURE_NAMES.index(name)]
            inside = inside & (column >= low) & (column <= high)
        result: Array = inside
        return result


def canonical_bytes(fields: Mapping[str, Any]) -> bytes:
    """Return the bytes the hash covers: all fields but ``sha256``.

    Raises
    ------
    ValueError : a number is NaN or infinite.
    """
    rest = {key: value for key, value in fields.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return text.encode("ascii")


def digest(fields: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the canonical bytes, in hex."""
    return hashlib.sha256(canonical_bytes(fields)).hexdigest()


def load(path: Union[str, Path]) -> LinearWeights:
    """Read, check and replay a weights file.

    Raises
    ------
    WeightsError : unreadable, not JSON, another format or major version, missing or unknown key,
        wrong hash, NaN or infinity, features of another set, a scale that is not positive,
        a range upside down, or a golden vector that does not come out.
    """
    source = Path(path)
    try:
        text = source.read_text(encoding="utf-8")
        fields = json.loads(text, parse_constant=_refuse_constant)
    except (OSError, ValueError, RecursionError) as error:
        raise WeightsError(f"{source}: cannot be read as a weights file: {error}") from error
    return check(fields, str(source))


def check(fields: Any, where: str) -> LinearWeights:
    """Check the parsed fields of a weights file and build the model; see ``load``."""
    if not isinstance(fields, dict):
        raise WeightsError(f"{where}: expected a JSON object, found {type(fields).__name__}")
    _check_identity(fields, where)
    _check_hash(fields, where)
    _check_features(fields, where)
    try:
        model = _build(fields, where)
        golden = [_replay(case) for case in fields["golden"]]
    except (KeyError, TypeError, ValueError, IndexError, OverflowError) as error:
        raise WeightsError(f"{where}: a field has the wrong shape or type: {error!r}") from error
    _check_numbers(model, where)
    _check_golden(model, golden, where)
    return model


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not a number the format allows")


def _check_identity(fields: Dict[str, Any], where: str) -> None:
    expected = {"format": FORMAT, "format_version": FORMAT_VERSION, "kind": "linear"}
    for key, value in expected.items():
        if fields.get(key) != value:
            raise WeightsError(f"{where}: {key} is {fields.get(key)!r}, expected {value!r}")
    missing, unknown = sorted(_KEYS - set(fields)), sorted(set(fields) - _KEYS)
    if missing or unknown:
        raise WeightsError(f"{where}: missing keys {missing}, unknown keys {unknown}")


def _check_hash(fields: Dict[str, Any], where: str) -> None:
    try:
        found = digest(fields)
    except (ValueError, TypeError) as error:
        raise WeightsError(f"{where}: {error}") from error
    if fields["sha256"] != found:
        raise WeightsError(
            f"{where}: sha256 is {fields['sha256']!r}, but the content gives {found!r}; "
            "the file was changed after export"
        )


def _check_features(fields: Dict[str, Any], where: str) -> None:
    expected = {
        "feature_set": FEATURE_SET,
        "feature_version": FEATURE_VERSION,
        "feature_names": list(FEATURE_NAMES),
        "feature_units": list(FEATURE_UNITS),
        "dims": 2,
    }
    for key, value in expected.items():
        if fields[key] != value:
            raise WeightsError(f"{where}: {key} is {fields[key]!r}, this program has {value!r}")


def _build(fields: Dict[str, Any], where: str) -> LinearWeights:
    domain = {name: (float(low), float(high)) for name, (low, high) in fields["domain"].items()}
    unknown = set(domain) - set(FEATURE_NAMES) - {"radius_m"}
    if unknown:
        raise WeightsError(f"{where}: domain names unknown features {sorted(unknown)}")
    return LinearWeights(
        horizon_s=float(fields["horizon_s"]),
        mean=_row(fields["scaler"]["mean"], "scaler.mean"),
        scale=_row(fields["scaler"]["scale"], "scaler.scale"),
        clip_lo=_row(fields["clip"]["lo"], "clip.lo"),
        clip_hi=_row(fields["clip"]["hi"], "clip.hi"),
        weight=_row(fields["weights"], "weights"),
        bias=float(fields["bias"]),
        threshold=float(fields["threshold"]["logit"]),
        domain=domain,
        min_samples=int(min(fields["windows"])),
        certificate=dict(fields["threshold"]),
        gate=dict(fields["gate"]),
    )


def _row(values: List[float], name: str) -> Array:
    row = np.array(values, dtype=np.float64)
    if row.shape != (len(FEATURE_NAMES),):
        raise ValueError(f"{name} has shape {row.shape}, expected ({len(FEATURE_NAMES)},)")
    return row


def _check_numbers(model: LinearWeights, where: str) -> None:
    arrays = (model.mean, model.scale, model.clip_lo, model.clip_hi, model.weight)
    scalars = (model.bias, model.threshold, model.horizon_s)
    if not (all(np.isfinite(a).all() for a in arrays) and np.isfinite(scalars).all()):
        raise WeightsError(f"{where}: a weight, scale, clip, bias or threshold is not finite")
    if not np.all(model.scale > 0.0):
        raise WeightsError(f"{where}: scaler.scale must be positive, found {model.scale.min()}")
    if not model.horizon_s > 0.0:
        raise WeightsError(f"{where}: horizon_s must be positive, found {model.horizon_s}")
    is_upside = np.any(model.clip_lo > model.clip_hi)
    if is_upside or any(not low <= high for low, high in model.domain.values()):
        raise WeightsError(f"{where}: a clip or domain range has its low end above its high end")


def _replay(case: Mapping[str, Any]) -> Tuple[Array, Array, float]:
    """Return (features now, features expected, logit expected) of one golden vector."""
    pairs = Pairs(
        offset_m=np.array([case["offset_m"]], dtype=np.float64),
        mover_vel_m_s=np.array([case["mover_vel_m_s"]], dtype=np.float64),
        target_vel_m_s=np.array([case["target_vel_m_s"]], dtype=np.float64),
        decel_m_s2=np.array([case["decel_m_s2"]], dtype=np.float64),
        radius_m=np.array([case["radius_m"]], dtype=np.float64),
        cov=np.array([case["cov"]], dtype=np.float64),
    )
    horizon_s = float(case["horizon_s"])
    features = edge_features(pairs, closest(pairs, horizon_s), horizon_s)
    return features, _row(case["features"], "golden features")[None], float(case["logit"])


def _check_golden(
    model: LinearWeights, golden: List[Tuple[Array, Array, float]], where: str
) -> None:
    if not 2 <= len(golden) <= 8:
        raise WeightsError(f"{where}: expected 2 to 8 golden vectors, found {len(golden)}")
    for number, (found, expected, logit) in enumerate(golden):
        if not np.allclose(found, expected, rtol=_GOLDEN_TOLERANCE, atol=_GOLDEN_TOLERANCE):
            raise WeightsError(f"{where}: golden vector {number}: the features do not come out")
        got = float(model.logit(found)[0])
        if not abs(got - logit) <= _GOLDEN_TOLERANCE * max(1.0, abs(logit)):
            raise WeightsError(f"{where}: golden vector {number}: logit {got}, expected {logit}")
