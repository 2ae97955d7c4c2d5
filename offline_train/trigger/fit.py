"""Fit the logistic regression on frames of the training scenes."""

import importlib
from dataclasses import dataclass
from typing import Any, Sequence

import numpy as np

from apex_edge.errors import ApexError
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.types import Array
from offline_train.trigger.observe import Observed

# Frames of one approach are alike; a few of each are enough.
ROWS_PER_PAIR = 12
_LIMIT_SD = 4.0


class MissingExtraError(ApexError):
    """Name the extra to install for work that is done off the device."""

    slug = "missing-extra"


@dataclass(frozen=True)
class LinearFit:
    """A fitted model: logit = ((clip(x) - mean) / scale) @ weight + bias; arrays (12,).

    ``low``, ``high (12,)`` are the training ranges before clipping.
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
        """Return clipped and scaled features (m, 12)."""
        result: Array = (np.clip(features, self.clip_lo, self.clip_hi) - self.mean) / self.scale
        return result

    def logit(self, features: Array) -> Array:
        """Return the logit (m,) of features (m, 12)."""
        result: Array = self.standardise(features) @ self.weight + self.bias
        return result


def sklearn_module(name: str) -> Any:
    """Import a scikit-learn module late, so that nothing else needs it.

    Raises
    ------
    MissingExtraError : scikit-learn is not installed; says what to type.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"training needs scikit-learn, which is not here ({error}); "
            "install it on a workstation with: pip install 'apex-edge[train]'"
        ) from error


def fit(train: Observed, seed: int) -> LinearFit:
    """Fit without class weights, so that the probability means what it says."""
    rows = thin(train.pair, ROWS_PER_PAIR, seed)
    return fit_rows(train.features[rows], train.label[rows], FEATURE_NAMES)


def fit_rows(
    features: Array, label: Array, names: Sequence[str], solver: str = "lbfgs"
) -> LinearFit:
    """Fit to rows (m, k) whose columns have these names, all of them with the same weight.

    ``solver`` is scikit-learn's; on many columns that are much alike "newton-cholesky" takes a
    tenth of the time.
    """
    clip_lo, clip_hi = features.min(axis=0), features.max(axis=0)
    for name in ("z", "reach", "z_pos", "reach_pos"):
        if name in names:
            column = names.index(name)
            clip_lo[column] = max(clip_lo[column], -_LIMIT_SD)
            clip_hi[column] = min(clip_hi[column], _LIMIT_SD)
    clipped = np.clip(features, clip_lo, clip_hi)
    mean, scale = clipped.mean(axis=0), clipped.std(axis=0)
    # A column that never changes says nothing.
    scale = np.where(scale > 0.0, scale, 1.0)
    linear = sklearn_module("sklearn.linear_model")
    model = linear.LogisticRegression(solver=solver, max_iter=5000, tol=1e-8)
    model.fit((clipped - mean) / scale, label)
    return LinearFit(
        clip_lo=clip_lo,
        clip_hi=clip_hi,
        mean=mean,
        scale=scale,
        weight=model.coef_[0],
        bias=float(model.intercept_[0]),
        low=features.min(axis=0),
        high=features.max(axis=0),
    )


def thin(pair: Array, n_each: int, seed: int) -> Array:
    """Return row indices with at most ``n_each`` random rows of each pair, in order."""
    order = np.random.default_rng(seed).permutation(len(pair))
    ranked = order[np.argsort(pair[order], kind="stable")]
    owner = pair[ranked]
    starts = np.flatnonzero(np.r_[True, owner[1:] != owner[:-1]])
    place = np.arange(len(owner)) - np.repeat(starts, np.diff(np.r_[starts, len(owner)]))
    return np.sort(ranked[place < n_each])
