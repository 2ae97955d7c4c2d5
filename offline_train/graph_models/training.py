"""Train a graph model on edges with hard or soft labels; same seed, same weights."""

import contextlib
from dataclasses import dataclass
from typing import Callable, Iterator, List, Optional, Tuple

import numpy as np
import torch
from torch.nn import functional

from apex_edge.types import Array
from offline_train.graph_models.base import Batch, EdgeModel
from offline_train.graph_models.batches import Graphs, batches
from offline_train.graph_models.fitted import GraphFit, from_layers, standardised
from offline_train.trigger.scaling import fitted, identity


@dataclass(frozen=True)
class Options:
    """How to train.

    ``is_balanced`` weighs positives by (1 - pi) / pi, pi their share (the probability then no
    longer means what it says); ``is_sigmoid_inside`` feeds sigmoid(logit) to a loss that expects
    logits, the released code's fault, for its reproduction only.
    """

    seed: int
    n_epochs: int = 15
    batch_size: int = 32
    learning_rate: float = 1e-3
    is_balanced: bool = False
    is_standardised: bool = True
    is_sigmoid_inside: bool = False


def fit(
    make: Callable[[], EdgeModel],
    graphs: Graphs,
    options: Options,
    on_epoch: Optional[Callable[[], None]] = None,
) -> GraphFit:
    """Train a fresh model on graphs and return it, ready to score.

    Parameters
    ----------
    make : returns the untrained model; its random numbers are seeded here.
    on_epoch : called after each epoch, for a progress line.
    """
    with _deterministic(options.seed):
        model = make()
        exported = model.export()
        n_columns = graphs.edge_features.shape[1]
        if exported is not None:
            n_columns = len(exported[0].edge_names)
        edge_features = graphs.edge_features[:, :n_columns]
        node_scaler, edge_scaler = identity(graphs.nodes.shape[1]), identity(n_columns)
        if options.is_standardised:
            node_scaler = fitted(graphs.nodes, graphs.node_names)
            edge_scaler = fitted(edge_features, graphs.edge_names[:n_columns])
        scaled = standardised(graphs, node_scaler, edge_scaler)
        _optimise(model, scaled, options, on_epoch)
        exported = model.export()
    if exported is not None:
        return from_layers(exported[0], exported[1], node_scaler, edge_scaler)
    return GraphFit(None, None, node_scaler, edge_scaler, _scorer(model))


def tensors(graphs: Graphs) -> Tuple[Batch, torch.Tensor]:
    """Return standardised graphs as one batch and its labels (R,), float32."""
    batch = Batch(
        torch.from_numpy(graphs.nodes).float(),
        torch.from_numpy(np.ascontiguousarray(graphs.edges)),
        torch.from_numpy(graphs.edge_features).float(),
    )
    return batch, torch.from_numpy(graphs.labels).float()


def _optimise(
    model: EdgeModel, graphs: Graphs, options: Options, on_epoch: Optional[Callable[[], None]]
) -> None:
    random = np.random.default_rng(options.seed)
    optimiser = torch.optim.Adam(model.parameters(), lr=options.learning_rate, fused=True)
    weight = torch.tensor(_positive_weight(graphs.labels)) if options.is_balanced else None
    # single graphs are cut out once: at batch size 1 the cutting would cost as much as the step
    singles: List[Tuple[Batch, torch.Tensor]] = []
    if options.batch_size == 1:
        singles = [tensors(graphs.take(np.array([row]))) for row in range(len(graphs))]
    model.train()
    for _ in range(options.n_epochs):
        for rows in batches(len(graphs), options.batch_size, random):
            batch, labels = singles[rows[0]] if singles else tensors(graphs.take(rows))
            score = model.logits(batch)
            if options.is_sigmoid_inside:
                score = torch.sigmoid(score)
            loss = functional.binary_cross_entropy_with_logits(score, labels, pos_weight=weight)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        if on_epoch is not None:
            on_epoch()
    model.eval()


def _positive_weight(labels: Array) -> float:
    share = float(np.mean(labels))
    return (1.0 - share) / share if share > 0.0 else 1.0


def _scorer(model: EdgeModel) -> Callable[[Graphs], Array]:
    def score(graphs: Graphs) -> Array:
        with torch.no_grad():
            return model.logits(tensors(graphs)[0]).double().numpy()

    return score


@contextlib.contextmanager
def _deterministic(seed: int) -> Iterator[None]:
    """Seed PyTorch, on one thread, and leave its state as it was."""
    n_threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            yield
    finally:
        torch.set_num_threads(n_threads)
