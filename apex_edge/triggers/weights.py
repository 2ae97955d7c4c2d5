"""Trained models of the device: build them from a checked document, replay what they must give.

Every key, name, shape and range is checked before use. The golden vectors are raw pairs with the
features and the logits they must give, so a change of the feature code is found as surely as a
damaged weight. Source: ours; the paper names no file format.
"""

from pathlib import Path
from typing import Any, Dict, FrozenSet, List, Mapping, Set, Tuple, Union

import numpy as np

from apex_edge.errors import WeightsError
from apex_edge.triggers import model_file
from apex_edge.triggers.approach import Pairs, closest
from apex_edge.triggers.feature_sets import FEATURE_SETS, FeatureSet
from apex_edge.triggers.graph_net import GraphNet, GraphSpec
from apex_edge.triggers.models import (
    Columns,
    Domain,
    GraphWeights,
    LinearWeights,
    Model,
)
from apex_edge.triggers.stars import NODE_NAMES, stars
from apex_edge.types import Array

_DATA = Path(__file__).resolve().parent.parent / "data"
SHIPPED = _DATA / "trigger-linear.json"
SHIPPED_GRAPH = _DATA / "trigger-graph.npz"
# The same float64 operations on another machine may differ in the last bits, no more.
GOLDEN_TOLERANCE = 1e-9
_N_GOLDEN = (2, 8)
_COMMON = frozenset(
    ("format", "format_version", "kind", "feature_set", "feature_version", "feature_names")
    + ("feature_units", "dims", "horizon_s", "fps_range", "windows", "scaler", "clip", "threshold")
    + ("gate", "training_range", "domain", "noise_model", "provenance", "metrics", "golden")
    + ("sha256",)
)
_OF_KIND = {"linear": frozenset(("weights", "bias")), "graph": frozenset(("graph",))}
_OPTIONAL = frozenset(("chances",))
_SPEC_KEYS = frozenset(GraphSpec.__dataclass_fields__)
_CERTIFICATE = ("logit", "alpha", "confidence", "lead_s", "n_pos", "k")


# Shape of each column of Pairs, per pair.
_PAIR_SHAPES: Dict[str, Tuple[int, ...]] = {
    "offset_m": (2,),
    "mover_vel_m_s": (2,),
    "target_vel_m_s": (2,),
    "decel_m_s2": (),
    "radius_m": (),
    "cov": (4, 4),
}


def load(path: Union[str, Path]) -> Model:
    """Read, check and replay a model file that is ready for use.

    Raises
    ------
    WeightsError : unreadable, of another format or version, changed after export, missing or
        unknown key, features of another set, a shape, range or number that is wrong, a golden
        vector that does not come out, or no certified threshold.
    """
    model = check(model_file.read(path), str(path))
    if not np.isfinite(model.threshold):
        raise WeightsError(
            f"{path}: threshold is null: no recall is certified yet; run apex train calibrate"
        )
    return model


def load_linear(path: Union[str, Path]) -> LinearWeights:
    """Load a model of kind "linear"; see ``load``."""
    model = load(path)
    if not isinstance(model, LinearWeights):
        raise WeightsError(f"{path}: kind is 'graph', expected 'linear'; set trigger.type = graph")
    return model


def load_graph(path: Union[str, Path]) -> GraphWeights:
    """Load a model of kind "graph"; see ``load``."""
    model = load(path)
    if not isinstance(model, GraphWeights):
        raise WeightsError(f"{path}: kind is 'linear', expected 'graph'; set trigger.type = linear")
    return model


def check(fields: Any, where: str) -> Model:
    """Build the model of a document and replay its golden vectors; no threshold is needed.

    The hash is for ``model_file.read``.

    Raises
    ------
    WeightsError : see ``load``.
    """
    return _guarded(fields, where, is_replayed=True)


def build(fields: Any, where: str) -> Model:
    """Build the model of a document that has no golden vectors yet; else as ``check``."""
    return _guarded(fields, where, is_replayed=False)


def _guarded(fields: Any, where: str, is_replayed: bool) -> Model:
    try:
        model_file.check_identity(fields)
        with np.errstate(all="ignore"):
            model = _built(fields)
            if is_replayed:
                _check_golden(model, fields["golden"])
            return model
    except KeyError as error:
        raise WeightsError(f"{where}: {error} is missing") from error
    except (WeightsError, ValueError, ArithmeticError) as error:
        raise WeightsError(f"{where}: {error}") from error
    except (TypeError, AttributeError, IndexError, RecursionError) as error:
        raise WeightsError(f"{where}: a field has the wrong type: {error}") from error


