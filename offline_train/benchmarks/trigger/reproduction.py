"""The paper's graph trigger, reproduced: its figures, where they come from, and what beats them.

The paper favours "> 90 % recall with ~70 % accuracy". The released code gets there by taking a
sigmoid of a sigmoid in its evaluation; the same weights do much better when asked once. All
scores are on fresh stars of the bench seed. How much accuracy is lost is a matter of chance: where
the negatives' logits stop, below or above -16, depends on the training seed (0.67 for the shipped
seed 1; 0.87 for seed 2), while recall is 1.00 for both. The shipped models were trained by
``apex train fit --paper``; a short training here shows that the second sigmoid costs as much again.
"""

import dataclasses
from typing import Dict, List, Mapping, Optional

import numpy as np

from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.triggers.graph_net import ARCHITECTURES, GRAPHORMER
from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.graph_models import files, paper
from offline_train.graph_models.paper import fires_as_released, rates
from offline_train.scenes import star
from offline_train.trigger.fit import fit_rows

SUITE = "reproduction"
N_TEST = 2000
N_LINEAR_TRAIN = 2000
N_SHORT_EPOCHS = 5
RECALL_GOAL = 0.9
SHORT_LOSS_GOAL = 0.2
ACCURACY_GOALS = (0.6, 0.8)
LINEAR_GOALS = {"accuracy": 0.995, "recall": 0.99, "precision": 0.97}
_FASTER_THAN_SAFE = 1.0 + 1e-9
Rates = Mapping[str, Optional[float]]


def measure(seed: int) -> List[Line]:
    """Score the shipped models, rules and a linear model; train briefly; see the module.

    Raises
    ------
    MissingExtraError : scikit-learn, PyTorch or PyTorch Geometric is not installed.
    WeightsError : a shipped file is damaged.
    """
    test = star.paper_stars("bench", seed, N_TEST)
    return [
        *quirk_lines(test),
        *text_lines(test),
        *label_lines(test),
        *linear_lines(star.paper_stars("train", seed, N_LINEAR_TRAIN), test),
        *short_training_lines(test, seed),
    ]


def quirk_lines(test: star.StarSet) -> List[Line]:
    """Return the scores of the models trained as the released code does, evaluated both ways."""
    graphs = paper.paper_graphs(test, paper.REPO_QUIRKS)
    lines: List[Line] = []
    for name in ARCHITECTURES:
        logit = files.read(files.shipped(name, True))[0].logit(graphs)
        released = rates(fires_as_released(logit), graphs.labels)
        if name == GRAPHORMER:
            what = f"{name} as released, evaluated as released"
            low, high = ACCURACY_GOALS
            accuracy = _number(released["accuracy"])
            lines += [
                at_least(SUITE, f"{what}: recall", _number(released["recall"]), RECALL_GOAL),
                at_least(SUITE, f"{what}: accuracy", accuracy, low),
                at_most(SUITE, f"{what}: accuracy", accuracy, high),
            ]
        lines.append(_row(f"{name} as released, evaluated as released", released))
        lines.append(_row(f"{name} as released, one sigmoid", rates(logit > 0.0, graphs.labels)))
    return lines


def text_lines(test: star.StarSet) -> List[Line]:
    """Return the scores of the models trained as the paper's text says, on its own label."""
    graphs = paper.paper_graphs(test, paper.NO_QUIRKS)
    lines: List[Line] = []
    for name in ARCHITECTURES:
        logit = files.read(files.shipped(name, False))[0].logit(graphs)
        lines.append(_row(f"{name} as the text says", rates(logit > 0.0, graphs.labels)))
    return lines


def label_lines(test: star.StarSet) -> List[Line]:
    """Return what the labels are worth and how far speed alone gets."""
    fast = np.linalg.norm(test.node_t[:, 1:, 4:], axis=2) > _FASTER_THAN_SAFE
    high = test.risk_fixed > star.RISK_TAU
    return [
        _row("speed alone, planted targets", rates(fast, test.designed)),
        note(SUITE, "largest risk as released (its label asks for 0.75)", test.risk.max()),
        note(SUITE, "largest risk put right", test.risk_fixed.max()),
        _row("risk put right > 0.75 against true contact", rates(high, test.truth)),
    ]


def linear_lines(train: star.StarSet, test: star.StarSet) -> List[Line]:
    """Return the scores of logistic regression on the device's pair features, planted targets."""
    model = fit_rows(star.pair_features(train), train.designed.ravel(), FEATURE_NAMES)
    found = rates(model.logit(star.pair_features(test)) > 0.0, test.designed.ravel())
    return [
        at_least(SUITE, f"linear, planted targets: {name}", _number(found[name]), goal, "{:.4f}")
        for name, goal in LINEAR_GOALS.items()
    ]


def short_training_lines(test: star.StarSet, seed: int) -> List[Line]:
    """Train a few epochs with the quirks from this seed: the second sigmoid costs accuracy again.

    Recall is not promised: with a sigmoid inside, training wanders (one-sigmoid recall .36 to .99
    after 10 epochs, by seed) and settles only later.
    """
    fit = paper.train_paper(GRAPHORMER, paper.REPO_QUIRKS, seed, N_SHORT_EPOCHS).fit
    graphs = paper.paper_graphs(test, paper.REPO_QUIRKS)
    logit = fit.logit(graphs)
    released = rates(fires_as_released(logit), graphs.labels)
    once = rates(logit > 0.0, graphs.labels)
    what = f"trained here for {N_SHORT_EPOCHS} epochs"
    lost = _number(once["accuracy"]) - _number(released["accuracy"])
    return [
        at_least(SUITE, f"{what}: accuracy lost to the second sigmoid", lost, SHORT_LOSS_GOAL),
        _row(f"{what}, evaluated as released", released),
        _row(f"{what}, one sigmoid", once),
    ]


def _row(what: str, found: Rates) -> Line:
    """Return a line that promises nothing and holds all three rates."""
    figures: Dict[str, float] = {name: _number(value) for name, value in found.items()}
    text = " / ".join(f"{value:.3f}" for value in figures.values())
    line = note(SUITE, f"{what}: acc / recall / prec", figures["accuracy"])
    return dataclasses.replace(line, measured=text, figures=figures)


def _number(value: Optional[float]) -> float:
    return float("nan") if value is None else value
