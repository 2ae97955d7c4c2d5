"""What a model is worth on scenes nothing was learnt from, with the four baselines beside it.

Every rule is a score per row, behind the same gate and vote. A rule without a threshold of its own
gets the one at which it announces as many events as the reference, so that false alarms compare.
Source: ours.
"""

from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from apex_edge.types import Array
from offline_train.trigger import baselines, metrics
from offline_train.trigger.calibrate import is_eligible, is_watched, voted
from offline_train.trigger.fit import ROWS_PER_PAIR, thin
from offline_train.trigger.observe import Observed

SPEED, ANALYTIC, PAPER_RISK, BOOSTING = "speed only", "analytic", "paper risk", "boosting"
BASELINES = (SPEED, ANALYTIC, PAPER_RISK, BOOSTING)
LEADS_S = tuple(round(0.2 * step, 1) for step in range(1, 16))
_N_FOLDS = 3
_TINY = 1e-9


class Rated(NamedTuple):
    """What a rule says of r rows: ``score (r,)``, higher = more dangerous; ``probability (r,)``."""

    score: Array
    threshold: Optional[float] = None
    probability: Optional[Array] = None


@dataclass(frozen=True)
class Testing:
    """How rules are compared.

    ``config`` gate and vote, ``lead_s`` before contact at which an event must be announced,
    ``kinds`` names of ``Observed.kind``, ``reference`` the rule whose event recall the rules
    without a threshold are held to; if it has no threshold either, ``recall`` it is.
    """

    config: TriggerConfig
    lead_s: float = 1.0
    kinds: Tuple[str, ...] = ()
    reference: str = ""
    recall: float = 0.95


def evaluate(seen: Observed, rated: Mapping[str, Rated], testing: Testing) -> Dict[str, Any]:
    """Return figures of the set and, under ``rules``, of each rule by name.

    Frame figures (``pr_auc`` ... ``log_loss``) are over a few frames per pair that pass the gate.
    Event figures: see ``alarms``; ``leads`` the recall against the lead time, ``threshold`` what
    they hold at.
    """
    eligible = is_eligible(seen, testing.lead_s)
    n_contacts = int(is_watched(seen, testing.lead_s).sum())
    votes = {name: voted(seen, rule.score, testing.config) for name, rule in rated.items()}
    goal = _goal(seen, rated, votes, testing)
    rows = thin(seen.pair, ROWS_PER_PAIR, 0)
    rules: Dict[str, Any] = {}
    for name, rule in rated.items():
        best = _best_before(seen, votes[name], testing.lead_s)[eligible]
        cut = rule.threshold if rule.threshold is not None else _cut_at(best, goal)
        found: Dict[str, Any] = dict(metrics.frame_figures(seen.label[rows], rule.score[rows]))
        if rule.probability is not None:
            figures = metrics.probability_figures(seen.label[rows], rule.probability[rows])
            found.update(figures)
        fires = np.isfinite(votes[name]) & (votes[name] >= cut)
        found.update(alarms(seen, fires, testing))
        found["leads"] = _leads(seen, fires)
        found["threshold"] = cut if np.isfinite(cut) else None
        rules[name] = found
    return {
        "n_scenes": len(np.unique(seen.scene)),
        "n_tracks": len(seen.kind),
        "n_frames": len(rows),
        "n_events": int(eligible.sum()),
        "n_contacts": n_contacts,
        "eligible_share": float(eligible.sum() / n_contacts) if n_contacts else None,
        "positive_share": float(seen.label[rows].mean()) if len(rows) else None,
        "lead_s": testing.lead_s,
        "rules": rules,
    }


def alarms(seen: Observed, fires: Array, testing: Testing) -> Dict[str, Any]:
    """Return what firing at ``fires (n, f)`` announces, and what it disturbs.

    ``recall`` of the eligible events, ``lead_s`` ahead; ``negative_frames`` share of all watched
    frames without contact within the horizon that fire, ``moving_negative_frames`` of those that
    pass the gate; ``harmless_tracks`` share of tracks that never touch that fire at all. None where
    there are none. ``by_kind`` how many harmless tracks there are of each kind, ``n``, and how many
    of them ``fired``.
    """
    time = np.arange(fires.shape[1]) * seen.frame_s[:, None]
    left_s = seen.contact_s[:, None] - time
    is_negative = seen.is_judged & ~(left_s <= seen.horizon_s[:, None])
    passes = np.zeros(fires.shape, dtype=bool)
    passes[seen.pair, seen.frame] = True
    is_harmless = ~np.isfinite(seen.contact_s)
    ever = fires.any(axis=1)
    eligible = is_eligible(seen, testing.lead_s)
    announced = _first_s(seen, fires) <= seen.contact_s - testing.lead_s
    return {
        "recall": _share(announced[eligible]),
        "negative_frames": _share(fires[is_negative]),
        "moving_negative_frames": _share(fires[is_negative & passes]),
        "harmless_tracks": _share(ever[is_harmless]),
        "by_kind": _by_kind(ever, is_harmless, seen.kind, testing.kinds),
    }


def summary(evaluation: Mapping[str, Any]) -> Dict[str, Any]:
    """Return an evaluation without its curves against lead time, as a model document keeps it."""
    rules = {
        name: {key: value for key, value in found.items() if key != "leads"}
        for name, found in evaluation["rules"].items()
    }
    return dict(evaluation, rules=rules)


