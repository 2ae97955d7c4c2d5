"""What a judgement costs: from ready pairs to the logit, the whole step, and the plain peer.

CPU time of one thread, so that waiting for others is not counted; the median of many repeats, and
of five such medians the smallest, since another process on the same core can only add. The ratio
to the plain formulas, taken side by side, does not change with the machine.
Source: ours; goals in docs/benchmarks.md.
"""

import time
from typing import Callable, List

import numpy as np

from apex_edge.triggers import weights
from apex_edge.triggers.approach import Pairs, closest
from apex_edge.triggers.features import FEATURE_NAMES as EDGE_NAMES
from apex_edge.triggers.features import edge_features
from apex_edge.triggers.linear import LinearTrigger
from apex_edge.triggers.stars import stars
from apex_edge.triggers.wide import wide_features
from offline_train.benchmarks.lines import Line, at_most, note
from offline_train.benchmarks.trigger import plain_pairs
from offline_train.benchmarks.trigger.pair_cases import (
    HORIZON_S,
    random_pairs,
    random_windows,
    star,
)
from offline_train.trigger.seeds import rng

SUITE = "cost"
OBJECTS = (2, 6, 10, 20, 50)
GOAL_LINEAR_US = 40.0
GRAPH_OBJECTS = 6
GOAL_GRAPH_US = 60.0
_ROUNDS, _REPEATS, _BLOCK = 5, 21, 20
_SHORT_BLOCK = 2


def measure(seed: int) -> List[Line]:
    """Return microseconds per frame of each way to judge."""
    generator = rng("bench", seed)
    trigger = LinearTrigger()
    lines = []
    for n_objects in OBJECTS:
        pairs = random_pairs(generator, n_objects - 1)
        cost_us = cpu_us(lambda p=pairs: _logit(trigger, p))
        what = f"linear, pairs to logit, star of {n_objects}, us"
        lines.append(at_most(SUITE, what, cost_us, GOAL_LINEAR_US, "{:.1f}"))
    plain_us = cpu_us(lambda p=pairs: _plain(p), 1)
    what = f"plain formulas, one pair at a time, star of {n_objects}, us"
    lines.append(note(SUITE, what, plain_us, "{:.0f}"))
    lines.append(note(SUITE, "plain formulas over rows, ratio", plain_us / cost_us, "{:.1f}"))
    slowing = random_pairs(generator, OBJECTS[-1] - 1, slowing_share=0.1)
    what = f"linear, a tenth of the pairs slowing, star of {OBJECTS[-1]}, us"
    lines.append(note(SUITE, what, cpu_us(lambda: _logit(trigger, slowing)), "{:.1f}"))
    for n_objects in OBJECTS:
        windows = random_windows(generator, n_objects - 1)
        what = f"wide features, star of {n_objects}, us"
        cost_us = cpu_us(lambda w=windows: wide_features(w, HORIZON_S), _SHORT_BLOCK)
        lines.append(note(SUITE, what, cost_us, "{:.0f}"))
    for n_objects in OBJECTS:
        diff = star(generator, n_objects)
        what = f"whole Trigger.score, {n_objects} objects, one moves, us"
        cost_us = cpu_us(lambda d=diff: trigger.score(d, HORIZON_S), _SHORT_BLOCK)
        lines.append(note(SUITE, what, cost_us, "{:.0f}"))
    lines.append(_graph_line(generator))
    row, other = generator.normal(size=(2, OBJECTS[-1]))
    what = f"yardstick: one product of two rows of {OBJECTS[-1]}, us"
    lines.append(note(SUITE, what, cpu_us(lambda: row * other), "{:.2f}"))
    return lines


def _graph_line(generator: np.random.Generator) -> Line:
    """Return what the shipped net takes for one star, nodes and features at hand."""
    net = weights.load_graph(weights.SHIPPED_GRAPH).net
    pairs = random_pairs(generator, GRAPH_OBJECTS - 1)
    found = stars(pairs, np.zeros(GRAPH_OBJECTS - 1, dtype=np.int64))
    features = generator.normal(size=(GRAPH_OBJECTS - 1, len(EDGE_NAMES)))
    cost_us = cpu_us(lambda: net.logits(found.nodes, found.edges, features))
    what = f"numpy graph, star of {GRAPH_OBJECTS}, us"
    return at_most(SUITE, what, cost_us, GOAL_GRAPH_US, "{:.1f}")


def cpu_us(work: Callable[[], object], block: int = _BLOCK) -> float:
    """Return the CPU time in microseconds that one call takes: the least of five medians."""
    work()
    medians = []
    for _ in range(_ROUNDS):
        took_s = []
        for _ in range(_REPEATS):
            begin_s = time.process_time()
            for _ in range(block):
                work()
            took_s.append((time.process_time() - begin_s) / block)
        medians.append(float(np.median(took_s)))
    return 1e6 * min(medians)


def _logit(trigger: LinearTrigger, pairs: Pairs) -> np.ndarray:
    near = closest(pairs, HORIZON_S)
    return trigger.weights.logit(edge_features(pairs, near, HORIZON_S))


def _plain(pairs: Pairs) -> List[List[float]]:
    rows = []
    for pair in plain_pairs.pairs_in(pairs):
        rows.append(plain_pairs.features(pair, plain_pairs.closest(pair, HORIZON_S), HORIZON_S))
    return rows
