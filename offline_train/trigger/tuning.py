"""What a sweep of the linear trigger tries and how it scores it."""

from functools import lru_cache
from typing import Any, Tuple

from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import FEATURE_NAMES
from offline_train.extras import module
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import seeds
from offline_train.trigger.fit import ROWS_PER_PAIR, fit_rows, thin
from offline_train.trigger.observe import Observed, Watching, observe

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
    model = fit_rows(train.features, train.label, FEATURE_NAMES, strength, limit_sd)
    metrics = module("sklearn.metrics")
    return float(metrics.average_precision_score(held.label, model.logit(held.features)))


@lru_cache(maxsize=1)
def _split(seed: int, n_scenes: int) -> Tuple[Observed, Observed]:
    """Return a few rows of each pair, of three scenes in four and of the others."""
    rng = seeds.rng("train", seed)
    seen = observe(rng, tabletop_pairs.NAME, n_scenes, Watching(), TriggerConfig())
    seen = seen.take(thin(seen.pair, ROWS_PER_PAIR, seed))
    is_train = seen.scene[seen.pair] < _TRAIN_SHARE * n_scenes
    return seen.take(is_train), seen.take(~is_train)
