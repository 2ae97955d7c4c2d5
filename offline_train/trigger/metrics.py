"""Figures and curves of one score over labelled frames, in plain numpy.

Ties count as one threshold, so that a score that saturates is not flattered. Source: ours; the
definitions are those of scikit-learn, which the tests hold them to.
"""

from typing import Any, Dict, NamedTuple, Optional

import numpy as np

from apex_edge.types import Array

N_BINS = 15
RECALLS = (0.90, 0.95, 0.99)
# More points than a plot or a report can show.
MAX_POINTS = 200
_TINY = 1e-12


class Sweep(NamedTuple):
    """Counts (t,) of true and false alarms at each distinct threshold, the highest first."""

    n_true: Array
    n_false: Array


def sweep(label: Array, score: Array) -> Sweep:
    """Count alarms at each distinct score; ``label (r,)`` bool, ``score (r,)`` without NaN."""
    order = np.argsort(-score, kind="stable")
    ranked = score[order]
    last = np.flatnonzero(np.r_[ranked[1:] != ranked[:-1], True])
    n_true = np.cumsum(label[order])[last]
    return Sweep(n_true, last + 1 - n_true)


def frame_figures(label: Array, score: Array) -> Dict[str, Optional[float]]:
    """Return ``pr_auc`` (average precision), ``roc_auc`` and ``fpr_at_recall_*`` of a score.

    None where the labels are all alike: nothing can be said then.
    """
    n_positive, n_negative = int(np.sum(label)), int(np.sum(~label))
    names = ["pr_auc", "roc_auc"] + [f"fpr_at_recall_{recall:.2f}" for recall in RECALLS]
    if not n_positive or not n_negative:
        return dict.fromkeys(names)
    counts = sweep(label, score)
    recall = counts.n_true / n_positive
    fpr = counts.n_false / n_negative
    precision = counts.n_true / (counts.n_true + counts.n_false)
    steps = np.diff(np.r_[0.0, recall])
    area = np.diff(np.r_[0.0, fpr]) * (np.r_[0.0, recall[:-1]] + recall) / 2.0
    found = [float(np.sum(steps * precision)), float(np.sum(area))]
    # A rounding error must not ask for one more positive than the recall does.
    found += [float(fpr[np.argmax(recall >= goal - _TINY)]) for goal in RECALLS]
    return dict(zip(names, found))


def probability_figures(label: Array, probability: Array) -> Dict[str, float]:
    """Return ``ece`` over 15 equal bins, ``brier`` and ``log_loss`` (nats) of a probability."""
    sure = np.clip(probability, _TINY, 1.0 - _TINY)
    loss = -np.where(label, np.log(sure), np.log1p(-sure))
    return {
        "ece": calibration_error(label, probability),
        "brier": float(np.mean((probability - label) ** 2)),
        "log_loss": float(np.mean(loss)),
    }


def calibration_error(label: Array, probability: Array) -> float:
    """Return the expected calibration error over 15 equal bins."""
    bins = _bins(probability)
    gap = np.bincount(bins, weights=probability - label, minlength=N_BINS)
    return float(np.abs(gap).sum() / len(label))


def curves(label: Array, score: Array) -> Dict[str, Any]:
    """Return ``pr`` (recall, precision) and ``roc`` (fpr, recall) as lists of few points."""
    counts = sweep(label, score)
    n_positive, n_negative = max(int(np.sum(label)), 1), max(int(np.sum(~label)), 1)
    recall, fpr = counts.n_true / n_positive, counts.n_false / n_negative
    precision = counts.n_true / (counts.n_true + counts.n_false)
    few = _few(recall, fpr)
    return {
        "pr": {"recall": recall[few].tolist(), "precision": precision[few].tolist()},
        "roc": {"fpr": [0.0] + fpr[few].tolist(), "recall": [0.0] + recall[few].tolist()},
    }


def reliability(label: Array, probability: Array) -> Dict[str, Any]:
    """Return per used bin the mean ``said``, the share that ``came`` true and ``n`` frames."""
    bins = _bins(probability)
    n = np.bincount(bins, minlength=N_BINS)
    used = n > 0
    said = np.bincount(bins, weights=probability, minlength=N_BINS)[used] / n[used]
    came = np.bincount(bins, weights=label.astype(float), minlength=N_BINS)[used] / n[used]
    return {"said": said.tolist(), "came": came.tolist(), "n": n[used].tolist()}


def _bins(probability: Array) -> Array:
    bins: Array = np.minimum((probability * N_BINS).astype(int), N_BINS - 1)
    return bins


def _few(recall: Array, fpr: Array) -> Array:
    """Choose at most ``MAX_POINTS`` thresholds, evenly along the way the ROC curve goes."""
    way = recall + fpr
    wanted = np.searchsorted(way, np.linspace(way[0], way[-1], MAX_POINTS))
    few: Array = np.unique(np.minimum(wanted, len(way) - 1))
    return few


def sigmoid(logit: Array) -> Array:
    """Return the probability (r,) of logits (r,), without overflow."""
    chance: Array = 0.5 * (1.0 + np.tanh(0.5 * logit))
    return chance
