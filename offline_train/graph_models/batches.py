"""Graphs of any size as flat arrays, and batches cut from them."""

from dataclasses import dataclass
from typing import Iterator, Tuple

import numpy as np

from apex_edge.types import Array
from offline_train.scenes.star import EDGE_NAMES, NODE_NAMES, StarSet


@dataclass(frozen=True)
class Graphs:
    """g graphs with N nodes and R edges in all.

    ``nodes (N, F)``; ``edges (2, R)`` source -> target, counted over all nodes;
    ``edge_features (R, K)``; ``labels (R,)`` in [0, 1], hard or soft; the nodes of graph i are
    ``node_start[i]:node_start[i + 1]``, its edges ``edge_start[i]:edge_start[i + 1]``;
    ``node_names``, ``edge_names`` of the F and K features.
    """

    nodes: Array
    edges: Array
    edge_features: Array
    labels: Array
    node_start: Array
    edge_start: Array
    node_names: Tuple[str, ...]
    edge_names: Tuple[str, ...]

    def __len__(self) -> int:
        return len(self.node_start) - 1

    def take(self, graphs: Array) -> "Graphs":
        """Return the graphs of these indices as a set of their own, in this order."""
        n_nodes = np.diff(self.node_start)[graphs]
        n_edges = np.diff(self.edge_start)[graphs]
        node_start = np.r_[0, np.cumsum(n_nodes)]
        rows = _spans(self.node_start[graphs], n_nodes)
        edge_rows = _spans(self.edge_start[graphs], n_edges)
        shift = np.repeat(node_start[:-1] - self.node_start[graphs], n_edges)
        return Graphs(
            nodes=self.nodes[rows],
            edges=self.edges[:, edge_rows] + shift,
            edge_features=self.edge_features[edge_rows],
            labels=self.labels[edge_rows],
            node_start=node_start,
            edge_start=np.r_[0, np.cumsum(n_edges)],
            node_names=self.node_names,
            edge_names=self.edge_names,
        )


def batches(n_graphs: int, size: int, random: np.random.Generator) -> Iterator[Array]:
    """Yield the indices of all graphs once, shuffled, ``size`` at a time."""
    order = random.permutation(n_graphs)
    for begin in range(0, n_graphs, size):
        yield order[begin : begin + size]


def star_graphs(
    stars: StarSet, labels: Array, edge_features: Array, edge_names: Tuple[str, ...] = EDGE_NAMES
) -> Graphs:
    """Return stars as graphs, edges master -> target.

    Parameters
    ----------
    labels : (g, n - 1); edge_features : (g, n - 1, K) or (g * (n - 1), K).
    """
    n_graphs, n_nodes = stars.node_t.shape[:2]
    first = n_nodes * np.arange(n_graphs)
    target = (first[:, None] + np.arange(1, n_nodes)).ravel()
    n_edges = len(target)
    return Graphs(
        nodes=stars.node_t.reshape(n_graphs * n_nodes, -1),
        edges=np.stack([np.repeat(first, n_nodes - 1), target]),
        edge_features=edge_features.reshape(n_edges, -1),
        labels=labels.reshape(n_edges).astype(np.float64),
        node_start=n_nodes * np.arange(n_graphs + 1),
        edge_start=(n_nodes - 1) * np.arange(n_graphs + 1),
        node_names=NODE_NAMES,
        edge_names=edge_names,
    )


def _spans(starts: Array, lengths: Array) -> Array:
    """Return start, start + 1, ... of each span, one after the other."""
    ends = np.cumsum(lengths)
    total = int(ends[-1]) if len(ends) else 0
    return np.arange(total) + np.repeat(starts - (ends - lengths), lengths)