def _built(fields: Dict[str, Any]) -> Model:
    kind = fields.get("kind")
    _need(isinstance(kind, str) and kind in _OF_KIND, f"kind is {kind!r}, expected linear or graph")
    _same_keys(set(fields) - _OPTIONAL, _COMMON | _OF_KIND[str(kind)], "the document")
    features = _feature_set(fields)
    common: Dict[str, Any] = dict(_common(fields, features))
    if kind == "graph":
        return _graph(fields["graph"], features, common)
    weight = _row(fields["weights"], len(features.names), "weights")
    return LinearWeights(**common, weight=weight, bias=_number(fields["bias"], "bias"))


def _feature_set(fields: Dict[str, Any]) -> FeatureSet:
    name = fields["feature_set"]
    _need(
        isinstance(name, str) and name in FEATURE_SETS,
        f"feature_set is {name!r}, this program has {sorted(FEATURE_SETS)}",
    )
    found = FEATURE_SETS[name]
    expected = {
        "feature_version": found.version,
        "feature_names": list(found.names),
        "feature_units": list(found.units),
        "dims": 2,
    }
    for key, value in expected.items():
        _need(fields[key] == value, f"{key} is {fields[key]!r}, this program has {value!r}")
    return found


def _common(fields: Dict[str, Any], features: FeatureSet) -> Dict[str, Any]:
    names = features.names
    scaler, clip = fields["scaler"], fields["clip"]
    certificate = _certificate(fields["threshold"])
    windows = [_whole(value, "windows") for value in fields["windows"]]
    horizon_s = _number(fields["horizon_s"], "horizon_s")
    _need(horizon_s > 0.0, f"horizon_s must be positive, found {horizon_s}")
    for key in ("gate", "noise_model", "provenance", "metrics"):
        _need(isinstance(fields[key], dict), f"{key} must be a table")
    return {
        "feature_set": features,
        "horizon_s": horizon_s,
        "columns": _columns({**scaler, **clip}, len(names), "scaler and clip"),
        "threshold": certificate.get("logit", float("nan")),
        "domain": Domain(
            _ranges(fields["domain"], set(names) | {"radius_m"}, "domain"), names, min(windows)
        ),
        "training_range": _ranges(fields["training_range"], set(names), "training_range"),
        "certificate": certificate,
        "gate": dict(fields["gate"]),
        "chances": _chances(fields["chances"]) if "chances" in fields else None,
    }


def _chances(value: Dict[str, Any]) -> Array:
    _same_keys(set(value), frozenset(("logit", "probability")), "chances")
    n = len(value["logit"])
    rows = np.array([_row(value[key], n, f"chances: {key}") for key in ("logit", "probability")])
    _need(n >= 2 and bool(np.all(np.diff(rows[0]) > 0.0)), "chances: logits must rise")
    _need(
        bool(np.all(np.diff(rows[1]) >= 0.0) and rows[1, 0] >= 0.0 and rows[1, -1] <= 1.0),
        "chances: probabilities must not fall, and lie between 0 and 1",
    )
    return rows


def _certificate(value: Any) -> Dict[str, Any]:
    """Return the certificate as it is, with plain floats checked; empty when there is none."""
    if value is None:
        return {}
    certificate = dict(value)
    for key in _CERTIFICATE:
        certificate[key] = type(certificate[key])(_number(certificate[key], f"threshold.{key}"))
    return certificate


def _graph(value: Dict[str, Any], features: FeatureSet, common: Dict[str, Any]) -> GraphWeights:
    _same_keys(set(value), _SPEC_KEYS | {"layers", "node_scaler"}, "graph")
    plain = {key: value[key] for key in _SPEC_KEYS}
    for key in ("node_names", "edge_names"):
        plain[key] = tuple(plain[key])
    spec = GraphSpec(**plain)
    unknown = sorted(str(name) for name in set(spec.node_names) - set(NODE_NAMES))
    _need(not unknown, f"node_names: this program has {NODE_NAMES}, not {unknown}")
    is_blind = spec.edge_mode == "none" and not spec.edge_names
    _need(
        is_blind or spec.edge_names == features.names,
        f"edge_names is {list(spec.edge_names)}, expected the feature_names",
    )
    layers = {name: np.array(rows, dtype=np.float64) for name, rows in value["layers"].items()}
    return GraphWeights(
        **common,
        net=GraphNet(spec, layers),
        node_columns=_columns(value["node_scaler"], len(spec.node_names), "node_scaler"),
    )


