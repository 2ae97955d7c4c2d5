"""The certificate of the shipped linear model, checked on events that nothing was made on.

The promise is about a population: a fresh sample may fall short of 1 - alpha by its own sampling
error, so the limit is the one that a model which just keeps its promise would fall below in one
run of twenty. Source: ours; see ``offline_train.trigger.calibrate``.
"""

import math
from dataclasses import replace
from typing import Any, Dict, List, Mapping

import numpy as np

from apex_edge.triggers import model_file, weights
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import seeds
from offline_train.trigger.calibrate import (
    certified_rank,
    event_scores,
    is_watched,
)
from offline_train.trigger.certify import gate_of
from offline_train.trigger.fit import ROWS_PER_PAIR, thin
from offline_train.trigger.metrics import calibration_error
from offline_train.trigger.observe import Observed, Watching, draw_sensing, look, observe
from offline_train.trigger.scoring import RULE_SURE, device_scorer, scorer

_SUITE = "certificate"
_N_CONTACT_SCENES, _N_SHIFTED = 16000, 600
_N_PARTS, _N_SCENES = 10, 4000
_N_DRAWS = 2000
_SLACK = 0.05
_ALPHA, _N_CALIBRATION = 0.05, 120
_NOISE_FACTOR, _SPEED_FACTOR = 4.0, 3.0


def measure(seed: int) -> List[Line]:
    """Verify the promise, how often a calibration breaks it, the calibration, and the drift."""
    fields = model_file.read(weights.SHIPPED)
    config, promise = gate_of(fields), fields["threshold"]
    contacts = observe(
        seeds.rng("bench", seed, 0),
        tabletop_pairs.NAME,
        _N_CONTACT_SCENES,
        Watching(),
        config,
        only_contacts=True,
    )
    scores = event_scores(contacts, device_scorer(fields)(contacts), config, promise["lead_s"])
    n_contacts = int(is_watched(contacts, promise["lead_s"]).sum())
    lines = _promise(scores, n_contacts, promise)
    lines += _resampled(scores, seeds.rng("bench", seed, 1))
    return lines + _calibration(fields, seed) + _drift(fields, seed)


def binomial_slack(p: float, n: int) -> float:
    """Return the smallest share x of n such that more than x has a chance of 5 % at most."""
    total = 0.0
    for k in range(n + 1):
        choose = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
        total += math.exp(choose + k * math.log(p) + (n - k) * math.log1p(-p))
        if total >= 1.0 - _SLACK:
            return k / n
    return 1.0


def _promise(scores: Array, n_contacts: int, promise: Mapping[str, Any]) -> List[Line]:
    n, alpha = len(scores), float(promise["alpha"])
    recall = float(np.mean(scores >= promise["logit"]))
    least = 1.0 - binomial_slack(alpha, n)
    what = (
        f"recall of {n} fresh events {promise['lead_s']:g} s ahead "
        f"(promised {1.0 - alpha:.3f}, less the sampling error)"
    )
    return [
        at_least(_SUITE, what, recall, least, "{:.4f}"),
        note(
            _SUITE,
            "share of contacts that show enough, early enough, to count",
            n / n_contacts,
            "{:.3f}",
        ),
    ]


def _resampled(scores: Array, random: np.random.Generator) -> List[Line]:
    """Calibrate again and again on events drawn from the pool, which stands for the world."""
    pool, drawn = np.sort(scores), random.choice(scores, size=(_N_DRAWS, _N_CALIBRATION))
    drawn.sort(axis=1)

    def broken(rank: int) -> float:
        missed = np.searchsorted(pool, drawn[:, rank - 1], side="left") / len(pool)
        return float(np.mean(missed > _ALPHA))

    about = f"share of {_N_DRAWS} calibrations on {_N_CALIBRATION} events that miss over {_ALPHA}"
    sure = broken(certified_rank(_N_CALIBRATION, _ALPHA, 1.0 - _SLACK))
    plain = broken(int(_ALPHA * (_N_CALIBRATION + 1)))
    return [
        at_most(_SUITE, f"{about}, 95 % form", sure, binomial_slack(_SLACK, _N_DRAWS)),
        note(_SUITE, f"{about}, expected form", plain),
    ]


def _calibration(fields: Dict[str, Any], seed: int) -> List[Line]:
    """Compare probability and frequency on a few frames of each pair, as the model was fitted."""
    model, score = weights.check(fields, "shipped"), scorer(fields)
    chances, labels = [], []
    for part in range(_N_PARTS):
        seen = _watch(fields, seed, 10 + part, _N_SCENES, Watching())
        kept = seen.take(thin(seen.pair, ROWS_PER_PAIR, part))
        chances.append(model.probability(score(kept)))
        labels.append(kept.label)
    chance, label = np.concatenate(chances), np.concatenate(labels)
    random = seeds.rng("bench", seed, 5)
    perfect = [calibration_error(random.random(len(chance)) < chance, chance) for _ in range(20)]
    return [
        at_most(
            _SUITE,
            f"ECE on {_N_PARTS * _N_SCENES} fresh scenes",
            calibration_error(label, chance),
            0.01,
            "{:.4f}",
        ),
        note(_SUITE, "ECE of a perfect model on so few", float(np.mean(perfect)), "{:.4f}"),
    ]


def _drift(fields: Dict[str, Any], seed: int) -> List[Line]:
    """Say which share of rows is flagged out of domain on scenes like and unlike those learnt."""
    usual = Watching()
    low, high = usual.noise_m
    noisy = replace(usual, noise_m=(_NOISE_FACTOR * low, _NOISE_FACTOR * high))
    shown = {
        "as learnt": _watch(fields, seed, 2, _N_SHIFTED, usual),
        f"noise x{_NOISE_FACTOR:g}": _watch(fields, seed, 3, _N_SHIFTED, noisy),
        f"speeds x{_SPEED_FACTOR:g}": _watch(fields, seed, 4, _N_SHIFTED, usual, _SPEED_FACTOR),
    }
    score = device_scorer(fields)
    return [
        note(
            _SUITE,
            f"rows flagged out of domain, {name}",
            float(np.mean(np.abs(score(seen)) >= RULE_SURE)),
            "{:.3f}",
        )
        for name, seen in shown.items()
    ]


def _watch(
    fields: Dict[str, Any],
    seed: int,
    stream: int,
    n: int,
    watching: Watching,
    faster: float = 1.0,
) -> Observed:
    """Draw fresh scenes and look at them; ``faster`` lets the same paths be run through faster."""
    random = seeds.rng("bench", seed, stream)
    sensing = draw_sensing(random, n, watching)
    truth = tabletop_pairs.draw(random, faster * sensing.frame_s, watching.n_frames)
    truth = replace(truth, frame_s=sensing.frame_s, contact_s=truth.contact_s / faster)
    return look(random, truth, sensing, watching, gate_of(fields))
