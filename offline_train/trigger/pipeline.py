"""Train one linear trigger from a seed: the steps in order, with their seeds and sizes."""

from dataclasses import dataclass
from typing import Any, Callable, Dict

from apex_edge.triggers.base import TriggerConfig
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import export, seeds
from offline_train.trigger.calibrate import Promise, calibrate
from offline_train.trigger.evaluate import Model, evaluate
from offline_train.trigger.fit import fit, sklearn_module
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
    say(f"testing on {sizes.test + sizes.calibration} scenes never seen")
    scenes = watch("test", 0, sizes.test)
    contacts = watch("test", 1, sizes.calibration, only_contacts=True)
    metrics = evaluate(scenes, contacts, Model(model, threshold.logit, config, promise.lead_s))
    radius = learnt.geometry.radius_m
    notes = {
        "radius_m": [float(radius.min()), float(radius.max())],
        "seed": seed,
        "metrics": metrics,
    }
    return export.document(export.linear(model), threshold, promise, config, notes)
