"""The linear trigger: logistic regression on 12 pair features, weights trained off the device.

Source: APEX section "Limitations" (a lightweight linear classifier stands in for the graph network
where PyTorch cannot be installed); features, certificate and fallback are ours.
"""

from pathlib import Path
from typing import Optional, Union

from apex_edge.triggers.base import Evidence, TriggerConfig
from apex_edge.triggers.learnt import LearntTrigger
from apex_edge.triggers.weights import SHIPPED, load_linear
from apex_edge.types import Array


class LinearTrigger(LearntTrigger):
    """Judge pairs by exported weights; outside their domain by the k-sigma rule, flagged.

    Parameters
    ----------
    config : see TriggerConfig; None = defaults.
    weights_path : None = ``config.weights``, and if that is empty the shipped file.

    Raises
    ------
    WeightsError : the weights file is damaged or of another format.
    """

    def __init__(
        self,
        config: Optional[TriggerConfig] = None,
        weights_path: Optional[Union[str, Path]] = None,
    ) -> None:
        chosen = config if config is not None else TriggerConfig()
        self.weights_path = Path(weights_path or chosen.weights or SHIPPED)
        self.weights = load_linear(self.weights_path)
        super().__init__(chosen, self.weights, self.weights_path.name)

    def logit(self, evidence: Evidence, features: Array) -> Array:
        """Return the weighted sum of the features."""
        return self.weights.logit(features)
