"""Graph networks over difference graphs in plain numpy: three architectures, no PyTorch.

A node encoder, one graph convolution, and a head on both ends of each edge. The convolutions mean
what PyTorch Geometric's TransformerConv, GATConv and GCNConv mean (same layer names, no dropout),
so that a trained state dict can be used as it is. float64 throughout.

A finding on the paper's scene graph: when every target has one incoming edge (a star, edges from
the mover outward), the attention softmax is over one element and is exactly 1, whatever the keys
and queries say. Without an activation DiffGraphormer is then an affine function of the features of
the two nodes and of their edge, and is computed as one; "motion attention" adds nothing there.

Source: APEX section "Trigger" (DiffGraphormer, DiffGAT, DiffGCN); layers after Shi et al. 2021
(graph transformer), Velickovic et al. 2018 (GAT), Kipf and Welling 2017 (GCN); folding is ours.
"""

from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Tuple

import numpy as np

from apex_edge.types import Array

GRAPHORMER, GAT, GCN = "diffgraphormer", "diffgat", "diffgcn"
ARCHITECTURES = (GRAPHORMER, GAT, GCN)
ACTIVATIONS = ("none", "relu", "elu")
HEADS = ("sum", "concat")
EDGE_MODES = ("none", "value", "full")
# The paper has 32. Five maps of 256 x 256 still fit in a model file.
MAX_HIDDEN = 256
# Slope of GATConv's leaky ReLU for negative scores, PyTorch Geometric's default.
_LEAK = 0.2


@dataclass(frozen=True)
class GraphSpec:
    """What a graph net is made of; plain values, stored in the model document.

    ``architecture`` "diffgraphormer" | "diffgat" | "diffgcn"; ``hidden`` width, shared by
    ``heads``; ``activation`` "none" | "relu" | "elu", after the node encoder and after the
    convolution; ``head`` "sum" (of both ends) | "concat"; ``edge_mode`` "none" | "value" (the
    encoded edge joins the values only, as in the paper's code) | "full" (keys and values, as
    PyTorch Geometric's edge_dim), DiffGraphormer only; ``is_bidirectional`` adds each edge the
    other way round, with the same features.

    Raises
    ------
    ValueError : a value outside these, or heads that do not divide the width.
    """

    architecture: str
    hidden: int
    heads: int
    activation: str
    head: str
    edge_mode: str
    is_bidirectional: bool
    node_names: Tuple[str, ...]
    edge_names: Tuple[str, ...]

    def __post_init__(self) -> None:
        """Refuse what no net can be made of."""
        choices = (
            ("architecture", ARCHITECTURES),
            ("activation", ACTIVATIONS),
            ("head", HEADS),
            ("edge_mode", EDGE_MODES),
            ("is_bidirectional", (False, True)),
        )
        for name, allowed in choices:
            if getattr(self, name) not in allowed:
                raise ValueError(f"{name} is {getattr(self, name)!r}, expected one of {allowed}")
        for name in ("hidden", "heads"):
            value = getattr(self, name)
            if type(value) is not int or not 1 <= value <= MAX_HIDDEN:
                raise ValueError(f"{name} is {value!r}, expected a whole number 1 to {MAX_HIDDEN}")
        if self.hidden % self.heads:
            raise ValueError(f"{self.heads} heads do not divide a width of {self.hidden}")
        if self.edge_mode != "none" and self.architecture != GRAPHORMER:
            raise ValueError(f"{self.architecture} knows no edges, but edge_mode is not 'none'")
        if not self.node_names or (self.edge_mode != "none" and not self.edge_names):
            raise ValueError("node_names, and edge_names unless edge_mode is 'none', are needed")


def layer_shapes(spec: GraphSpec) -> Dict[str, Tuple[int, ...]]:
    """Return the name and shape of every layer array, as in the state dict of the torch module."""
    width, per_head = spec.hidden, spec.hidden // spec.heads
    shapes: Dict[str, Tuple[int, ...]] = {
        "node_encoder.weight": (width, len(spec.node_names)),
        "node_encoder.bias": (width,),
        "head.weight": (1, width if spec.head == "sum" else 2 * width),
        "head.bias": (1,),
    }
    if spec.architecture == GRAPHORMER:
        for name in ("key", "query", "value", "skip"):
            shapes[f"conv.lin_{name}.weight"] = (width, width)
            shapes[f"conv.lin_{name}.bias"] = (width,)
    else:
        shapes["conv.lin.weight"] = (width, width)
        shapes["conv.bias"] = (width,)
    if spec.architecture == GAT:
        shapes["conv.att_src"] = shapes["conv.att_dst"] = (1, spec.heads, per_head)
    if spec.edge_mode != "none":
        shapes["edge_encoder.weight"] = (width, len(spec.edge_names))
        shapes["edge_encoder.bias"] = (width,)
    if spec.edge_mode == "full":
        shapes["conv.lin_edge.weight"] = (width, width)
    return shapes


