"""Soft labels against hard ones: the same rows, the same linear model, tested on hard truth.

Sizes are training scenes; the smaller ones are the mean over disjoint parts. "half" mixes soft and
hard evenly. On tabletop-pairs the prior of the roll-outs is about right; in MuJoCo scenes nothing
runs on for ever and bodies get into each other's way, so there it is wrong, and says so. Source:
ours.
"""

import time
from typing import Dict, List, NamedTuple, Tuple

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_least, note
from offline_train.scenes import mujoco_table, tabletop_pairs
from offline_train.trigger import seeds
from offline_train.trigger.distill import soft_target
from offline_train.trigger.fit import ROWS_PER_PAIR, fit_rows, thin
from offline_train.trigger.metrics import (
    calibration_error,
    frame_figures,
    probability_figures,
    sigmoid,
)
from offline_train.trigger.observe import Observed, Watching, join, observe
from offline_train.trigger.soft import soften

_SUITE = "soft_labels"
_PART = 25
_TRUTH_SHARES = {"hard": 1.0, "soft": 0.0, "half": 0.5}
_FIGURES = {
    "pr_auc": "PR-AUC",
    "fpr_at_recall_0.99": "FPR at recall .99",
    "ece": "ECE",
    "log_loss": "log-loss",
}


class _Trial(NamedTuple):
    """A scenario, the sizes to train at, and how many scenes to test on."""

    name: str
    sizes: Tuple[int, ...]
    n_test: int
    is_promised: bool


_TRIALS = (
    _Trial(tabletop_pairs.NAME, (50, 100, 400, 800), 3000, True),
    _Trial(mujoco_table.NAME, (25, 75), 75, False),
)


def measure(seed: int) -> List[Line]:
    """Train on soft, hard and mixed labels and say by how much they differ, size by size."""
    lines: List[Line] = []
    for number, trial in enumerate(_TRIALS):
        lines += _run(trial, seed, 10000 * number)
    return lines


def _run(trial: _Trial, seed: int, stream: int) -> List[Line]:
    n_parts = max(trial.sizes) // _PART
    drawn = [
        _watch(trial.name, _PART, seeds.rng("train", seed, stream + number))
        for number in range(n_parts)
    ]
    begin_s = time.process_time()
    parts = [
        soften(part, np.arange(len(part.pair)), seeds.rng("train", seed, stream + 5000 + number))
        for number, part in enumerate(drawn)
    ]
    took_s = time.process_time() - begin_s
    test = _watch(trial.name, trial.n_test, seeds.rng("bench", seed, stream))
    every = join(parts)
    error = calibration_error(every.label, every.soft)
    lines = [
        note(
            _SUITE, f"{trial.name}: rows softened a CPU second", len(every.pair) / took_s, "{:.0f}"
        ),
        note(_SUITE, f"{trial.name}: ECE of the soft labels themselves", error, "{:.3f}"),
    ]
    for size in trial.sizes:
        each = size // _PART
        groups = [join(parts[first : first + each]) for first in range(0, n_parts, each)]
        figures = {
            name: _mean([_scores(group, share, test) for group in groups])
            for name, share in _TRUTH_SHARES.items()
        }
        lines += _lines(trial, size, figures)
    return lines


def _watch(name: str, n: int, random: np.random.Generator) -> Observed:
    """Draw scenes and keep a few frames of each pair."""
    seen = observe(random, name, n, Watching(), TriggerConfig())
    return seen.take(thin(seen.pair, ROWS_PER_PAIR, 0))


def _scores(train: Observed, truth_share: float, test: Observed) -> Dict[str, float]:
    target = soft_target(train.soft, train.label, truth_share)
    model = fit_rows(train.features, target, FEATURE_NAMES)
    logit: Array = model.logit(test.features)
    found = dict(frame_figures(test.label, logit))
    found.update(probability_figures(test.label, sigmoid(logit)))
    return {key: float(found[key] or 0.0) for key in _FIGURES}


def _mean(scores: List[Dict[str, float]]) -> Dict[str, float]:
    return {key: float(np.mean([score[key] for score in scores])) for key in scores[0]}


def _lines(trial: _Trial, size: int, figures: Dict[str, Dict[str, float]]) -> List[Line]:
    lines = []
    for key, name in _FIGURES.items():
        hard, half = figures["hard"][key], figures["half"][key]
        what = f"{trial.name}, {size} scenes: {name} soft (hard {hard:.4f}, half {half:.4f})"
        if key == "pr_auc" and trial.is_promised:
            lines.append(at_least(_SUITE, what, figures["soft"][key], hard, "{:.4f}"))
        else:
            lines.append(note(_SUITE, what, figures["soft"][key], "{:.4f}"))
    return lines
