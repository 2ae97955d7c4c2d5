"""The graph trigger: a trained graph net over the star of each mover, in plain numpy.

Source: APEX section "Trigger" (motion attention over the difference graph); node and edge features,
certificate and fallback are ours.
"""

from pathlib import Path
from typing import Optional, Union

from apex_edge.triggers.base import Evidence, TriggerConfig
from apex_edge.triggers.learnt import LearntTrigger
from apex_edge.triggers.weights import SHIPPED_GRAPH, load_graph
from apex_edge.types import Array


class GraphTrigger(LearntTrigger):
    """Judge pairs by a trained graph net; outside its domain by the k-sigma rule, flagged.

    Parameters
    ----------
    config : see TriggerConfig; None = defaults.
    weights_path : None = ``config.weights``, and if that is empty the shipped file.

    Raises
    ------
    WeightsError : the model file is missing, damaged, or of another format or kind.
    """

    def __init__(
        self,
        config: Optional[TriggerConfig] = None,
        weights_path: Optional[Union[str, Path]] = None,
    ) -> None:
        config = config if config is not None else TriggerConfig()
        self.weights_path = Path(weights_path or config.weights or SHIPPED_GRAPH)
        self.weights = load_graph(self.weights_path)
        super().__init__(config, self.weights, self.weights_path.name)

    def logit(self, evidence: Evidence, features: Array) -> Array:
        """Return the logit (m,) of m pairs, the stars of all movers in one batch.

        A star holds the pairs that are judged: those that can touch. A bidirectional net, in which
        targets hear of each other, must be trained on the same.
        """
        return self.weights.logit(features, evidence.pairs, evidence.mover_id)