@dataclass(frozen=True)
class _Affine:
    """``x @ weight + bias``: weight (inputs, outputs), bias (outputs,)."""

    weight: Array
    bias: Array

    def __call__(self, values: Array) -> Array:
        result: Array = values @ self.weight
        result += self.bias
        return result

    def then(self, other: "_Affine") -> "_Affine":
        """Return this map followed by another as one map."""
        return _Affine(self.weight @ other.weight, other(self.bias))


class GraphNet:
    """A graph net ready to score edges.

    Parameters
    ----------
    spec : see GraphSpec.
    layers : arrays by the names and in the shapes of ``layer_shapes``.

    Raises
    ------
    ValueError : a layer is missing, unknown, of a wrong shape or not finite.
    """

    def __init__(self, spec: GraphSpec, layers: Mapping[str, Array]) -> None:
        self.spec = spec
        self.layers = _checked(spec, layers)
        weight = self.layers["head.weight"][0]
        ends = (weight, weight) if spec.head == "sum" else np.split(weight, 2)
        self._bias = float(self.layers["head.bias"][0])
        self._ends = np.column_stack(ends)
        self._is_affine = spec.activation == "none"
        encoder = self._layer("node_encoder")
        self._encoder: Optional[_Affine] = None if self._is_affine else encoder
        self._edge = self._fold_edge()
        if spec.architecture == GRAPHORMER:
            parts = [self._layer(f"conv.lin_{name}") for name in ("query", "key", "value", "skip")]
        else:
            parts = [self._layer("conv.lin")]
        if self._is_affine:
            parts = [encoder.then(part) for part in parts]
        self._project = _stacked(parts)
        self._has_star = spec.architecture == GRAPHORMER and not spec.is_bidirectional
        if self._has_star:
            self._fold_star(parts[3], parts[2])

    def logits(self, nodes: Array, edges: Array, edge_features: Array) -> Array:
        """Return the logit (R,) of each edge of any batch of graphs.

        Parameters
        ----------
        nodes : (N, F) standardised node features.
        edges : (2, R) node indices, source -> target.
        edge_features : (R, K) standardised; not read when ``edge_mode`` is "none".
        """
        source, target = edges
        if not len(source):
            return np.zeros(0)
        hidden = nodes if self._encoder is None else self._act(self._encoder(nodes))
        if self._has_star and np.bincount(target).max() == 1:
            ends = self._star(hidden, source, target, edge_features)
        else:
            ends = self._act(self._convolve(hidden, source, target, edge_features)) @ self._ends
        logits: Array = ends[source, 0] + ends[target, 1] + self._bias
        return logits

    def _convolve(self, hidden: Array, source: Array, target: Array, edge_features: Array) -> Array:
        """Return the convolution (N, hidden), before the activation."""
        ways = (source, target)
        if self.spec.is_bidirectional:
            ways = np.concatenate([source, target]), np.concatenate([target, source])
        if self.spec.architecture == GAT:
            return self._gat(hidden, *_looped(len(hidden), *ways))
        if self.spec.architecture == GCN:
            return self._gcn(hidden, *_looped(len(hidden), *ways))
        edge = self._edge(edge_features) if self._edge is not None else None
        if edge is not None and self.spec.is_bidirectional:
            edge = np.concatenate([edge, edge])
        return self._transformer(hidden, ways, edge)

    def _star(self, hidden: Array, source: Array, target: Array, edge_features: Array) -> Array:
        """Return the part (N, 2) of the logit as source and as target; one edge per target."""
        out: Array = self._star_skip(hidden)
        message = self._star_value(hidden)[source]
        if self._star_edge is not None:
            message += self._star_edge(edge_features)
        out[target] += message
        ends: Array = out if self._is_affine else self._act(out) @ self._ends
        return ends

    def _transformer(
        self, hidden: Array, ways: Tuple[Array, Array], edge: Optional[Array]
    ) -> Array:
        groups = _Groups(*ways)
        shape = (-1, self.spec.heads, self.spec.hidden // self.spec.heads)
        query, key, value, out = np.split(self._project(hidden), 4, axis=1)
        key, value = key[groups.source], value[groups.source]
        if edge is not None:
            value = value + edge[groups.order]
            key = key + edge[groups.order] if self.spec.edge_mode == "full" else key
        score = (query[groups.target] * key).reshape(shape).sum(axis=2) / np.sqrt(shape[2])
        weighted = value.reshape(shape) * groups.softmax(score)[:, :, None]
        return groups.added_to(out, weighted.reshape(len(key), -1))

    def _gat(self, hidden: Array, source: Array, target: Array) -> Array:
        groups = _Groups(source, target)
        value = self._project(hidden)
        split = value.reshape(-1, self.spec.heads, self.spec.hidden // self.spec.heads)
        as_source = (split * self.layers["conv.att_src"]).sum(axis=2)
        as_target = (split * self.layers["conv.att_dst"]).sum(axis=2)
        raw = as_source[groups.source] + as_target[groups.target]
        share = groups.softmax(np.where(raw > 0.0, raw, _LEAK * raw))
        weighted = split[groups.source] * share[:, :, None]
        start = np.tile(self.layers["conv.bias"], (len(value), 1))
        return groups.added_to(start, weighted.reshape(-1, self.spec.hidden))

    def _gcn(self, hidden: Array, source: Array, target: Array) -> Array:
        groups = _Groups(source, target)
        value = self._project(hidden)
        root = 1.0 / np.sqrt(np.bincount(target, minlength=len(value)))
        share = root[groups.source] * root[groups.target]
        start = np.tile(self.layers["conv.bias"], (len(value), 1))
        return groups.added_to(start, value[groups.source] * share[:, None])

    def _act(self, values: Array) -> Array:
        if self.spec.activation == "none":
            return values
        bent: Array = np.maximum(values, 0.0)
        if self.spec.activation == "elu":
            bent += np.expm1(np.minimum(values, 0.0))
        return bent

    def _layer(self, name: str) -> _Affine:
        weight = self.layers[f"{name}.weight"]
        bias = self.layers.get(f"{name}.bias", np.zeros(len(weight)))
        return _Affine(np.ascontiguousarray(weight.T), bias)

    def _fold_edge(self) -> Optional[_Affine]:
        """Return the map from edge features to what joins keys and values."""
        if self.spec.edge_mode == "none":
            return None
        encoder = self._layer("edge_encoder")
        if self.spec.edge_mode == "full":
            return encoder.then(self._layer("conv.lin_edge"))
        return encoder

    def _fold_star(self, skip: _Affine, value: _Affine) -> None:
        """Prepare the maps of ``_star``; without an activation the head goes in as well."""
        self._star_skip, self._star_value, self._star_edge = skip, value, self._edge
        if self._is_affine:
            head = _Affine(self._ends, np.zeros(2))
            self._star_skip, self._star_value = skip.then(head), value.then(head)
            self._star_edge = None if self._edge is None else self._edge.then(head)


class _Groups:
    """Edges sorted by target, so that sums and maxima per target are runs of a sorted array."""

    def __init__(self, source: Array, target: Array) -> None:
        self.order = np.argsort(target, kind="stable")
        self.source, self.target = source[self.order], target[self.order]
        is_first = np.concatenate([[True], self.target[1:] != self.target[:-1]])
        self._starts = np.flatnonzero(is_first)
        self._owner = np.cumsum(is_first) - 1

    def softmax(self, score: Array) -> Array:
        """Return the share (E, heads) of each edge among those of its target."""
        top = np.maximum.reduceat(score, self._starts)
        raised = np.exp(score - top[self._owner])
        share: Array = raised / np.add.reduceat(raised, self._starts)[self._owner]
        return share

    def added_to(self, out: Array, messages: Array) -> Array:
        """Add the messages (E, hidden) of each target to its row of ``out`` and return it."""
        out[self.target[self._starts]] += np.add.reduceat(messages, self._starts)
        return out


def _looped(n_nodes: int, source: Array, target: Array) -> Tuple[Array, Array]:
    """Return the edges with exactly one self-loop per node, as GATConv and GCNConv make them."""
    others, every = source != target, np.arange(n_nodes)
    return np.concatenate([source[others], every]), np.concatenate([target[others], every])


def _stacked(parts: List[_Affine]) -> _Affine:
    """Return several maps of one input as one map, outputs side by side."""
    return _Affine(
        np.concatenate([part.weight for part in parts], axis=1),
        np.concatenate([part.bias for part in parts]),
    )


def _checked(spec: GraphSpec, layers: Mapping[str, Array]) -> Dict[str, Array]:
    shapes = layer_shapes(spec)
    missing, unknown = sorted(set(shapes) - set(layers)), sorted(set(layers) - set(shapes))
    if missing or unknown:
        raise ValueError(f"layers: missing {missing}, unknown {unknown}")
    checked = {name: np.array(layers[name], dtype=np.float64) for name in shapes}
    for name, array in checked.items():
        if array.shape != shapes[name]:
            raise ValueError(f"layer {name} has shape {array.shape}, expected {shapes[name]}")
        if not np.isfinite(array).all():
            raise ValueError(f"layer {name} holds a number that is not finite")
    return checked
