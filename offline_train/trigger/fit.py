"""Fit the logistic regression on frames of the training scenes."""

from dataclasses import dataclass
from typing import Sequence

import numpy as np

from apex_edge.errors import ApexError
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.types import Array
from offline_train.extras import module
from offline_train.trigger.observe import Observed
from offline_train.trigger.scaling import LIMIT_SD, fitted, spread

# Frames of one approach are alike; a few of each are enough.
ROWS_PER_PAIR = 12


@dataclass(frozen=True)
class LinearFit:
    """A fitted model: logit = ((clip(x) - mean) / scale) @ weight + bias; arrays (k,).

    ``low``, ``high (k,)`` are the training ranges before clipping.
    """

    clip_lo: Array
    clip_hi: Array
    mean: Array
    scale: Array
    weight: Array
    bias: float
    low: Array
    high: Array

    def standardise(self, features: Array) -> Array:
        """Return clipped and scaled features (m, k)."""
        result: Array = (np.clip(features, self.clip_lo, self.clip_hi) - self.mean) / self.scale
        return result

    def logit(self, features: Array) -> Array:
        """Return the logit (m,) of features (m, k)."""
        result: Array = self.standardise(features) @ self.weight + self.bias
        return result


def fit(train: Observed, seed: int) -> LinearFit:
    """Fit to the truth of a few frames of each pair."""
    rows = thin(train.pair, ROWS_PER_PAIR, seed)
    return fit_rows(train.features[rows], train.label[rows], FEATURE_NAMES)


def fit_rows(
    features: Array,
    target: Array,
    names: Sequence[str],
    strength: float = 1.0,
    limit_sd: float = LIMIT_SD,
    solver: str = "lbfgs",
) -> LinearFit:
    """Fit logistic regression without class weights, so that the probability means what it says.

    A soft target counts as a positive with its own weight and as a negative with the rest: soft
    cross-entropy.

    Parameters
    ----------
    features : (m, k), their columns named by ``names``.
    target : (m,) in [0, 1]; hard labels are the special case.
    strength : C, the inverse of the regularisation.
    limit_sd : where z and reach are clipped.
    solver : scikit-learn's; on many columns that are much alike "newton-cholesky" takes a tenth
        of the time.

    Raises
    ------
    MissingExtraError : scikit-learn is not installed.
    ApexError : a target outside [0, 1], or targets that are all 0 or all 1.
    """
    target = target.astype(np.float64)
    if not np.all((target >= 0.0) & (target <= 1.0)):
        n_bad = int(np.count_nonzero(~((target >= 0.0) & (target <= 1.0))))
        raise ApexError(f"{n_bad} of {len(target)} training rows have no label between 0 and 1")
    columns = fitted(features, names, limit_sd)
    weight = np.concatenate([target, 1.0 - target])
    counts = weight > 0.0
    label = np.repeat([True, False], len(target))[counts]
    if label.all() or not label.any():
        raise ApexError("the targets are all alike: there is nothing to tell apart")
    rows = np.tile(np.arange(len(target)), 2)[counts]
    linear = module("sklearn.linear_model")
    model = linear.LogisticRegression(C=strength, solver=solver, max_iter=5000, tol=1e-8)
    model.fit(columns(features)[rows], label, sample_weight=weight[counts])
    low, high = spread(features)
    return LinearFit(
        clip_lo=columns.lo,
        clip_hi=columns.hi,
        mean=columns.mean,
        scale=columns.scale,
        weight=model.coef_[0],
        bias=float(model.intercept_[0]),
        low=low,
        high=high,
    )


def thin(pair: Array, n_each: int, seed: int) -> Array:
    """Return row indices with at most ``n_each`` random rows of each pair, in order."""
    order = np.random.default_rng(seed).permutation(len(pair))
    ranked = order[np.argsort(pair[order], kind="stable")]
    owner = pair[ranked]
    starts = np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]])
    place = np.arange(len(owner)) - np.repeat(starts, np.diff(np.r_[starts, len(owner)]))
    return np.sort(ranked[place < n_each])
