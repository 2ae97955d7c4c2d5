"""Events on committed motion: announced 1 s ahead, and what is disturbed for it.

A model learns on "train" scenes, its threshold is certified for a recall of .95 on "calibration"
scenes, and everything is counted on "bench" scenes. Speed alone, the k-sigma rule, the paper's risk
and boosted trees stand beside it, at the recall the model has on the bench scenes. Source: ours;
goals from the project's study of the trigger.
"""

from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Tuple

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.triggers.wide import WIDE_NAMES
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.scenes import committed
from offline_train.trigger import baselines, calibrate, evaluate, seeds
from offline_train.trigger.evaluate import Rated
from offline_train.trigger.fit import ROWS_PER_PAIR, fit_rows, thin
from offline_train.trigger.observe import Observed, Watching, observe

SUITE = "events"
N_SCENES = 1200
# 8 s at 20 Hz; 3 mm is the noise of a cheap camera, 11 frames the window of the motion fit.
WATCHING = Watching(
    noise_m=(0.003, 0.003),
    fps=(20.0, 20.0),
    window=(11, 11),
    adaptive_share=0.0,
    n_frames=160,
    is_wide=True,
)
PROMISE = calibrate.Promise(alpha=0.05, confidence=0.95, lead_s=1.0)
_LEADS_S = (0.2, 0.6, 1.0, 1.4, 2.0, 3.0)
_VOTES = ((1, 1), (2, 3), (3, 5), (5, 8))
# What a frame must exceed, what is kept of the sum from frame to frame, where the sum ends: among
# the best of a grid on calibration seeds. It stays a rival on the bench. Against a vote of 3 of 5
# (wide features, three ways of watching, same recall) it has 13, 28 and 29 % fewer negative frames
# at .99 and 10 to 16 % at .95; but a vote of 2 of 3 has 8 to 21 % and 6 to 12 % fewer as well. What
# both gain by is firing earlier, and 1 of 1 gains most; white noise has none of the lone outliers
# that a vote is there for. The rest does not pay for a threshold that is no logit any more, nor for
# a start that must fit the model: on fused12, at -0.5, every frame behind the gate fires.
_LEAKY = (-2.0, 0.5, 5.0)


# Each maps the rows of a set to inputs (r, k) and has their names; the first must keep the goals.
MODELS: Dict[str, Tuple[Callable[[Observed], Array], Tuple[str, ...]]] = {
    "wide": (lambda seen: seen.wide, WIDE_NAMES),
    "fused12": (lambda seen: seen.features, FEATURE_NAMES),
}


class _Sets(NamedTuple):
    learnt: Observed
    held: Observed
    fresh: Observed


class _Certified(NamedTuple):
    logit: Array
    threshold: calibrate.Threshold


def measure(seed: int) -> List[Line]:
    """Return the lines of one seed.

    Raises
    ------
    MissingExtraError : scikit-learn is not installed.
    TooFewEventsError : the recall cannot be certified.
    """
    config = TriggerConfig()
    sets = _Sets(
        *(
            observe(seeds.rng(purpose, seed), committed.NAME, N_SCENES, WATCHING, config)
            for purpose in ("train", "calibration", "bench")
        )
    )
    models = {name: _certified(name, sets, seed) for name in MODELS}
    first = next(iter(models))
    rated = {name: Rated(m.logit, m.threshold.logit) for name, m in models.items()}
    rated.update(_beside(sets, MODELS[first][0], seed))
    testing = evaluate.Testing(config, PROMISE.lead_s, committed.KINDS, first)
    found = evaluate.evaluate(sets.fresh, rated, testing)
    rules, threshold = found["rules"], models[first].threshold
    lines = _goals(first, rules[first])
    lines += [
        note(SUITE, "events certified on", threshold.n_pos, "{:.0f}"),
        note(SUITE, "of these below the threshold, at most", threshold.k - 1, "{:.0f}"),
        note(SUITE, "events tested on", found["n_events"], "{:.0f}"),
        note(SUITE, "eligible share of contacts", found["eligible_share"]),
    ]
    lines += [_row(name, figures) for name, figures in rules.items()]
    lines += _leads(rules[first]["leads"])
    return lines + _votes(sets.fresh, models[first].logit, rules[first]["recall"])


def leaky_sum(seen: Observed, logit: Array, start: float, keep: float, limit: float) -> Array:
    """Return per pair and frame (n, f) a leaky sum of what the logit exceeds ``start`` by.

    s = clip(keep * s + logit - start, 0, limit); a frame that fails the gates empties the sum.
    """
    add = np.full(seen.is_judged.shape, -limit)
    add[seen.pair, seen.frame] = logit - start
    is_row = np.zeros(seen.is_judged.shape, dtype=bool)
    is_row[seen.pair, seen.frame] = True
    total, sums = np.zeros(len(add)), np.empty_like(add)
    for frame in range(add.shape[1]):
        total = np.clip(keep * total + add[:, frame], 0.0, limit)
        sums[:, frame] = total
    result: Array = np.where(is_row, sums, -np.inf)
    return result


