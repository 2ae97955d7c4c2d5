"""Ways to spoil a model file, for the tests and for the bench: one table for both.

Each damage of the content is signed again after it, so that it is the check itself that must find
it and not the hash. Needs nothing but the device's packages.
"""

import copy
import io
import json
import pickle
import zipfile
from typing import Any, Callable, Dict, List, Tuple

import numpy as np

from apex_edge.triggers import model_file
from apex_edge.triggers.graph_net import GRAPHORMER, GraphSpec, layer_shapes
from apex_edge.triggers.stars import NODE_NAMES
from apex_edge.triggers.weights import build, replay

Fields = Dict[str, Any]


def changed(path: List[Any], value: Any) -> Callable[[Fields], None]:
    """Return a damage that puts a value in the place of what is found along the keys."""

    def apply(fields: Fields) -> None:
        spot: Any = fields
        for key in path[:-1]:
            spot = spot[key]
        spot[path[-1]] = value

    return apply


def without(path: List[Any]) -> Callable[[Fields], None]:
    """Return a damage that takes away what is found along the keys."""

    def apply(fields: Fields) -> None:
        spot: Any = fields
        for key in path[:-1]:
            spot = spot[key]
        del spot[path[-1]]

    return apply


OF_ANY: Dict[str, Tuple[Callable[[Fields], None], str]] = {
    "another format": (changed(["format"], "pickle"), "format is 'pickle'"),
    "the first version": (changed(["format_version"], 1), "export the model again"),
    "a newer version": (changed(["format_version"], 3), "format_version is 3"),
    "a version that is true": (changed(["format_version"], True), "format_version"),
    "another kind": (changed(["kind"], "forest"), "kind is 'forest'"),
    "a kind that is a list": (changed(["kind"], []), "kind"),
    "another feature set": (changed(["feature_set"], "fused99"), "feature_set"),
    "another feature version": (changed(["feature_version"], 9), "feature_version"),
    "a renamed feature": (changed(["feature_names", 0], "range"), "feature_names"),
    "other units": (changed(["feature_units", 0], "m"), "feature_units"),
    "three dimensions": (changed(["dims"], 3), "dims"),
    "a scale of zero": (changed(["scaler", "scale", 3], 0.0), "positive"),
    "a negative scale": (changed(["scaler", "scale", 3], -1.0), "positive"),
    "too few means": (changed(["scaler", "mean"], [1.0]), "shape"),
    "a scaler that is a number": (changed(["scaler"], 1.0), "wrong type"),
    "a clip upside down": (changed(["clip", "lo", 1], 1e9), "low end"),
    "a domain upside down": (changed(["domain", "sigma"], [2.0, 1.0]), "low end"),
    "a domain of one number": (changed(["domain", "sigma"], [2.0]), "unpack"),
    "an unknown domain": (changed(["domain", "colour"], [0.0, 1.0]), "colour"),
    "a horizon of zero": (changed(["horizon_s"], 0.0), "horizon_s"),
    "a window of half a frame": (changed(["windows"], [0.5, 20]), "windows"),
    "no windows": (changed(["windows"], []), "empty"),
    "a threshold too large for a float": (
        changed(["threshold", "logit"], 10**400),
        "too large|401 digits",
    ),
    "a threshold that is text": (changed(["threshold", "logit"], "0"), "threshold.logit"),
    "a certificate without its events": (without(["threshold", "n_pos"]), "n_pos"),
    "no threshold yet": (changed(["threshold"], None), "apex train calibrate"),
    "no threshold at all": (without(["threshold"]), "threshold"),
    "no golden vectors": (changed(["golden"], []), "golden"),
    "golden vectors left out": (without(["golden"]), "golden"),
    "a gate that is a list": (changed(["gate"], []), "gate must be"),
    "provenance that is text": (changed(["provenance"], "me"), "provenance must be"),
    "no provenance": (without(["provenance"]), "provenance"),
    "an unknown key": (changed(["comment"], "hi"), "comment"),
    "chances that fall": (
        changed(["chances"], {"logit": [-1.0, 1.0], "probability": [0.6, 0.4]}),
        "chances",
    ),
    "chances above certainty": (
        changed(["chances"], {"logit": [-1.0, 1.0], "probability": [0.6, 1.4]}),
        "chances",
    ),
    "chances at logits out of order": (
        changed(["chances"], {"logit": [1.0, -1.0], "probability": [0.4, 0.6]}),
        "chances",
    ),
    "a golden logit that is off": (changed(["golden", 1, "logit", 0], 0.123), "golden vector 1"),
    "a golden feature that is off": (
        changed(["golden", 0, "features", 0, 2], 0.1),
        "golden vector 0",
    ),
    "a golden pair of no shape": (changed(["golden", 0, "cov"], [1.0]), "golden cov"),
    "a number that is not one": (changed(["scaler", "mean", 0], float("nan")), "not|Out of range"),
    "an infinite number": (changed(["clip", "hi", 0], float("inf")), "not|Out of range"),
}
"""Damages of every kind of model: what is done, and a part of the message it must give."""

