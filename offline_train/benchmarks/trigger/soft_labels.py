"""Soft labels against hard ones: the same rows, the same linear model, tested on hard truth.

Sizes are scenes of tabletop-pairs; the smaller ones are the mean over disjoint parts. Source: ours.
"""

import time
from typing import Dict, List, Tuple

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import seeds
from offline_train.trigger.fit import ROWS_PER_PAIR, LinearFit, fit, sklearn_module, thin
from offline_train.trigger.metrics import calibration_error
from offline_train.trigger.observe import Observed, Watching, join, observe
from offline_train.trigger.soft import keep_rows, soften

_SUITE = "soft_labels"
_PART, _N_PARTS, _N_TEST = 25, 32, 3000
_SIZES = (25, 100, 400, 800)
_FEW = 100
_RECALL = 0.99


def measure(seed: int) -> List[Line]:
    """Train on soft and on hard labels and say by how much they differ, size by size."""
    begin_s = time.process_time()
    parts = [_part(seed, number) for number in range(_N_PARTS)]
    rate = sum(len(part.pair) for part in parts) / (time.process_time() - begin_s)
    test = observe(seeds.rng("bench", seed), *_scenes(_N_TEST))
    test = keep_rows(test, thin(test.pair, ROWS_PER_PAIR, 0))
    every = join(parts)
    lines = [
        note(_SUITE, "rows softened with 32 roll-outs each, per CPU second", rate, "{:.0f}"),
        note(
            _SUITE,
            "ECE of the soft labels themselves against what happened",
            calibration_error(every.label, every.soft),
        ),
    ]
    for size in _SIZES:
        each = size // _PART
        groups = [join(parts[a : a + each]) for a in range(0, _N_PARTS, each)]
        hard, soft = (
            _mean([_scores(fit(group, seed, is_soft), test) for group in groups])
            for is_soft in (False, True)
        )
        lines += _compare(size, hard, soft)
    return lines


def _scenes(n: int) -> Tuple[str, int, Watching, TriggerConfig]:
    return tabletop_pairs.NAME, n, Watching(), TriggerConfig()


def _part(seed: int, number: int) -> Observed:
    """Draw one part of the training scenes and soften the rows that a fit learns from."""
    seen = observe(seeds.rng("train", seed, 2 * number), *_scenes(_PART))
    rows = thin(seen.pair, ROWS_PER_PAIR, seed)
    return keep_rows(soften(seen, rows, seeds.rng("train", seed, 2 * number + 1)), rows)


def _scores(model: LinearFit, test: Observed) -> Dict[str, float]:
    metrics = sklearn_module("sklearn.metrics")
    logit, label = model.logit(test.features), test.label
    chance: Array = 1.0 / (1.0 + np.exp(-logit))
    cut = np.sort(logit[label])[int((1.0 - _RECALL) * label.sum())]
    return {
        "PR-AUC": float(metrics.average_precision_score(label, logit)),
        "FPR at recall .99": float(np.mean(logit[~label] >= cut)),
        "ECE": calibration_error(label, chance),
        "log-loss": float(metrics.log_loss(label, np.clip(chance, 1e-6, 1.0 - 1e-6))),
    }


def _mean(scores: List[Dict[str, float]]) -> Dict[str, float]:
    return {key: float(np.mean([score[key] for score in scores])) for key in scores[0]}


def _compare(size: int, hard: Dict[str, float], soft: Dict[str, float]) -> List[Line]:
    """Return the lines of one size; the promise is made for few scenes, the rest informs."""
    lines = []
    for key, value in soft.items():
        what = f"{key}, {size} scenes, soft (hard: {hard[key]:.4f})"
        if key == "PR-AUC":
            lines.append(at_least(_SUITE, what, value, hard[key], "{:.4f}"))
        elif key == "log-loss" and size <= _FEW:
            lines.append(at_most(_SUITE, what, value, hard[key], "{:.4f}"))
        else:
            lines.append(note(_SUITE, what, value, "{:.4f}"))
    return lines
