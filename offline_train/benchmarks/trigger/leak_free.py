"""The leak-free stars: a linear model on pair features against graphs on the paper's inputs.

All models are trained here, on stars of the training seed, and tested on stars of the bench seed.
Scores are compared by the area under the precision-recall curve and by the share of false alarms
at a recall of 0.99. States are exact, so the closest approach among the pair features is the
answer itself: the suite shows what inputs are worth, not how a model bears noise.
"""

import dataclasses
from typing import Any, Callable, Dict, List, Tuple

import numpy as np

from apex_edge.triggers.approach import closest
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.triggers.graph_net import ARCHITECTURES, GRAPHORMER, GraphSpec
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.extras import module
from offline_train.graph_models.batches import Graphs, star_graphs
from offline_train.graph_models.specs import full_spec, paper_spec
from offline_train.scenes import star
from offline_train.trigger.fit import fit_rows
from offline_train.trigger.metrics import frame_figures

SUITE = "leak_free"
N_TRAIN = 2000
N_TEST = 1000
PR_GOAL = 0.99
FPR_GOAL = 0.01
_DROPOUT = 0.3
# Without noise the features in sd give the answer away; these alone do not.
_WITHOUT_SD = ("distance", "closing", "speed", "cos", "dca", "tca")


def measure(seed: int) -> List[Line]:
    """Train and compare; see the module.

    Raises
    ------
    MissingExtraError : scikit-learn, PyTorch or PyTorch Geometric is not installed.
    """
    train = star.hard_stars("train", seed, N_TRAIN)
    test = star.hard_stars("bench", seed, N_TEST)
    scores = {**rules(test), **linear_scores(train, test), **graph_scores(train, test, seed)}
    return compared(test, scores)


def rules(test: star.StarSet) -> Dict[str, Array]:
    """Return the scores (R,) of what needs no training."""
    pairs = star.star_pairs(test)
    return {
        "speed alone": np.linalg.norm(test.node_t[:, 1:, 4:], axis=2).ravel(),
        "paper's risk, put right": test.risk_fixed.ravel(),
        "analytic closest approach, exact state": -closest(pairs, star.HORIZON_S).dca_m,
    }


def linear_scores(train: star.StarSet, test: star.StarSet) -> Dict[str, Array]:
    """Return the logits (R,) of logistic regression on pair features and on the paper's three."""
    label = train.truth.ravel()
    pair = fit_rows(star.pair_features(train), label, FEATURE_NAMES)
    plain = [FEATURE_NAMES.index(name) for name in _WITHOUT_SD]
    bare = fit_rows(star.pair_features(train)[:, plain], label, _WITHOUT_SD)
    paper = fit_rows(star.paper_edges(train).reshape(-1, 3), label, star.EDGE_NAMES)
    return {
        "linear": pair.logit(star.pair_features(test)),
        f"linear on {len(plain)} of them, none in sd": bare.logit(
            star.pair_features(test)[:, plain]
        ),
        "linear on the paper's 3 edge features": paper.logit(star.paper_edges(test).reshape(-1, 3)),
    }


def graph_scores(train: star.StarSet, test: star.StarSet, seed: int) -> Dict[str, Array]:
    """Return the logits (R,) of the graph models, all trained with logits and scaled inputs."""
    models = module("offline_train.graph_models.models")
    training = module("offline_train.graph_models.training")
    options = training.Options(seed=seed, is_balanced=True)
    scores: Dict[str, Array] = {}
    for what, spec, see in graph_variants():
        make = _maker(models, spec)
        scores[what] = training.fit(make, see(train), options).logit(see(test))
    return scores


def graph_variants() -> List[Tuple[str, GraphSpec, Callable[[star.StarSet], Graphs]]]:
    """Return name, spec and view of each graph model compared."""
    nodes, edges = star.NODE_NAMES, star.EDGE_NAMES
    found = [
        (name, paper_spec(name, nodes, edges, is_edge_dim=True), paper_view)
        for name in ARCHITECTURES
    ]
    rich = full_spec(GRAPHORMER, nodes, FEATURE_NAMES)
    return [*found, ("diffgraphormer with pair features as edges", rich, pair_view)]


def paper_view(stars: star.StarSet) -> Graphs:
    """Return the stars with the paper's edges and the true label."""
    return star_graphs(stars, stars.truth, star.paper_edges(stars))


def pair_view(stars: star.StarSet) -> Graphs:
    """Return the stars with the device's pair features as edges and the true label."""
    return star_graphs(stars, stars.truth, star.pair_features(stars), FEATURE_NAMES)


def compared(test: star.StarSet, scores: Dict[str, Array]) -> List[Line]:
    """Return the lines: the goals of the linear model, and every score beside it."""
    label = test.truth.ravel()
    figures = {name: frame_figures(label, score) for name, score in scores.items()}
    pr = {name: found["pr_auc"] or 0.0 for name, found in figures.items()}
    fpr = {name: found["fpr_at_recall_0.99"] for name, found in figures.items()}
    best = max(pr[name] for name in ARCHITECTURES)
    lines = [
        note(SUITE, "share of edges that touch", float(np.mean(label)), "{:.3f}"),
        at_least(SUITE, "linear: PR-AUC", pr["linear"], PR_GOAL, "{:.4f}"),
        at_most(SUITE, "linear: FPR at recall .99", fpr["linear"], FPR_GOAL, "{:.4f}"),
        at_least(
            SUITE,
            "linear: PR-AUC ahead of the best graph on the paper's inputs",
            pr["linear"] - best,
            0.0,
            "{:.4f}",
        ),
    ]
    for name in scores:
        if name != "linear":
            both = note(SUITE, f"{name}: PR-AUC, FPR at recall .99", pr[name])
            text = f"{pr[name]:.3f}, {fpr[name]:.3f}"
            both_figures = {"pr_auc": pr[name], "fpr_at_recall_0.99": fpr[name]}
            lines.append(dataclasses.replace(both, measured=text, figures=both_figures))
    return lines


def _maker(models: Any, spec: GraphSpec) -> Callable[[], Any]:
    return lambda: models.from_spec(spec, _DROPOUT)