OF_LINEAR: Dict[str, Tuple[Callable[[Fields], None], str]] = {
    "too few weights": (changed(["weights"], [1.0]), "shape"),
    "a weight that is text": (changed(["weights", 0], "much"), "could not convert"),
    "a weight that is off": (changed(["weights", 6], 0.5), "golden"),
    "a weight that is NaN": (changed(["weights", 6], float("nan")), "not|Out of range"),
    "a bias that is a list": (changed(["bias"], [0.0]), "bias"),
}

OF_GRAPH: Dict[str, Tuple[Callable[[Fields], None], str]] = {
    "an unknown architecture": (changed(["graph", "architecture"], "mlp"), "architecture"),
    "heads that do not divide": (changed(["graph", "heads"], 3), "divide"),
    "a width beyond reason": (changed(["graph", "hidden"], 10**9), "hidden"),
    "an unknown node feature": (changed(["graph", "node_names", 1], "z"), "node_names"),
    "edges of other features": (changed(["graph", "edge_names", 0], "range"), "edge_names"),
    "a layer of another shape": (changed(["graph", "layers", "head.weight"], [[1.0]]), "shape"),
    "a ragged layer": (
        changed(["graph", "layers", "head.weight"], [[1.0], [1.0, 2.0]]),
        "sequence",
    ),
    "an unknown layer": (changed(["graph", "layers", "conv.lin_beta.weight"], [1.0]), "unknown"),
    "a layer left out": (without(["graph", "layers", "conv.lin_skip.bias"]), "missing"),
    "layers in a list": (changed(["graph", "layers"], []), "wrong type"),
    "a layer that is off": (changed(["graph", "layers", "head.bias"], [9.0]), "golden"),
    "a NaN in a layer": (
        changed(["graph", "layers", "conv.lin_skip.bias", 0], float("nan")),
        "not|Out of range",
    ),
    "a node scale of zero": (changed(["graph", "node_scaler", "scale", 0], 0.0), "positive"),
    "no node scaler": (without(["graph", "node_scaler"]), "node_scaler"),
    "golden nodes that are off": (changed(["golden", 1, "nodes", 0, 3], 7.0), "golden vector 1"),
    "golden movers left out": (without(["golden", 0, "mover"]), "mover"),
}


def damages_of(kind: str) -> Dict[str, Tuple[Callable[[Fields], None], str]]:
    """Return the damages of a kind of model, "linear" or "graph"."""
    return {**OF_ANY, **(OF_LINEAR if kind == "linear" else OF_GRAPH)}


