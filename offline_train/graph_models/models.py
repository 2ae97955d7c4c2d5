"""DiffGraphormer, DiffGAT and DiffGCN on PyTorch Geometric's layers, each as a GraphSpec says.

A node encoder, one convolution, a head on both ends of an edge; logits come out, never
probabilities. The names of the layers are those of the exported file.
Source: APEX appendix "DG-Motion Attention"; sizes as in the released code (4641, 1441 and 1377
parameters).
"""

from abc import abstractmethod
from typing import Dict, Optional, Tuple

import torch
from torch.nn import functional
from torch_geometric.nn import GATConv, GCNConv, TransformerConv

from apex_edge.triggers.graph_net import GAT, GCN, GRAPHORMER, GraphSpec
from apex_edge.types import Array
from offline_train.graph_models.base import Batch, EdgeModel
from offline_train.graph_models.specs import full_spec

_ACTIVATIONS = {"none": lambda x: x, "relu": functional.relu, "elu": functional.elu}


class SpecModel(EdgeModel):
    """A model made as its spec says; subclasses add the convolution.

    Parameters
    ----------
    spec : see GraphSpec.
    dropout : share dropped, of attention weights and (with an activation) after the convolution.
    """

    def __init__(self, spec: GraphSpec, dropout: float) -> None:
        super().__init__()
        self.spec = spec
        self.dropout = dropout
        self.node_encoder = torch.nn.Linear(len(spec.node_names), spec.hidden)
        self.edge_encoder: Optional[torch.nn.Linear] = None
        if spec.edge_mode != "none":
            self.edge_encoder = torch.nn.Linear(len(spec.edge_names), spec.hidden)
        self.conv = self._make_conv()
        self.head = torch.nn.Linear(spec.hidden * (1 if spec.head == "sum" else 2), 1)

    def logits(self, batch: Batch) -> torch.Tensor:
        """Return the logits (R,) of the edges."""
        activate = _ACTIVATIONS[self.spec.activation]
        ways, encoded = batch.edges, None
        if self.edge_encoder is not None:
            encoded = self.edge_encoder(batch.edge_features)
        if self.spec.is_bidirectional:
            ways = torch.cat([ways, ways.flip(0)], dim=1)
            encoded = None if encoded is None else torch.cat([encoded, encoded])
        hidden = activate(self.node_encoder(batch.nodes))
        hidden = activate(self._convolve(hidden, ways, encoded))
        if self.spec.activation != "none":
            hidden = functional.dropout(hidden, self.dropout, self.training)
        first, second = hidden[batch.edges[0]], hidden[batch.edges[1]]
        both = first + second if self.spec.head == "sum" else torch.cat([first, second], dim=1)
        return self.head(both)[:, 0]

    def export(self) -> Tuple[GraphSpec, Dict[str, Array]]:
        """Return the spec and the layers (float64), by the names of the state dict."""
        state = self.state_dict()
        return self.spec, {name: value.double().numpy().copy() for name, value in state.items()}

    @abstractmethod
    def _make_conv(self) -> torch.nn.Module:
        """Return the convolution, hidden -> hidden."""

    def _convolve(
        self, hidden: torch.Tensor, ways: torch.Tensor, encoded: Optional[torch.Tensor]
    ) -> torch.Tensor:
        return self.conv(hidden, ways)


class DiffGraphormer(SpecModel):
    """Graph transformer; edge mode "value" is TransformerConv fed edges without its edge_dim."""

    def _make_conv(self) -> torch.nn.Module:
        width, heads = self.spec.hidden, self.spec.heads
        edge_dim = width if self.spec.edge_mode == "full" else None
        return TransformerConv(
            width, width // heads, heads=heads, dropout=self.dropout, edge_dim=edge_dim
        )

    def _convolve(
        self, hidden: torch.Tensor, ways: torch.Tensor, encoded: Optional[torch.Tensor]
    ) -> torch.Tensor:
        if encoded is not None and self.spec.edge_mode == "value":
            encoded = encoded.view(-1, self.spec.heads, self.spec.hidden // self.spec.heads)
        return self.conv(hidden, ways, encoded)


class DiffGAT(SpecModel):
    """Graph attention on the nodes alone."""

    def _make_conv(self) -> torch.nn.Module:
        width, heads = self.spec.hidden, self.spec.heads
        return GATConv(width, width // heads, heads=heads, dropout=self.dropout)


class DiffGCN(SpecModel):
    """Graph convolution on the nodes alone."""

    def _make_conv(self) -> torch.nn.Module:
        return GCNConv(self.spec.hidden, self.spec.hidden)


_CLASSES = {GRAPHORMER: DiffGraphormer, GAT: DiffGAT, GCN: DiffGCN}


def from_spec(spec: GraphSpec, dropout: float) -> SpecModel:
    """Return a fresh model of the spec's architecture."""
    return _CLASSES[spec.architecture](spec, dropout)


def diffgraphormer(
    node_names: Tuple[str, ...], edge_names: Tuple[str, ...], dropout: float
) -> SpecModel:
    """Return the corrected DiffGraphormer; registered as ``diffgraphormer``."""
    return from_spec(full_spec(GRAPHORMER, node_names, edge_names), dropout)


def diffgat(node_names: Tuple[str, ...], edge_names: Tuple[str, ...], dropout: float) -> SpecModel:
    """Return DiffGAT; registered as ``diffgat``."""
    return from_spec(full_spec(GAT, node_names, edge_names), dropout)


def diffgcn(node_names: Tuple[str, ...], edge_names: Tuple[str, ...], dropout: float) -> SpecModel:
    """Return DiffGCN; registered as ``diffgcn``."""
    return from_spec(full_spec(GCN, node_names, edge_names), dropout)
