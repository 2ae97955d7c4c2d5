"""Fit any model on watched scenes, from a label or from what a teacher says of each pair.

Rows of one approach are alike, so only some frames of each scene are learnt from; a graph model
gets whole frames, every pair that was seen at once. Source: ours.
"""

import platform
from dataclasses import asdict
from typing import Any, Callable, Dict, List, Optional, Tuple

import numpy as np

from apex_edge import plugins
from apex_edge.errors import ApexError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.feature_sets import FEATURE_SETS
from apex_edge.triggers.features import FEATURE_NAMES, FEATURE_SET
from apex_edge.triggers.models import Model
from apex_edge.triggers.stars import NODE_NAMES, stars
from apex_edge.triggers.wide import WIDE_SET
from apex_edge.types import Array
from offline_train.extras import module
from offline_train.graph_models import files
from offline_train.graph_models.batches import Graphs
from offline_train.scenes.star import RISK_TAU
from offline_train.trigger import baselines, export
from offline_train.trigger.calibrate import Promise
from offline_train.trigger.data import Description
from offline_train.trigger.fit import ROWS_PER_PAIR, fit_rows, thin
from offline_train.trigger.observe import Observed
from offline_train.trigger.scaling import fitted, spread
from offline_train.trigger.scoring import features_of, logits

LABELS = ("truth", "soft", "paper-risk", "designed")
LINEAR, WIDE, CEILING = "linear12", "linear-wide", "gbm-ceiling"
_FEATURES = {LINEAR: FEATURE_SET, WIDE: WIDE_SET}
N_EPOCHS = 15
# Stars of a table are small: 256 make a step about as dear as 32 of the paper's graphs.
BATCH_SIZE = 256
DROPOUT = 0.1


def targets(seen: Observed, label: str) -> Array:
    """Return what a model is to say of each row (r,): 0 or 1, or a probability.

    Parameters
    ----------
    label : "truth" contact within the horizon; "soft" its probability from perturbed roll-outs;
        "paper-risk" the paper's risk above 0.75.

    Raises
    ------
    ApexError : these scenes have no such label.
    """
    if label == "truth":
        return seen.label.astype(np.float64)
    if label == "soft":
        if not np.all(np.isfinite(seen.soft)):
            raise ApexError(
                "label soft: these scenes were drawn without perturbed roll-outs; "
                "apex train generate --soft 32 makes them"
            )
        return seen.soft
    if label == "paper-risk":
        risk = baselines.paper_risk(seen)
        if risk.size and risk.max() <= RISK_TAU:
            raise ApexError(
                f"label paper-risk: the risk reaches {risk.max():.2f} here and never {RISK_TAU}; "
                "it is no measure of metres and m/s, use truth or soft"
            )
        return (risk > RISK_TAU).astype(np.float64)
    raise ApexError(f"label {label}: only the paper's stars have it; see apex train fit --paper")


def fit(
    seen: Observed,
    target: Array,
    name: str,
    seed: int,
    n_epochs: int = N_EPOCHS,
    on_epoch: Optional[Callable[[], None]] = None,
) -> export.Trained:
    """Fit a linear model, or a graph model registered by name, to targets (r,).

    Raises
    ------
    MissingExtraError : scikit-learn, PyTorch or PyTorch Geometric is not installed.
    PluginError : no model of that name.
    ApexError : nothing to tell apart, or a model that no device could run.
    """
    if name in _FEATURES:
        known = FEATURE_SETS[_FEATURES[name]]
        rows = thin(seen.pair, ROWS_PER_PAIR, seed)
        solver = "newton-cholesky" if name == WIDE else "lbfgs"
        found = fit_rows(features_of(known, seen)[rows], target[rows], known.names, solver=solver)
        return export.linear(found, known)
    if name == CEILING:
        raise ApexError(
            f"{name}: no device runs boosted trees; apex train evaluate sets them beside a model"
        )
    training = module("offline_train.graph_models.training")
    make = plugins.load("graph_models", name)
    rows = whole_frames(seen, seed)
    graphs, _ = watched_graphs(seen, target, rows)
    options = training.Options(seed=seed, n_epochs=n_epochs, batch_size=BATCH_SIZE)
    found = training.fit(
        lambda: make(NODE_NAMES, FEATURE_NAMES, DROPOUT), graphs, options, on_epoch
    )
    if found.spec is None:
        raise ApexError(f"{name} has no form the device can run, so there is no file to write")
    features = seen.features[rows]
    columns = found.edge_scaler
    if len(columns.mean) != len(FEATURE_NAMES):
        columns = fitted(features, FEATURE_NAMES)  # it reads no edges, but the file has a scaler
    low, high = spread(features)
    return export.Trained(
        keys=export.graph_keys(found.spec, found.layers, found.node_scaler),
        feature_set=FEATURE_SETS[FEATURE_SET],
        columns=columns,
        low=low,
        high=high,
    )


