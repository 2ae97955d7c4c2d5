"""Scores that every report prints beside a model: what is to be beaten, and the ceiling.

Each takes ``Observed`` rows and returns a score (r,), higher = more dangerous. A model that does
not clearly beat the first three has learnt nothing of its own. Source: ours, but ``paper_risk``.
"""

import numpy as np

from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.types import Array
from offline_train.extras import module
from offline_train.scenes.star import risk_score
from offline_train.trigger.observe import Observed

_TINY = 1e-12


def speed_only(seen: Observed) -> Array:
    """Return the mover's measured speed (r,) in m/s, the rule that solves the paper's own set."""
    return seen.speed_m_s


def analytic(seen: Observed) -> Array:
    """Return by how many sd the closest approach lies inside the radius (r,): the k-sigma rule."""
    z: Array = seen.features[:, FEATURE_NAMES.index("z")]
    return z


def paper_risk(seen: Observed) -> Array:
    """Return the paper's risk (r,) of the other body towards the centre, sign and speed put right.

    The released code has the sign of the cosine wrong and takes a displacement for the speed; here
    is what the text means: distance, heading and speed of the other body, whatever the centre does.
    Metres and m/s stand where the paper has its own units, so the score is only good to rank by.
    Source: APEX appendix "Training of DG-Motion Attention".
    """
    geometry, is_centre = seen.geometry, seen.centre_moves[:, None]
    to_centre = np.where(is_centre, -geometry.offset_m, geometry.offset_m)
    velocity = np.where(is_centre, geometry.target_vel_m_s, geometry.mover_vel_m_s)
    distance, speed = np.linalg.norm(to_centre, axis=1), np.linalg.norm(velocity, axis=1)
    cosine = np.sum(to_centre * velocity, axis=1) / np.maximum(distance * speed, _TINY)
    return risk_score(distance, cosine, speed)


def gradient_boosting(train: Array, label: Array, test: Array, seed: int) -> Array:
    """Return the probability (r,) that boosted trees give the ``test (r, k)`` inputs: the ceiling.

    Parameters
    ----------
    train : (t, k) inputs of the training rows, the same that the model beside it sees.
    label : (t,) bool.
    seed : fixes the result; no rows are held back for early stopping.

    Raises
    ------
    MissingExtraError : scikit-learn is not installed.
    """
    trees = module("sklearn.ensemble").HistGradientBoostingClassifier(
        max_iter=150,
        learning_rate=0.06,
        max_leaf_nodes=15,
        min_samples_leaf=40,
        l2_regularization=1.0,
        early_stopping=False,
        random_state=seed,
    )
    probability: Array = trees.fit(train, label).predict_proba(test)[:, 1]
    return probability