def damaged(fields: Fields, apply: Callable[[Fields], None], suffix: str) -> bytes:
    """Return the bytes of a file whose content was damaged and then signed again."""
    spoilt = copy.deepcopy(fields)
    apply(spoilt)
    rest = {key: value for key, value in spoilt.items() if key != "sha256"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    spoilt["sha256"] = model_file.hashlib.sha256(text.encode("ascii")).hexdigest()
    return (model_file.as_json if suffix == ".json" else model_file.as_npz)(spoilt)


def made_graph(linear: Fields, seed: int) -> Fields:
    """Return a complete graph document with random layers, on the features of a linear one."""
    rng = np.random.default_rng(seed)
    names = tuple(linear["feature_names"])
    spec = GraphSpec(GRAPHORMER, 16, 4, "relu", "concat", "full", False, NODE_NAMES, names)
    layers = {
        name: (0.5 * rng.normal(size=shape)).tolist() for name, shape in layer_shapes(spec).items()
    }
    n = len(NODE_NAMES)
    scaler = {"lo": [-2.0] * n, "hi": [2.0] * n, "mean": [0.1] * n, "scale": [0.5] * n}
    fields = {key: value for key, value in linear.items() if key not in ("weights", "bias")}
    plain = {key: list(v) if isinstance(v, tuple) else v for key, v in vars(spec).items()}
    fields.update(kind="graph", graph={**plain, "layers": layers, "node_scaler": scaler})
    model = build(fields, "made graph")
    fields["golden"] = [
        {**case, **{name: value.tolist() for name, value in replay(model, case).items()}}
        for case in linear["golden"]
    ]
    fields["sha256"] = model_file.digest(fields)
    return fields


def _entries(data: bytes) -> Dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def _zipped(entries: Dict[str, bytes], how: int = zipfile.ZIP_STORED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", how) as archive:
        for name, content in entries.items():
            archive.writestr(zipfile.ZipInfo(name), content, how)
    return buffer.getvalue()


def _npy(array: Any) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def _with_entry(content: Callable[[bytes], bytes], name: str = "") -> Callable[[bytes], bytes]:
    """Return a damage of one array: the first of the file, or the one named."""

    def apply(data: bytes) -> bytes:
        entries = _entries(data)
        key = name or sorted(set(entries) - {"document.npy"})[0]
        entries[key] = content(entries.get(key, b""))
        return _zipped(entries)

    return apply


def _twice(data: bytes) -> bytes:
    entries = _entries(data)
    first = sorted(entries)[0]
    # As long as the first, so that the bytes of the directory can be put right by name alone.
    entries["#" * len(first)] = entries[first]
    return _zipped(entries).replace(b"#" * len(first), first.encode("ascii"))


def _said_larger(data: bytes) -> bytes:
    """Claim 4 GB for the first entry, in the directory where the sizes are read."""
    spot = data.index(b"PK\x01\x02")
    return data[: spot + 20] + b"\xfe\xff\xff\xff" * 2 + data[spot + 28 :]


OF_NPZ: Dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "cut in half": lambda data: data[: len(data) // 2],
    "its end cut off": lambda data: data[:-1],
    "no zip": lambda data: b"PK\x03\x04" + b"x" * 200,
    "a pickle instead": lambda data: pickle.dumps({"format": "apex-edge-trigger"}),
    "a pickle as an array": _with_entry(lambda _: pickle.dumps([1.0, 2.0])),
    "an object array": _with_entry(lambda _: _npy(np.array([{"a": 1}, None], dtype=object))),
    "an object array as document": _with_entry(
        lambda _: _npy(np.array([{}], dtype=object)), "document.npy"
    ),
    "an array of text": _with_entry(lambda _: _npy(np.array(["a", "b"]))),
    "an array of single floats": _with_entry(lambda _: _npy(np.zeros(4, dtype=np.float32))),
    "an array of complex numbers": _with_entry(lambda _: _npy(np.zeros(4, dtype=complex))),
    "an array with a NaN": _with_entry(lambda _: _npy(np.full((4, 4), np.nan))),
    "an array cut short": _with_entry(lambda content: content[:-8]),
    "an array of a huge shape": _with_entry(
        lambda content: content.replace(b"'shape': (", b"'shape': (9999999, ")
    ),
    "an empty array of many rows": _with_entry(
        lambda _: _npy(np.zeros((0, 0))).replace(b"(0, 0), }", b"(9999999, 0), }")
    ),
    "an array nobody knows": _with_entry(lambda _: _npy(np.zeros(3)), "extra.npy"),
    "a file that is no array": _with_entry(lambda _: b"import os", "setup.py"),
    "a path out of the file": _with_entry(lambda _: _npy(np.zeros(3)), "../../etc/passwd.npy"),
    "no document": lambda data: _zipped(
        {name: content for name, content in _entries(data).items() if name != "document.npy"}
    ),
    "an array left out": lambda data: _zipped(dict(list(_entries(data).items())[1:])),
    "an array twice": _twice,
    "a zip bomb": lambda data: _zipped(
        {**_entries(data), "bomb.npy": b"\0" * 64_000_000}, zipfile.ZIP_DEFLATED
    ),
    "sizes beyond the file": _said_larger,
    "thousands of arrays": lambda data: _zipped({f"{i}.npy": b"" for i in range(5000)}),
    "larger than any model": lambda data: data + b"\0" * model_file.MAX_BYTES,
}
"""Damages of the bytes of a ``.npz``."""

OF_JSON: Dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "cut in half": lambda data: data[: len(data) // 2],
    "no text": lambda data: b"\xff\xfe" + data,
    "a list": lambda data: b"[1, 2]",
    "null": lambda data: b"null",
    "a pickle instead": lambda data: pickle.dumps({"format": "apex-edge-trigger"}),
    "nested without end": lambda data: b"[" * 100_000,
    "nested tables without end": lambda data: b'{"a":' * 100_000,
    "a digit changed": lambda data: data.replace(b'"horizon_s": 5.0', b'"horizon_s": 5.5'),
    "an infinite number": lambda data: data.replace(b'"horizon_s": 5.0', b'"horizon_s": 1e999'),
    "a word for a number": lambda data: data.replace(b'"horizon_s": 5.0', b'"horizon_s": NaN'),
    "a number of 5000 digits": lambda data: data.replace(
        b'"horizon_s": 5.0', b'"horizon_s": ' + b"9" * 5000
    ),
    "larger than any model": lambda data: data + b" " * model_file.MAX_BYTES,
}
"""Damages of the bytes of a ``.json``."""


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Return the bytes with one to eight random changes: set, cut out, put in or moved."""
    spoilt = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        spot, length = int(rng.integers(len(spoilt))), int(rng.integers(1, 9))
        fresh = rng.integers(0, 256, length, dtype=np.uint8).tobytes()
        how = int(rng.integers(4))
        if how == 0:
            spoilt[spot : spot + length] = fresh[: len(spoilt) - spot]
        elif how == 1:
            del spoilt[spot : spot + length]
        elif how == 2:
            spoilt[spot:spot] = fresh
        else:
            other = int(rng.integers(len(spoilt)))
            spoilt[spot : spot + length] = spoilt[other : other + length]
        if not spoilt:
            return b""
    return bytes(spoilt)
