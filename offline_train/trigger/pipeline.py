"""Train one linear trigger from a seed: the steps in order, with their seeds and sizes."""

from dataclasses import dataclass
from typing import Any, Callable, Dict

from apex_edge.triggers.base import TriggerConfig
from offline_train.trigger import export
from offline_train.trigger.calibrate import Promise, calibrate
from offline_train.trigger.evaluate import Model, evaluate
from offline_train.trigger.fit import fit, sklearn_module
from offline_train.trigger.observe import observe


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
    parts = ("train", "calibration", "test", "test_events")
    seeds = {part: len(parts) * seed + number for number, part in enumerate(parts)}
    say(f"training on {sizes.train} scenes")
    learnt = observe(seeds["train"], sizes.train, config)
    model = fit(learnt, seed)
    say(f"certifying on the contacts of {sizes.calibration} other scenes")
    held = observe(seeds["calibration"], sizes.calibration, config, only_contacts=True)
    threshold = calibrate(held, model.logit(held.features), config, promise)
    say(f"testing on {sizes.test + sizes.calibration} scenes never seen")
    scenes = observe(seeds["test"], sizes.test, config)
    contacts = observe(seeds["test_events"], sizes.calibration, config, only_contacts=True)
    metrics = evaluate(scenes, contacts, Model(model, threshold.logit, config, promise.lead_s))
    notes = {
        "radius_m": [float(learnt.radius_m.min()), float(learnt.radius_m.max())],
        "seeds": seeds,
        "metrics": metrics,
    }
    return export.document(model, threshold, promise, config, notes)