def _columns(value: Dict[str, Any], n: int, name: str) -> Columns:
    _same_keys(set(value), frozenset(("lo", "hi", "mean", "scale")), name)
    rows = {key: _row(value[key], n, f"{name}: {key}") for key in value}
    _need(bool(np.all(rows["scale"] > 0.0)), f"{name}: every scale must be positive")
    _need(bool(np.all(rows["lo"] <= rows["hi"])), f"{name}: a low end lies above its high end")
    return Columns(**rows)


def _ranges(value: Dict[str, Any], known: Set[str], name: str) -> Dict[str, Tuple[float, float]]:
    unknown = sorted(set(value) - known)
    _need(not unknown, f"{name} names unknown features {unknown}")
    ranges = {key: (_number(low, name), _number(high, name)) for key, (low, high) in value.items()}
    for key, (low, high) in ranges.items():
        _need(low <= high, f"{name}: {key} has its low end above its high end")
    return ranges


def _row(value: List[float], n: int, name: str) -> Array:
    row = np.array(value, dtype=np.float64)
    _need(row.shape == (n,), f"{name} has shape {row.shape}, expected ({n},)")
    _need(bool(np.isfinite(row).all()), f"{name} holds a number that is not finite")
    return row


def _number(value: Any, name: str) -> float:
    _need(type(value) in (int, float), f"{name} is {value!r}, expected a number")
    number = float(value)
    _need(bool(np.isfinite(number)), f"{name} is not finite")
    return number


def _whole(value: Any, name: str) -> int:
    _need(type(value) is int and value > 0, f"{name} is {value!r}, expected whole numbers above 0")
    return int(value)


def _same_keys(found: Set[str], expected: FrozenSet[str], name: str) -> None:
    missing, unknown = sorted(expected - found), sorted(found - expected)
    _need(not missing and not unknown, f"{name}: missing keys {missing}, unknown keys {unknown}")


def _need(is_right: bool, message: str) -> None:
    if not is_right:
        raise WeightsError(message)


def _check_golden(model: Model, golden: List[Any]) -> None:
    low, high = _N_GOLDEN
    _need(
        isinstance(golden, list) and low <= len(golden) <= high,
        f"golden: expected {low} to {high} golden vectors",
    )
    for number, case in enumerate(golden):
        got = replay(model, case)
        for name, value in got.items():
            expected = np.array(case[name], dtype=np.float64)
            is_same = value.shape == expected.shape and np.allclose(
                value, expected, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
            )
            _need(
                is_same,
                f"golden vector {number}: {name} does not come out: "
                f"{value.tolist()}, expected {case[name]}",
            )


def replay(model: Model, case: Mapping[str, Any]) -> Dict[str, Array]:
    """Return what the raw pairs of a golden vector give now.

    A case has the columns of ``Pairs`` (m pairs of one frame), ``mover (m,)`` identities and
    ``horizon_s``, and what must come out: ``features (m, k)``, ``logit (m,)``, and for a graph
    ``nodes (N, F)`` and ``edges (2, m)`` of its stars, not yet standardised. For a feature set
    with windows, ``windows`` has the same columns of the same pairs once per window.
    """
    pairs, n = _raw_pairs(case), len(case["radius_m"])
    horizon_s = _number(case["horizon_s"], "golden horizon_s")
    windows = tuple(_raw_pairs(part) for part in case.get("windows", ()))
    is_whole = len(windows) == len(model.feature_set.windows)
    _need(is_whole and all(len(p.radius_m) == n for p in windows), "golden windows do not fit")
    features = model.feature_set.compute(pairs, closest(pairs, horizon_s), horizon_s, windows)
    if isinstance(model, LinearWeights):
        return {"features": features, "logit": model.logit(features)}
    mover = np.array([_whole(value, "golden mover") for value in case["mover"]])
    _need(len(mover) == n, "golden mover has a wrong length")
    found = stars(pairs, mover)
    return {
        "features": features,
        "nodes": found.nodes,
        "edges": found.edges,
        "logit": model.logit(features, pairs, mover),
    }


def _raw_pairs(case: Mapping[str, Any]) -> Pairs:
    columns = {name: np.array(case[name], dtype=np.float64) for name in _PAIR_SHAPES}
    n = len(case["radius_m"])
    for name, shape in _PAIR_SHAPES.items():
        _need(n > 0 and columns[name].shape == (n, *shape), f"golden {name} has a wrong shape")
    return Pairs(**columns)
