"""The numpy graph nets against PyTorch Geometric, on random graphs and random weights.

Both read the same weights; what differs is the code and the precision (float64 against PyTorch's
float32 in use, so PyTorch is taken in float64 too and its float32 is noted beside).
"""

from typing import List, Tuple

import numpy as np

from apex_edge.triggers.graph_net import GAT, GCN, GRAPHORMER, GraphNet, GraphSpec
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_most, note
from offline_train.trigger.seeds import rng

SUITE = "parity"
N_GRAPHS = 1000
MAX_NODES = 20
GOAL = 1e-5
_NODE_NAMES = ("is_master", "x", "y", "vx", "vy")
_EDGE_NAMES = ("distance", "cos", "speed")


def variants() -> List[GraphSpec]:
    """Return every kind of net there is: architectures, edge modes, heads, ways, activations."""
    specs: List[GraphSpec] = []
    for architecture in (GRAPHORMER, GAT, GCN):
        modes = ("none", "value", "full") if architecture == GRAPHORMER else ("none",)
        for edge_mode in modes:
            for head in ("sum", "concat"):
                for activation in ("none", "relu", "elu"):
                    for is_both in (False, True):
                        specs.append(
                            GraphSpec(
                                architecture=architecture,
                                hidden=32,
                                heads=4,
                                activation=activation,
                                head=head,
                                edge_mode=edge_mode,
                                is_bidirectional=is_both,
                                node_names=_NODE_NAMES,
                                edge_names=_EDGE_NAMES if edge_mode != "none" else (),
                            )
                        )
    return specs


def random_graph(random: np.random.Generator) -> Tuple[Array, Array, Array]:
    """Return nodes, edges and edge features of a star or complete digraph of 1 to 20 nodes."""
    n_nodes = int(random.integers(1, MAX_NODES + 1))
    if random.random() < 0.5:
        edges = np.stack([np.zeros(n_nodes - 1, dtype=np.int64), np.arange(1, n_nodes)])
    else:
        edges = np.stack(np.nonzero(~np.eye(n_nodes, dtype=bool)))
    nodes = random.normal(size=(n_nodes, len(_NODE_NAMES)))
    return nodes, edges, random.normal(size=(edges.shape[1], len(_EDGE_NAMES)))


def differences(purpose: str, seed: int, n_graphs: int) -> Tuple[float, float]:
    """Return the largest difference of a logit from PyTorch's in float32 and in float64.

    Raises
    ------
    MissingExtraError : PyTorch or PyTorch Geometric is not installed.
    """
    from offline_train.extras import module

    torch = module("torch")
    models = module("offline_train.graph_models.models")
    base = module("offline_train.graph_models.base")
    random = rng(purpose, seed)
    specs = variants()
    worst = {torch.float32: 0.0, torch.float64: 0.0}
    with torch.random.fork_rng(devices=[]), torch.no_grad():
        torch.manual_seed(seed)
        for number in range(n_graphs):
            # fresh weights each time, eval mode: dropout is for training only
            model = models.from_spec(specs[number % len(specs)], 0.3).eval()
            nodes, edges, edge_features = random_graph(random)
            found = GraphNet(*model.export()).logits(nodes, edges, edge_features)
            for kind in worst:
                batch = base.Batch(
                    torch.from_numpy(nodes).to(kind),
                    torch.from_numpy(edges),
                    torch.from_numpy(edge_features).to(kind),
                )
                expected = model.to(kind).logits(batch).double().numpy()
                gap = np.max(np.abs(found - expected), initial=0.0)
                worst[kind] = max(worst[kind], float(gap))
    return worst[torch.float32], worst[torch.float64]


def graph_parity_lines(seed: int) -> List[Line]:
    """Measure on ``N_GRAPHS`` graphs of the bench seed.

    Raises
    ------
    MissingExtraError : PyTorch or PyTorch Geometric is not installed.
    """
    single, double = differences("bench", seed, N_GRAPHS)
    what = f"numpy graph nets against PyTorch, {N_GRAPHS} graphs, largest difference of a logit"
    return [
        at_most(SUITE, what, single, GOAL, "{:.1e}"),
        note(SUITE, "the same with PyTorch in float64", double, "{:.1e}"),
    ]
