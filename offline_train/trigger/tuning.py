"""What a sweep of the linear trigger tries and how it scores it."""

from dataclasses import replace
from functools import lru_cache
from typing import Any, Tuple

from apex_edge.triggers.base import TriggerConfig
from apex_edge.types import Array
from offline_train.trigger.fit import ROWS_PER_SCENE, fit, sklearn_module, thin
from offline_train.trigger.observe import Observed, observe

STRENGTH = (1e-3, 1e3)
"""Range of C, the inverse of the regularisation, on a log scale."""
LIMIT_SD = (2.0, 12.0)
"""Range of the clip of z and reach."""
_TRAIN_SHARE = 0.75


def linear_pr_auc(trial: Any, seed: int, n_scenes: int) -> float:
    """Fit with the settings of an optuna trial; return PR-AUC on held-out training scenes.

    All scenes come from the training seed and are split by scene: those of calibration, test and
    bench must not steer a setting.

    Raises
    ------
    MissingExtraError : scikit-learn is not installed.
    """
    strength = trial.suggest_float("strength", *STRENGTH, log=True)
    limit_sd = trial.suggest_float("limit_sd", *LIMIT_SD)
    train, held = _split(seed, n_scenes)
    model = fit(train, seed, strength, limit_sd)
    rows = thin(held.scene, ROWS_PER_SCENE, seed)
    metrics = sklearn_module("sklearn.metrics")
    return float(
        metrics.average_precision_score(held.label[rows], model.logit(held.features[rows]))
    )


@lru_cache(maxsize=1)
def _split(seed: int, n_scenes: int) -> Tuple[Observed, Observed]:
    # the pipeline's training seed; the three after it are those of calibration and tests
    seen = observe(4 * seed, n_scenes, TriggerConfig())
    is_train = seen.scene < _TRAIN_SHARE * n_scenes
    return _take(seen, is_train), _take(seen, ~is_train)


def _take(seen: Observed, rows: Array) -> Observed:
    """Return what a fit looks at (scene, features, label) for some rows."""
    return replace(
        seen, scene=seen.scene[rows], features=seen.features[rows], label=seen.label[rows]
    )
