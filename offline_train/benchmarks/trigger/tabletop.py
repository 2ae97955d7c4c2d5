"""Uniform motion on the tabletop at 3 mm and 20 Hz: what the length of the window buys.

Each pair is judged once. All figures are over ALL pairs not yet in contact, moving or not. The
goals are about the classifier alone, so that it gets no credit for what the device's gate drops: at
15 frames the gate alone leaves fewer false alarms than the goal. Notes say what the device does
behind its gate, where a dropped pair has the lowest score, for it can never fire. Source: ours.
"""

from dataclasses import dataclass
from typing import Dict, List, Optional

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_most, note
from offline_train.trigger import baselines, metrics, seeds
from offline_train.trigger.fit import LinearFit, fit
from offline_train.trigger.observe import Observed, Watching, observe

SUITE = "tabletop"
SCENARIO = "tabletop-cv"
N_TRAIN, N_BENCH = 8000, 10000
FPS = 20.0
NOISE_M = 0.003


@dataclass(frozen=True)
class Setting:
    """A window and a horizon; ``limit`` of false alarms at 0.99 recall, ``brier`` of the score."""

    window: int
    horizon_s: float
    limit: Optional[float]
    brier: Optional[float]

    def watching(self, is_gated: bool) -> Watching:
        """Return how the scenes are watched: each pair has one full window, at the end."""
        return Watching(
            noise_m=(NOISE_M, NOISE_M),
            fps=(FPS, FPS),
            window=(self.window, self.window),
            adaptive_share=0.0,
            misjudged=(1.0, 1.0),
            n_frames=self.window,
            horizon_s=self.horizon_s,
            is_gated=is_gated,
        )

    def __str__(self) -> str:
        """Name the setting."""
        return f"{self.window} frames, {self.horizon_s:g} s"


SETTINGS = (
    Setting(15, 5.0, 0.07, 0.022),
    Setting(20, 5.0, 0.045, None),
    Setting(15, 3.0, 0.03, None),
    Setting(5, 5.0, None, 0.065),
)
ECE = 0.01


def measure(seed: int) -> List[Line]:
    """Measure all settings on scenes of a bench seed."""
    lines: List[Line] = []
    for setting in SETTINGS:
        train = _draw("train", setting, seed, is_gated=False)
        seen = _draw("bench", setting, seed, is_gated=False)
        model = fit(train, seed)
        lines += _false_alarms(setting, model, train, seen)
        lines += _behind_gate(setting, model, _draw("bench", setting, seed, is_gated=True))
        if setting.brier is not None:
            lines += _calibration(setting, setting.brier, model, seen)
    return lines


def _false_alarms(
    setting: Setting, model: LinearFit, train: Observed, seen: Observed
) -> List[Line]:
    boosted = baselines.gradient_boosting(train.features, train.label, seen.features, 0)
    scores: Dict[str, Array] = {
        "linear": model.logit(seen.features),
        "speed only": baselines.speed_only(seen),
        "analytic": baselines.analytic(seen),
        "paper risk": baselines.paper_risk(seen),
        "gradient boosting": boosted,
    }
    lines: List[Line] = []
    for name, score in scores.items():
        what = f"{setting}, {name}: false alarms at .99 recall"
        alarms = _alarms(seen.label, score)
        if name == "linear" and setting.limit is not None:
            lines.append(at_most(SUITE, what, alarms, setting.limit))
        else:
            lines.append(note(SUITE, what, alarms))
    return lines


def _behind_gate(setting: Setting, model: LinearFit, seen: Observed) -> List[Line]:
    """Say what the device would do: the same model, but the gate has the first word."""
    label = _labels(seen)
    score = _everywhere(seen, model.logit(seen.features))
    is_kept = np.isfinite(score)
    where = f"{setting}, behind the gate"
    return [
        note(SUITE, f"{where}, linear: false alarms at .99 recall", _alarms(label, score)),
        note(SUITE, f"{where}: share of harmless pairs judged", float(is_kept[~label].mean())),
        note(SUITE, f"{where}: recall lost to it", float(np.mean(~is_kept[label]))),
    ]


def _calibration(setting: Setting, brier: float, model: LinearFit, seen: Observed) -> List[Line]:
    probability = metrics.sigmoid(model.logit(seen.features))
    found = metrics.probability_figures(seen.label, probability)
    return [
        at_most(SUITE, f"{setting}, linear: ECE, {metrics.N_BINS} bins", found["ece"], ECE),
        at_most(SUITE, f"{setting}, linear: Brier", found["brier"], brier),
        note(SUITE, f"{setting}: share of pairs that touch", float(seen.label.mean())),
    ]


def _alarms(label: Array, score: Array) -> float:
    value = metrics.frame_figures(label, score)["fpr_at_recall_0.99"]
    return float("nan") if value is None else value


def _draw(purpose: str, setting: Setting, seed: int, is_gated: bool) -> Observed:
    n_scenes = N_TRAIN if purpose == "train" else N_BENCH
    rng = seeds.rng(purpose, seed)
    return observe(rng, SCENARIO, n_scenes, setting.watching(is_gated), TriggerConfig())


def _labels(seen: Observed) -> Array:
    """Return for each pair not yet in contact in the last frame whether it comes to it (e,)."""
    time_s = (seen.is_judged.shape[1] - 1) * seen.frame_s
    label: Array = (seen.contact_s - time_s <= seen.horizon_s)[seen.is_judged[:, -1]]
    return label


def _everywhere(seen: Observed, score: Array) -> Array:
    """Return the score of each such pair (e,), -inf where the gate has dropped it."""
    full = np.full(len(seen.kind), -np.inf)
    full[seen.pair] = score
    scores: Array = full[seen.is_judged[:, -1]]
    return scores
