"""What a graph model must offer to be trained, evaluated and, if it can be, exported."""

from abc import ABC, abstractmethod
from typing import Dict, NamedTuple, Optional, Tuple

import torch

from apex_edge.triggers.graph_net import GraphSpec
from apex_edge.types import Array


class Batch(NamedTuple):
    """Standardised tensors of any number of graphs, float32.

    ``nodes (N, F)``, ``edges (2, R)`` int64 source -> target, ``edge_features (R, K)``.
    """

    nodes: torch.Tensor
    edges: torch.Tensor
    edge_features: torch.Tensor


class EdgeModel(torch.nn.Module, ABC):
    """A model that gives each edge of a batch a logit."""

    @abstractmethod
    def logits(self, batch: Batch) -> torch.Tensor:
        """Return the logits (R,) of the edges."""

    def forward(self, batch: Batch) -> torch.Tensor:
        """Return the logits (R,); what PyTorch calls."""
        return self.logits(batch)

    def export(self) -> Optional[Tuple[GraphSpec, Dict[str, Array]]]:
        """Return spec and layers for the device, or None for a model the device cannot run."""
        return None
