"""A trained graph model: scaling, weights and how to score graphs with it. No PyTorch here."""

from dataclasses import dataclass, replace
from typing import Callable, Dict, Optional

from apex_edge.triggers.graph_net import GraphNet, GraphSpec
from apex_edge.triggers.models import Columns
from apex_edge.types import Array
from offline_train.graph_models.batches import Graphs


@dataclass(frozen=True)
class GraphFit:
    """A trained model; ``spec`` and ``layers`` are None when the device cannot run it.

    ``node_scaler``, ``edge_scaler`` standardise before the model; ``score`` maps standardised
    graphs to logits (R,), on numpy where the model could be exported.
    """

    spec: Optional[GraphSpec]
    layers: Optional[Dict[str, Array]]
    node_scaler: Columns
    edge_scaler: Columns
    score: Callable[[Graphs], Array]

    def logit(self, graphs: Graphs) -> Array:
        """Return the logit (R,) of each edge of graphs that are not yet standardised."""
        return self.score(standardised(graphs, self.node_scaler, self.edge_scaler))


def from_layers(
    spec: GraphSpec, layers: Dict[str, Array], node_scaler: Columns, edge_scaler: Columns
) -> GraphFit:
    """Return the model that these layers make; it runs on numpy alone.

    Raises
    ------
    ValueError : layers that do not fit the spec.
    """
    net = GraphNet(spec, layers)

    def score(graphs: Graphs) -> Array:
        return net.logits(graphs.nodes, graphs.edges, graphs.edge_features)

    return GraphFit(spec, net.layers, node_scaler, edge_scaler, score)


def standardised(graphs: Graphs, node_scaler: Columns, edge_scaler: Columns) -> Graphs:
    """Return the graphs with scaled features; a model without edges (0 columns) gets none."""
    n_columns = len(edge_scaler.mean)
    return replace(
        graphs,
        nodes=node_scaler(graphs.nodes),
        edge_features=edge_scaler(graphs.edge_features[:, :n_columns]),
        edge_names=graphs.edge_names[:n_columns],
    )
