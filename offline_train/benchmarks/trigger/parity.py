"""Equal answers from trainer and device, and from torch and numpy.

Source: ours; goals in docs/benchmarks.md.
"""

from typing import List

from offline_train.benchmarks.lines import Line
from offline_train.benchmarks.trigger.feature_parity import feature_parity_lines
from offline_train.benchmarks.trigger.graph_parity import graph_parity_lines


def measure(seed: int) -> List[Line]:
    """Return the largest differences."""
    return feature_parity_lines(seed) + graph_parity_lines(seed)
