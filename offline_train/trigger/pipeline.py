"""Train one trigger from a seed: draw, fit, certify, test. The single steps, one after another."""

from dataclasses import dataclass
from typing import Any, Callable, Dict, Tuple

from offline_train.reports import evaluation, sources
from offline_train.reports.card import Tested
from offline_train.scenes import tabletop_pairs
from offline_train.trigger import data, learn
from offline_train.trigger.calibrate import Promise
from offline_train.trigger.certify import certify
from offline_train.trigger.observe import Observed, Watching
from offline_train.trigger.scoring import device_scorer


@dataclass(frozen=True)
class Sizes:
    """How many scenes are drawn for each step; about one calibration scene in 14 is an event."""

    train: int = 6000
    calibration: int = 16000
    test: int = 6000


def train(
    name: str,
    seed: int,
    sizes: Sizes,
    promise: Promise,
    say: Callable[[str], None] = lambda text: None,
) -> Tuple[Dict[str, Any], Tested]:
    """Train, certify and test on scenes of its own; return the model document and its test.

    Parameters
    ----------
    name : see ``learn.fit``.

    Raises
    ------
    MissingExtraError : scikit-learn, or PyTorch for a graph model, is not installed.
    PluginError : no model of that name.
    TooFewEventsError : the promise cannot be certified with so few scenes.
    """
    learn.check_packages(name)
    watching = Watching(is_wide=name == learn.WIDE)

    def described(purpose: str, n: int, only_contacts: bool = False) -> data.Description:
        return data.describe(tabletop_pairs.NAME, purpose, seed, n, watching, only_contacts)

    say(f"training on {sizes.train} scenes")
    about = described("train", sizes.train)
    fields = _fitted(data.draw(about), about, name, seed)
    say(f"certifying on the contacts of {sizes.calibration} other scenes")
    about = described("calibration", sizes.calibration, only_contacts=True)
    fields = certify(fields, data.draw(about), promise, {"kind": "generated", **data.origin(about)})
    say(f"testing on {sizes.test} scenes never seen")
    about = described("test", sizes.test)
    held = evaluation.Data(
        tabletop_pairs.NAME, data.draw(about), tabletop_pairs.KINDS, data.origin(about)
    )
    model = evaluation.Model(fields, device_scorer(fields))
    tested = evaluation.examine(held, {name: model}, sources.ceiling_inputs)
    return evaluation.finished(fields, [tested]), tested


def _fitted(seen: Observed, description: data.Description, name: str, seed: int) -> Dict[str, Any]:
    trained = learn.fit(seen, learn.targets(seen, "truth"), name, seed)
    made = {"label": "truth", "model": name, "seed": seed, "libraries": learn.libraries(trained)}
    return learn.document(trained, seen, description, made)