def check_packages(name: str) -> None:
    """Refuse a model whose packages are not here, before the work.

    Raises
    ------
    MissingExtraError : says what to install.
    PluginError : no model of that name.
    """
    module("sklearn")
    if name not in _FEATURES:
        plugins.load("graph_models", name)
        module("offline_train.graph_models.training")


def libraries(trained: export.Trained) -> Dict[str, str]:
    """Return the versions that the bytes of a trained model depend on."""
    if trained.keys["kind"] == "graph":
        return files.libraries()
    found = {"python": platform.python_version(), "numpy": np.__version__}
    found["scikit-learn"] = module("sklearn").__version__
    return found


def said_by(teacher: Model, seen: Observed) -> Array:
    """Return the probability (r,) that a device's model gives each row, frame by frame.

    Raises
    ------
    WeightsError : rows are judged for another horizon, or were watched without wide features.
    """
    return teacher.probability(logits(teacher, seen))


def whole_frames(seen: Observed, seed: int) -> Array:
    """Return the row indices of a few random frames of each scene, with all their pairs."""
    _, first, frame = np.unique(seen.group, return_index=True, return_inverse=True)
    kept = np.zeros(len(first), dtype=bool)
    kept[thin(seen.scene[seen.pair[first]], ROWS_PER_PAIR, seed)] = True
    return np.flatnonzero(kept[frame])


def watched_graphs(seen: Observed, target: Array, rows: Array) -> Tuple[Graphs, Array]:
    """Return the stars of these rows as the device builds them, one graph each.

    Returns
    -------
    graphs, with ``target`` as labels, and the row (R,) that each edge stands for.
    """
    part = seen.take(rows)
    found = stars(part.geometry, part.bodies[:, 0], part.group)
    order = np.argsort(found.edges[0], kind="stable")
    star, far = found.edges[:, order]
    n_edges = np.bincount(star)
    edge_start = np.r_[0, np.cumsum(n_edges)]
    node_start = np.r_[0, np.cumsum(n_edges + 1)]
    place = node_start[star] + 1 + np.arange(len(star)) - edge_start[star]
    nodes = np.empty_like(found.nodes)
    nodes[node_start[:-1]] = found.nodes[: len(n_edges)]
    nodes[place] = found.nodes[far]
    graphs = Graphs(
        nodes=nodes,
        edges=np.stack([node_start[star], place]),
        edge_features=part.features[order],
        labels=target[rows][order],
        node_start=node_start,
        edge_start=edge_start,
        node_names=NODE_NAMES,
        edge_names=FEATURE_NAMES,
    )
    return graphs, rows[order]


def document(
    trained: export.Trained, seen: Observed, description: Description, made: Dict[str, Any]
) -> Dict[str, Any]:
    """Return the model document, not yet certified.

    Whatever the model learnt, its probability is that of contact: a few rows of each pair set
    what a logit means. ``made`` joins its provenance.

    Raises
    ------
    WeightsError : the device would not build this model.
    """
    radius = seen.geometry.radius_m
    drawn = {k: v for k, v in asdict(description).items() if k != "watching"}
    if description.watching is not None and description.watching.n_rollouts:
        drawn["n_rollouts"] = description.watching.n_rollouts
    notes = {
        "radius_m": [float(radius.min()), float(radius.max())],
        "watching": description.watching,
        "provenance": {
            "generator": description.scenario,
            "generator_version": description.version,
            "data": drawn,
            **made,
        },
        "metrics": {},
    }
    fields = export.document(trained, None, Promise(), TriggerConfig(), notes)
    said = logits(weights.check(fields, "fitted model"), seen)
    rows = thin(seen.pair, ROWS_PER_PAIR, 0)
    fields["chances"] = chances(said[rows], seen.label[rows])
    fields["sha256"] = model_file.digest(fields)
    return fields


def chances(logit: Array, label: Array, n: int = 40) -> Dict[str, List[float]]:
    """Return what logits mean: ``n`` of them that rise, and the share of contacts around each.

    Rows are put into groups of one size by their logit; neighbours whose shares fall are made one
    level (isotonic regression). A linear model is a few hundredths off where its features bend.
    """
    order = np.argsort(logit, kind="stable")
    groups = [part for part in np.array_split(order, n) if len(part)]
    middle = np.array([logit[part].mean() for part in groups])
    share = np.array([label[part].mean() for part in groups])
    rising = np.r_[True, np.diff(middle) > 0.0]
    isotonic = module("sklearn.isotonic").IsotonicRegression(y_min=0.0, y_max=1.0)
    level = isotonic.fit_transform(middle[rising], share[rising])
    return {"logit": middle[rising].tolist(), "probability": level.tolist()}
