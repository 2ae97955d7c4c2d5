import numpy as np
import pytest

from offline_train.trigger import metrics


def noisy(seed, n=3000, digits=None):
    rng = np.random.default_rng(seed)
    label = rng.random(n) < 0.2
    score = rng.normal(size=n) + 1.5 * label
    return label, score if digits is None else np.round(score, digits)


@pytest.mark.parametrize("digits", [None, 1, 0])
def test_areas_are_those_of_scikit_learn_with_and_without_ties(digits):
    sk = pytest.importorskip("sklearn.metrics")
    label, score = noisy(1, digits=digits)
    found = metrics.frame_figures(label, score)
    assert found["pr_auc"] == pytest.approx(sk.average_precision_score(label, score), abs=1e-12)
    assert found["roc_auc"] == pytest.approx(sk.roc_auc_score(label, score), abs=1e-12)


@pytest.mark.parametrize("digits", [None, 0])
def test_false_positives_at_a_recall_are_those_of_the_roc_curve(digits):
    sk = pytest.importorskip("sklearn.metrics")
    label, score = noisy(2, digits=digits)
    fpr, recall, _ = sk.roc_curve(label, score, drop_intermediate=False)
    found = metrics.frame_figures(label, score)
    for goal in (0.90, 0.95, 0.99):
        expected = fpr[recall >= goal - 1e-12].min()
        assert found[f"fpr_at_recall_{goal:.2f}"] == pytest.approx(expected, abs=1e-12)


def test_probability_figures_are_those_of_scikit_learn():
    sk = pytest.importorskip("sklearn.metrics")
    label, score = noisy(3)
    said = 1.0 / (1.0 + np.exp(-score))
    found = metrics.probability_figures(label, said)
    assert found["brier"] == pytest.approx(sk.brier_score_loss(label, said))
    assert found["log_loss"] == pytest.approx(sk.log_loss(label, said))


def test_a_score_by_hand():
    label = np.array([True, False, True, False])
    found = metrics.frame_figures(label, np.array([4.0, 3.0, 2.0, 1.0]))
    assert found["pr_auc"] == pytest.approx(0.5 * 1.0 + 0.5 * 2.0 / 3.0)
    assert found["roc_auc"] == pytest.approx(0.75)
    assert found["fpr_at_recall_0.99"] == pytest.approx(0.5)


def test_a_score_that_says_nothing_has_the_area_of_chance():
    label, _ = noisy(4)
    found = metrics.frame_figures(label, np.zeros(len(label)))
    assert found["roc_auc"] == pytest.approx(0.5)
    assert found["pr_auc"] == pytest.approx(label.mean())
    assert found["fpr_at_recall_0.90"] == 1.0


def test_labels_that_are_all_alike_give_no_figure_rather_than_a_wrong_one():
    found = metrics.frame_figures(np.ones(5, dtype=bool), np.arange(5.0))
    assert set(found.values()) == {None}


def test_without_any_frame_there_is_no_figure():
    found = metrics.frame_figures(np.zeros(0, dtype=bool), np.zeros(0))
    assert found and all(value is None for value in found.values())


def test_the_calibration_error_by_hand():
    # two bins: .1 said of four, one came; .9 said of two, both came
    said = np.array([0.1, 0.1, 0.1, 0.1, 0.9, 0.9])
    label = np.array([True, False, False, False, True, True])
    expected = (4 * abs(0.1 - 0.25) + 2 * abs(0.9 - 1.0)) / 6
    assert metrics.calibration_error(label, said) == pytest.approx(expected)


def test_honest_probabilities_lie_on_the_diagonal_and_boastful_ones_do_not():
    rng = np.random.default_rng(5)
    truth = rng.random(40000)
    label = rng.random(40000) < truth
    found = metrics.reliability(label, truth)
    sd = np.sqrt(np.array(found["said"]) * (1.0 - np.array(found["said"])) / np.array(found["n"]))
    off = np.abs(np.array(found["came"]) - np.array(found["said"]))
    assert len(off) == metrics.N_BINS
    assert np.all(off < 4.0 * sd)
    assert sum(found["n"]) == 40000
    boast = metrics.reliability(label, np.where(truth > 0.5, 0.99, 0.01))
    assert np.max(np.abs(np.array(boast["came"]) - np.array(boast["said"]))) > 0.2


def test_the_points_of_a_plot_are_few_and_on_the_whole_curve():
    sk = pytest.importorskip("sklearn.metrics")
    label, score = noisy(6, n=20000)
    found = metrics.curves(label, score)
    assert len(found["roc"]["fpr"]) <= metrics.MAX_POINTS + 1
    assert (found["roc"]["fpr"][0], found["roc"]["recall"][0]) == (0.0, 0.0)
    assert (found["roc"]["fpr"][-1], found["roc"]["recall"][-1]) == (1.0, 1.0)
    fpr, recall, _ = sk.roc_curve(label, score, drop_intermediate=False)
    on_curve = set(zip(np.round(fpr, 9), np.round(recall, 9)))
    pairs = zip(np.round(found["roc"]["fpr"], 9), np.round(found["roc"]["recall"], 9))
    assert all(pair in on_curve for pair in pairs)
    area = np.trapezoid(found["roc"]["recall"], found["roc"]["fpr"])
    assert area == pytest.approx(sk.roc_auc_score(label, score), abs=2e-3)
