"""Evaluate several models side by side on named test sets, as markdown, JSON and plots.

Source: ours.
"""

import json
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.errors import InputError
from apex_edge.triggers import model_file, weights
from apex_edge.triggers.base import TriggerConfig
from apex_edge.types import Array
from offline_train.reports import curves, tables
from offline_train.reports.card import Tested, n_parameters, section
from offline_train.trigger.calibrate import Promise
from offline_train.trigger.certify import gate_of
from offline_train.trigger.evaluate import Rated, Testing, beside, evaluate, summary
from offline_train.trigger.evaluate import curves as points_of
from offline_train.trigger.golden import with_golden
from offline_train.trigger.observe import Observed
from offline_train.trigger.scoring import RULE_SURE

# The trees of the ceiling draw rows and bins; any fixed seed does.
_CEILING_SEED = 0


class Model(NamedTuple):
    """A model document, and what the device compares with its threshold (r,), row by row."""

    fields: Mapping[str, Any]
    score: Callable[[Observed], Array]


class Data(NamedTuple):
    """A named test set, the names of its kinds of motion, and where it comes from."""

    name: str
    seen: Observed
    kinds: Tuple[str, ...]
    origin: Mapping[str, Any] = {}


def examine(data: Data, models: Mapping[str, Model], inputs: Callable[[Observed], Array]) -> Tested:
    """Return figures and curves of the models and their four baselines on one set.

    Of a model, ``fallback_share`` is the share of rows outside its domain, where the k-sigma rule
    speaks for it as on the device.

    Parameters
    ----------
    models : by name; all certified under the same gate, vote and lead. The first is the reference
        to whose event recall the baselines are held.
    inputs : gives what the boosted trees see (r, k).

    Raises
    ------
    InputError : the models were certified under different terms, or the set holds no frames.
    MissingExtraError : scikit-learn is not installed.
    """
    if not len(data.seen.pair):
        raise InputError(f"{data.name}: no frame passes the gate; there is nothing to test on")
    config, lead_s = terms(models)
    rated: Dict[str, Rated] = {}
    fallback: Dict[str, float] = {}
    for name, model in models.items():
        logit = model.score(data.seen)
        promise = model.fields["threshold"]
        threshold = None if promise is None else float(promise["logit"])
        is_fallback = np.abs(logit) >= RULE_SURE
        chance = weights.check(model.fields, name).probability(logit)
        said = np.where(is_fallback, data.seen.rule_probability, chance)
        rated[name] = Rated(logit, threshold, said)
        fallback[name] = float(is_fallback.mean())
    rated.update(beside(data.seen, inputs(data.seen), _CEILING_SEED))
    testing = Testing(config, lead_s, data.kinds, next(iter(models)))
    found = evaluate(data.seen, rated, testing)
    for name, share in fallback.items():
        found["rules"][name]["fallback_share"] = share
    if data.origin:
        found["origin"] = dict(data.origin)
    return Tested(data.name, found, points_of(data.seen, rated))


def finished(fields: Mapping[str, Any], tests: Sequence[Tested]) -> Dict[str, Any]:
    """Return the document with its metrics on the test sets, new golden vectors, and signed.

    Raises
    ------
    WeightsError : the fields make no model.
    """
    metrics = {test.name: summary(test.evaluation) for test in tests}
    made = with_golden({**fields, "metrics": metrics}, float(fields["horizon_s"]))
    return {**made, "sha256": model_file.digest(made)}


def terms(models: Mapping[str, Model]) -> Tuple[TriggerConfig, float]:
    """Return gate and vote, and the lead, that all models were certified under.

    Raises
    ------
    InputError : they differ, so that no table can compare the models.
    WeightsError : a gate names a setting that this program does not have.
    """
    found: Dict[str, Tuple[TriggerConfig, float]] = {}
    for name, model in models.items():
        promise = model.fields["threshold"] or {}
        lead_s = float(promise.get("lead_s", Promise().lead_s))
        found[name] = (gate_of(model.fields), lead_s)
    first = next(iter(found))
    for name, one in found.items():
        if one != found[first]:
            raise InputError(f"{name} was certified under {one}, but {first} under {found[first]}")
    return found[first]


def report(tests: Sequence[Tested], models: Mapping[str, Model]) -> Dict[str, str]:
    """Return the files of a report by name: ``evaluation.md``, ``evaluation.json`` and plots.

    Raises
    ------
    MissingExtraError : matplotlib is not installed.
    """
    files: Dict[str, str] = {}
    parts = ["# Evaluation of hazard triggers\n\n" + _overview(models)]
    for test in tests:
        pictures = curves.draw(test.evaluation, test.points)
        names = {kind: f"{test.name}-{kind}.svg" for kind in pictures}
        files.update({names[kind]: text for kind, text in pictures.items()})
        parts.append(f"## `{test.name}`\n\n" + section(test, names))
    files["evaluation.md"] = "\n\n".join(parts) + "\n"
    files["evaluation.json"] = json.dumps(plain(tests, models), indent=1, allow_nan=False) + "\n"
    return files


def plain(tests: Sequence[Tested], models: Mapping[str, Model]) -> Dict[str, Any]:
    """Return figures and curves as JSON values."""
    return {
        "format": "apex-trigger-evaluation",
        "format_version": 1,
        "models": {
            name: {
                "sha256": model.fields.get("sha256"),
                "kind": model.fields["kind"],
                "n_parameters": n_parameters(model.fields),
            }
            for name, model in models.items()
        },
        "sets": {t.name: dict(t.evaluation, curves=dict(t.points)) for t in tests},
    }


def _overview(models: Mapping[str, Model]) -> str:
    rows: List[List[str]] = []
    for name, model in models.items():
        promise = model.fields["threshold"]
        certified = "none" if promise is None else tables.share(1.0 - promise["alpha"])
        rows.append(
            [
                name,
                model.fields["kind"],
                model.fields["feature_set"],
                str(n_parameters(model.fields)),
                certified,
            ]
        )
    head = ("model", "kind", "features", "parameters", "certified recall")
    return (
        tables.markdown(head, rows)
        + "\n\nA model costs about one multiply-add per parameter and pair, beside the features. "
        "Beside the models: speed alone, the k-sigma rule, the paper's risk score, and boosted "
        "trees as a ceiling, which learnt on two thirds of each set and score the last third."
    )
