"""Train one linear trigger from a seed: the steps in order, with their seeds and sizes."""

from dataclasses import dataclass
from typing import Any, Callable, Dict

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import export, seeds
from offline_train.trigger.calibrate import Promise, calibrate
from offline_train.trigger.evaluate import Rated, Testing, beside, evaluate, summary
from offline_train.trigger.fit import LinearFit, fit, sklearn_module
from offline_train.trigger.observe import Observed, Watching, observe


@dataclass(frozen=True)
class Sizes:
    """How many scenes are drawn for each step; about one calibration scene in 14 is an event."""

    train: int = 6000
    calibration: int = 16000
    test: int = 6000


def train(
    seed: int, sizes: Sizes, promise: Promise, say: Callable[[str], None] = lambda text: None
) -> Dict[str, Any]:
    """Return the fields of a weights file, trained, certified and tested on four seeds.

    Raises
    ------
    MissingExtraError : scikit-learn is not installed.
    TooFewEventsError : the promise cannot be certified with so few scenes.
    """
    sklearn_module("sklearn")
    config = TriggerConfig()

    def watch(purpose: str, stream: int, n: int, only_contacts: bool = False) -> Observed:
        rng = seeds.rng(purpose, seed, stream)
        return observe(rng, tabletop_pairs.NAME, n, Watching(), config, only_contacts)

    say(f"training on {sizes.train} scenes")
    learnt = watch("train", 0, sizes.train)
    model = fit(learnt, seed)
    say(f"certifying on the contacts of {sizes.calibration} other scenes")
    held = watch("calibration", 0, sizes.calibration, only_contacts=True)
    threshold = calibrate(held, model.logit(held.features), config, promise)
    say(f"testing on {sizes.test} scenes never seen")
    tested = _test(watch("test", 0, sizes.test), model, threshold.logit, promise.lead_s)
    radius = learnt.geometry.radius_m
    notes = {
        "radius_m": [float(radius.min()), float(radius.max())],
        "seed": seed,
        "metrics": {tabletop_pairs.NAME: tested},
    }
    return export.document(export.linear(model), threshold, promise, config, notes)


def _test(seen: Observed, model: LinearFit, threshold: float, lead_s: float) -> Dict[str, Any]:
    logit = model.logit(seen.features)
    rated = {"linear": Rated(logit, threshold, 0.5 * (1.0 + np.tanh(0.5 * logit)))}
    rated.update(beside(seen, seen.features, seed=0))
    testing = Testing(TriggerConfig(), lead_s, tabletop_pairs.KINDS, "linear")
    return summary(evaluate(seen, rated, testing))