def _certified(name: str, sets: _Sets, seed: int) -> _Certified:
    """Fit one model, certify it, and return its logits on the bench scenes."""
    inputs, names = MODELS[name]
    rows = thin(sets.learnt.pair, ROWS_PER_PAIR, seed)
    model = fit_rows(
        inputs(sets.learnt)[rows], sets.learnt.label[rows], names, solver="newton-cholesky"
    )
    held = model.logit(inputs(sets.held))
    threshold = calibrate.calibrate(sets.held, held, TriggerConfig(), PROMISE)
    return _Certified(model.logit(inputs(sets.fresh)), threshold)


def _beside(sets: _Sets, inputs: Callable[[Observed], Array], seed: int) -> Dict[str, Rated]:
    """Return the baselines; the trees see what the model sees and learn from what it learnt."""
    rows = thin(sets.learnt.pair, ROWS_PER_PAIR, seed)
    ceiling = baselines.gradient_boosting(
        inputs(sets.learnt)[rows], sets.learnt.label[rows], inputs(sets.fresh), seed
    )
    return {
        evaluate.SPEED: Rated(baselines.speed_only(sets.fresh)),
        evaluate.ANALYTIC: Rated(baselines.analytic(sets.fresh)),
        evaluate.PAPER_RISK: Rated(baselines.paper_risk(sets.fresh)),
        evaluate.BOOSTING: Rated(ceiling),
    }


def _goals(name: str, figures: Mapping[str, Any]) -> List[Line]:
    lead = f"{PROMISE.lead_s:.1f} s before contact"
    return [
        at_least(SUITE, f"{name}: eligible events announced {lead}", figures["recall"], 0.95),
        at_most(SUITE, f"{name}: negative frames firing", figures["negative_frames"], 0.05),
        at_most(SUITE, f"{name}: far movers firing", _kind(figures, " far"), 0.30),
        at_most(SUITE, f"{name}: static tracks firing", _kind(figures, "static"), 0.03),
    ]


def _kind(figures: Mapping[str, Any], ending: str) -> float:
    """Return the share of harmless tracks firing among all kinds with that ending."""
    mine = [count for kind, count in figures["by_kind"].items() if kind.endswith(ending)]
    return sum(count["fired"] for count in mine) / max(1, sum(count["n"] for count in mine))


def _row(name: str, figures: Mapping[str, Any]) -> Line:
    shown = {
        "recall": figures["recall"],
        "negative": figures["negative_frames"],
        "gated": figures["moving_negative_frames"],
        "near miss": _kind(figures, " near miss"),
        "far": _kind(figures, " far"),
        "static": _kind(figures, "static"),
    }
    text = ", ".join(f"{key} {100.0 * value:.1f} %" for key, value in shown.items())
    return Line(SUITE, f"{name}: alarms at this recall", text, figures=shown)


def _leads(leads: Mapping[str, Any]) -> List[Line]:
    lines = []
    for lead_s in _LEADS_S:
        at = leads["lead_s"].index(lead_s)
        shown = {key: leads[key][at] for key in ("recall", "eligible_share", "recall_of_all")}
        text = (
            f"{100.0 * shown['recall']:.1f} % of the {100.0 * shown['eligible_share']:.1f} % "
            f"eligible; {100.0 * shown['recall_of_all']:.1f} % of all contacts"
        )
        lines.append(Line(SUITE, f"announced {lead_s:.1f} s ahead", text, figures=shown))
    return lines


def _votes(seen: Observed, logit: Array, recall: float) -> List[Line]:
    """Return what other votes, and a leaky sum instead of one, cost at the same recall."""
    filters = {"leaky sum": leaky_sum(seen, logit, *_LEAKY)}
    for n_hits, n_frames in _VOTES:
        config = TriggerConfig(persist_hits=n_hits, persist_frames=n_frames)
        filters[f"vote {n_hits} of {n_frames}"] = calibrate.voted(seen, logit, config)
    testing = evaluate.Testing(TriggerConfig(), PROMISE.lead_s, committed.KINDS)
    lines = []
    for name, vote in filters.items():
        cut = evaluate.cut_for(seen, vote, PROMISE.lead_s, recall)
        fires = np.isfinite(vote) & (vote >= cut)
        lines.append(_row(name, evaluate.alarms(seen, fires, testing)))
    return lines