def cut_for(seen: Observed, vote: Array, lead_s: float, recall: float) -> float:
    """Return the highest threshold at which ``vote (n, f)`` announces that share of the events."""
    return _cut_at(_best_before(seen, vote, lead_s)[is_eligible(seen, lead_s)], recall)


def curves(seen: Observed, rated: Mapping[str, Rated]) -> Dict[str, Any]:
    """Return per rule the points of ``pr``, ``roc`` and, with a probability, ``reliability``."""
    rows = thin(seen.pair, ROWS_PER_PAIR, 0)
    label = seen.label[rows]
    found: Dict[str, Any] = {}
    for name, rule in rated.items():
        found[name] = metrics.curves(label, rule.score[rows])
        if rule.probability is not None:
            found[name]["reliability"] = metrics.reliability(label, rule.probability[rows])
    return found


def beside(seen: Observed, inputs: Array, seed: int) -> Dict[str, Rated]:
    """Return the four baselines: speed, analytic rule, the paper's risk, and boosted trees.

    Parameters
    ----------
    inputs : (r, k) what the trees see. They learn on two thirds of the scenes and score the third
        one, in turn: a ceiling for this very set, which no model trained elsewhere has.

    Raises
    ------
    MissingExtraError : scikit-learn is not installed.
    """
    ceiling = _out_of_fold(seen, inputs, seed)
    return {
        SPEED: Rated(baselines.speed_only(seen)),
        ANALYTIC: Rated(baselines.analytic(seen), None, seen.rule_probability),
        PAPER_RISK: Rated(baselines.paper_risk(seen)),
        BOOSTING: Rated(ceiling, None, ceiling),
    }


def _out_of_fold(seen: Observed, inputs: Array, seed: int) -> Array:
    fold = seen.scene[seen.pair] % _N_FOLDS
    rows = thin(seen.pair, ROWS_PER_PAIR, seed)
    found = np.zeros(len(seen.pair))
    for number in range(_N_FOLDS):
        learn, score = rows[fold[rows] != number], fold == number
        label = seen.label[learn]
        if not score.any():
            continue
        if label.all() or not label.any():
            found[score] = float(label.mean()) if len(label) else 0.0
            continue
        found[score] = baselines.gradient_boosting(inputs[learn], label, inputs[score], seed)
    return found


def _goal(
    seen: Observed, rated: Mapping[str, Rated], votes: Mapping[str, Array], testing: Testing
) -> float:
    """Return the event recall that rules without a threshold are held to."""
    reference = rated.get(testing.reference)
    if reference is None or reference.threshold is None:
        return testing.recall
    best = _best_before(seen, votes[testing.reference], testing.lead_s)
    best = best[is_eligible(seen, testing.lead_s)]
    return float(np.mean(best >= reference.threshold)) if len(best) else testing.recall


def _best_before(seen: Observed, vote: Array, lead_s: float) -> Array:
    """Return the best vote (n,) up to ``lead_s`` before contact."""
    time = np.arange(vote.shape[1]) * seen.frame_s[:, None]
    in_time = time <= (seen.contact_s - lead_s)[:, None]
    best: Array = np.where(in_time, vote, -np.inf).max(axis=1)
    return best


def _cut_at(best: Array, recall: float) -> float:
    """Return the highest threshold at which ``recall`` of the events (e,) are announced."""
    if not len(best):
        return float("inf")
    n_hits = int(np.ceil(recall * len(best) - _TINY))
    return float(np.sort(best)[::-1][max(n_hits, 1) - 1])


def _leads(seen: Observed, fires: Array) -> Dict[str, List[Optional[float]]]:
    """Return recall of the eligible, their share, and recall of all contacts by lead time."""
    first_s = _first_s(seen, fires)
    found: Dict[str, List[Optional[float]]] = {"lead_s": list(LEADS_S)}
    found.update(recall=[], eligible_share=[], recall_of_all=[])
    for lead_s in LEADS_S:
        watched, eligible = is_watched(seen, lead_s), is_eligible(seen, lead_s)
        announced = first_s <= seen.contact_s - lead_s
        found["recall"].append(_share(announced[eligible]))
        found["eligible_share"].append(_share(eligible[watched]))
        found["recall_of_all"].append(_share(announced[watched]))
    return found


def _by_kind(
    ever: Array, is_harmless: Array, kind: Array, names: Tuple[str, ...]
) -> Dict[str, Dict[str, int]]:
    found: Dict[str, Dict[str, int]] = {}
    for number, name in enumerate(names):
        mine = is_harmless & (kind == number)
        if mine.any():
            found[name] = {"n": int(mine.sum()), "fired": int(ever[mine].sum())}
    return found


def _first_s(seen: Observed, fires: Array) -> Array:
    """Return when each pair (n,) fires for the first time; NaN, which is never early, if never."""
    time = np.arange(fires.shape[1]) * seen.frame_s[:, None]
    first = np.where(fires, time, np.inf).min(axis=1)
    return np.where(np.isfinite(first), first, np.nan)


def _share(flags: Array) -> Optional[float]:
    return float(np.mean(flags)) if len(flags) else None
