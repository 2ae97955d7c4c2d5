"""Write and read models of the paper's stars: the device's file format, features it does not have.

The stars are three-dimensional, in the paper's own units and without noise, so no device can use
these files and none accepts them (its feature sets are others); they are for reproduction. Same
model, same bytes: there is no time stamp inside. Source: ours.
"""

import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any, Dict, Mapping, Tuple

import numpy as np

from apex_edge.errors import WeightsError
from apex_edge.triggers import model_file
from apex_edge.triggers.graph_net import GraphSpec
from apex_edge.triggers.models import Columns
from offline_train.extras import module
from offline_train.graph_models.fitted import GraphFit, from_layers

FEATURE_SET = "paper-star"
_DATA = Path(__file__).resolve().parent.parent / "data"
_SPEC_KEYS = tuple(GraphSpec.__dataclass_fields__)


def shipped(architecture: str, has_quirks: bool) -> Path:
    """Return the file of one of the paper's models, trained by the command in ``verbs/fit.py``."""
    return _DATA / f"paper-{architecture}{'-quirks' if has_quirks else ''}.npz"


def fields_of(fit: GraphFit, notes: Mapping[str, Any]) -> Dict[str, Any]:
    """Return the document of an exportable model; ``notes`` (provenance, metrics) go in as is."""
    if fit.spec is None or fit.layers is None:
        raise WeightsError("this model cannot be exported: it has no layers the device knows")
    graph: Dict[str, Any] = asdict(fit.spec)
    graph["layers"] = {name: layer.tolist() for name, layer in fit.layers.items()}
    graph["node_scaler"] = _plain(fit.node_scaler)
    return {
        "format": model_file.FORMAT,
        "format_version": model_file.FORMAT_VERSION,
        "kind": "graph",
        "feature_set": FEATURE_SET,
        "dims": 3,
        "graph": graph,
        "edge_scaler": _plain(fit.edge_scaler),
        "threshold": None,
        **notes,
    }


def libraries() -> Dict[str, str]:
    """Return the versions that the bytes of a trained graph model depend on."""
    found = {"python": platform.python_version(), "numpy": np.__version__}
    for name in ("torch", "torch_geometric"):
        found[name] = str(module(name).__version__)
    return found


def read(path: Path) -> Tuple[GraphFit, Dict[str, Any]]:
    """Return the model of a file and all its fields; needs no PyTorch.

    Raises
    ------
    WeightsError : damaged, of another format, or not a model of the paper's stars.
    """
    fields = model_file.read(path)
    found = fields.get("feature_set")
    if found != FEATURE_SET:
        raise WeightsError(f"{path}: feature_set is {found!r}, expected {FEATURE_SET!r}")
    try:
        graph = fields["graph"]
        plain = {key: graph[key] for key in _SPEC_KEYS}
        plain["node_names"] = tuple(plain["node_names"])
        plain["edge_names"] = tuple(plain["edge_names"])
        layers = {name: np.array(rows, dtype=np.float64) for name, rows in graph["layers"].items()}
        scalers = _scaler(graph["node_scaler"]), _scaler(fields["edge_scaler"])
        return from_layers(GraphSpec(**plain), layers, *scalers), fields
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise WeightsError(f"{path}: a field is missing or wrong: {error}") from error


def _plain(scaler: Columns) -> Dict[str, Any]:
    return {name: column.tolist() for name, column in asdict(scaler).items()}


def _scaler(value: Mapping[str, Any]) -> Columns:
    return Columns(**{name: np.array(row, dtype=np.float64) for name, row in value.items()})
