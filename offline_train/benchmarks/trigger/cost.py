"""What a judgement costs: from ready pairs to the logit, the whole step, and the plain peer.

CPU time of one thread, so that waiting for others is not counted. A shared machine changes its
pace by a factor of two from one moment to the next, so all works take turns over many rounds, and
of each the median block of its best round counts; the yardstick, one numpy call, took its turns
with them. Source: ours; goals in docs/benchmarks.md.
"""

import math
import statistics
import time
from functools import partial
from typing import Callable, List, NamedTuple, Sequence

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
_LINEAR = "linear, pairs to logit, star of {}"
_PLAIN = f"plain formulas, one pair at a time, star of {OBJECTS[-1]}"
_ROUNDS, _REPEATS, _BLOCK = 40, 7, 20
_SHORT_BLOCK = 2


class Work(NamedTuple):
    """Something to be timed: what it is, a call, calls in a block, and the goal in us if any."""

    what: str
    call: Callable[[], object]
    block: int = _BLOCK
    goal_us: float = math.nan


def measure(seed: int) -> List[Line]:
    """Return microseconds per frame of each way to judge."""
    works = _works(rng("bench", seed))
    cost_us = cpu_us(works)
    lines = []
    for work, us in zip(works, cost_us):
        what, text = f"{work.what}, us", "{:.2f}" if us < 10.0 else "{:.1f}"
        if math.isnan(work.goal_us):
            lines.append(note(SUITE, what, us, text))
        else:
            lines.append(at_most(SUITE, what, us, work.goal_us, text))
    plain, ours = (
        next(us for work, us in zip(works, cost_us) if work.what == what)
        for what in (_PLAIN, _LINEAR.format(OBJECTS[-1]))
    )
    lines.append(note(SUITE, "plain formulas over rows, ratio", plain / ours, "{:.1f}"))
    return lines


def cpu_us(works: Sequence[Work]) -> List[float]:
    """Return the CPU time in microseconds that one call of each work takes."""
    best = [math.inf] * len(works)
    for _ in range(_ROUNDS):
        for number, work in enumerate(works):
            took_s = []
            for _ in range(_REPEATS):
                begin_s = time.process_time()
                for _ in range(work.block):
                    work.call()
                took_s.append((time.process_time() - begin_s) / work.block)
            best[number] = min(best[number], 1e6 * statistics.median(took_s))
    return best


def _works(generator: np.random.Generator) -> List[Work]:
    trigger = LinearTrigger()
    works = []
    for n in OBJECTS:
        pairs = random_pairs(generator, n - 1)
        call = partial(_logit, trigger, pairs)
        works.append(Work(_LINEAR.format(n), call, goal_us=GOAL_LINEAR_US))
    works.append(Work(_PLAIN, partial(_plain, pairs), 1))
    slowing = random_pairs(generator, OBJECTS[-1] - 1, slowing_share=0.1)
    what = f"linear, a tenth of the pairs slowing, star of {OBJECTS[-1]}"
    works.append(Work(what, partial(_logit, trigger, slowing), _SHORT_BLOCK))
    for n in OBJECTS:
        call = partial(wide_features, random_windows(generator, n - 1), HORIZON_S)
        works.append(Work(f"wide features, star of {n}", call, _SHORT_BLOCK))
    for n in OBJECTS:
        call = partial(trigger.score, star(generator, n), HORIZON_S)
        works.append(Work(f"whole Trigger.score, {n} objects, one moves", call, _SHORT_BLOCK))
    net = weights.load_graph(weights.SHIPPED_GRAPH).net
    found = stars(random_pairs(generator, GRAPH_OBJECTS - 1), np.zeros(GRAPH_OBJECTS - 1, int))
    features = generator.normal(size=(GRAPH_OBJECTS - 1, len(EDGE_NAMES)))
    call = partial(net.logits, found.nodes, found.edges, features)
    what = f"numpy graph, star of {GRAPH_OBJECTS}, nodes and features at hand"
    works.append(Work(what, call, goal_us=GOAL_GRAPH_US))
    row, other = generator.normal(size=(2, OBJECTS[-1]))
    what = f"yardstick: one product of two rows of {OBJECTS[-1]}"
    works.append(Work(what, partial(np.multiply, row, other)))
    return works


def _logit(trigger: LinearTrigger, pairs: Pairs) -> np.ndarray:
    near = closest(pairs, HORIZON_S)
    return trigger.weights.logit(edge_features(pairs, near, HORIZON_S))


def _plain(pairs: Pairs) -> List[List[float]]:
    rows = []
    for pair in plain_pairs.pairs_in(pairs):
        rows.append(plain_pairs.features(pair, plain_pairs.closest(pair, HORIZON_S), HORIZON_S))
    return rows
