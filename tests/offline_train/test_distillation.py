from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("sklearn")

from apex_edge.errors import ApexError
from apex_edge.triggers.features import FEATURE_NAMES
from offline_train.graph_models.batches import star_graphs
from offline_train.scenes import star
from offline_train.trigger.distill import soft_target
from offline_train.trigger.fit import fit_rows
from offline_train.trigger.metrics import sigmoid

NAMES = ("first", "second", "third")


@pytest.fixture(scope="module")
def rows():
    return np.random.default_rng(0).normal(size=(4000, 3))


def test_the_target_mixes_teacher_and_truth():
    teacher, truth = np.array([0.2, 0.9]), np.array([True, False])
    assert soft_target(teacher, truth, 0.0).tolist() == [0.2, 0.9]
    assert soft_target(teacher, truth, 1.0).tolist() == [1.0, 0.0]
    assert soft_target(teacher, truth, 0.5) == pytest.approx([0.6, 0.45])


@pytest.mark.parametrize(
    ("teacher", "truth", "mix"),
    [([0.5], [True], 1.1), ([0.5], [True], -0.1), ([0.5, 0.5], [True], 0.5), ([1.5], [True], 0.0)],
)
def test_targets_that_make_no_sense_are_refused(teacher, truth, mix):
    with pytest.raises(ApexError):
        soft_target(np.array(teacher), np.array(truth), mix)


def test_the_student_takes_over_a_linear_teacher_with_its_doubt(rows):
    logit = rows @ np.array([1.0, -2.0, 0.0]) + 0.5
    student = fit_rows(rows, sigmoid(logit), NAMES)
    assert np.max(np.abs(sigmoid(student.logit(rows)) - sigmoid(logit))) < 0.02


def test_hard_targets_give_plain_logistic_regression(rows):
    linear_model = pytest.importorskip("sklearn.linear_model")
    label = rows[:, 0] + np.random.default_rng(1).normal(size=len(rows)) > 0.0
    student = fit_rows(rows, label, NAMES)
    plain = linear_model.LogisticRegression(max_iter=5000, tol=1e-8)
    plain.fit(student.standardise(rows), label)
    assert student.weight == pytest.approx(plain.coef_[0], abs=1e-9)


def test_mixing_the_truth_in_mends_a_teacher_that_is_wrong(rows):
    random = np.random.default_rng(2)
    truth = random.random(len(rows)) < sigmoid(2.0 * rows[:, 0])
    wrong = sigmoid(-2.0 * rows[:, 0])
    weights = [
        fit_rows(rows, soft_target(wrong, truth, mix), NAMES).weight[0] for mix in (0.0, 0.5, 1.0)
    ]
    assert weights[0] < -1.0 < weights[1] < 0.5
    assert weights[2] > 1.0


def test_features_in_sd_are_clipped_before_they_are_learnt():
    random = np.random.default_rng(3)
    z = 1e4 * random.normal(size=(500, 1))
    student = fit_rows(z, z[:, 0] > 0.0, ("z",))
    assert (student.clip_lo, student.clip_hi) == (-4.0, 4.0)
    assert ((student.logit(z) > 0.0) == (z[:, 0] > 0.0)).mean() > 0.99


def test_a_constant_feature_does_no_harm(rows):
    features = np.c_[rows[:, 0], np.full(len(rows), 7.0)]
    student = fit_rows(features, rows[:, 0] > 0.0, ("first", "constant"))
    assert np.isfinite(student.logit(features)).all()


def test_targets_all_alike_are_refused(rows):
    with pytest.raises(ApexError, match="all alike"):
        fit_rows(rows, np.zeros(len(rows)), NAMES)


def test_a_linear_model_labels_graphs_for_a_graph_model():
    pytest.importorskip("torch_geometric")
    from offline_train.graph_models import models
    from offline_train.graph_models.training import Options, fit

    stars = star.hard_stars("train", 2, 400)
    features = star.pair_features(stars)
    teacher = fit_rows(features, stars.truth.ravel(), FEATURE_NAMES)
    said = sigmoid(teacher.logit(features))
    graphs = star_graphs(stars, np.zeros(stars.truth.shape), features, FEATURE_NAMES)
    taught = replace(graphs, labels=said)
    options = Options(seed=1, n_epochs=20)
    student = fit(
        lambda: models.diffgraphormer(star.NODE_NAMES, FEATURE_NAMES, 0.0), taught, options
    )
    gap = np.abs(sigmoid(student.logit(taught)) - said)
    assert gap.mean() < 0.03
