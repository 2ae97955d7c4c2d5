"""Committed motion at 3 mm and 20 Hz: what several windows at once say of a move's end.

The classifier alone, as in the study the goals come from: rows are every fifth frame of each body
that truly moves (15 mm within the last half second) and has not touched yet, whatever the device's
gate says of it; what the gate would cost is a line of its own. Source: ours.
"""

from typing import Dict, List

import numpy as np

from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import FEATURE_NAMES
from apex_edge.triggers.wide import WIDE_NAMES
from apex_edge.triggers.windows import WINDOWS
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.scenes import committed
from offline_train.trigger import baselines, metrics, seeds
from offline_train.trigger.fit import fit_rows
from offline_train.trigger.observe import Observed, Watching, draw_sensing, look

SUITE = "committed"
N_TRAIN, N_BENCH = 1000, 1000
N_FRAMES = 160
FPS = 20.0
NOISE_M = 0.003
STRIDE = 5
MOVED_M, WITHIN_S = 0.015, 0.5
# What the gate looks at, and the baselines without windows of their own.
GATE_WINDOW = 11
PRECISION, BEHIND_BOOSTING = 0.77, 0.02
FALSE_ALARMS = {"fpr_at_recall_0.90": 0.12, "fpr_at_recall_0.99": 0.25}


def measure(seed: int) -> List[Line]:
    """Measure on scenes of a bench seed."""
    train = draw("train", seed, N_TRAIN, is_gated=False)
    seen = draw("bench", seed, N_BENCH, is_gated=False)
    wide = _linear(train, seen, list(range(len(WIDE_NAMES))))
    boosted = baselines.gradient_boosting(train.wide, train.label, seen.wide, seed)
    best, ceiling = _figures(seen, wide), _figures(seen, boosted)
    gap = ceiling["pr_auc"] - best["pr_auc"]
    lines = [
        at_least(SUITE, "all windows, linear: average precision", best["pr_auc"], PRECISION),
        at_most(SUITE, "all windows: boosting ahead of linear by", gap, BEHIND_BOOSTING),
    ]
    for key, limit in FALSE_ALARMS.items():
        what = f"all windows, linear: false alarms at .{key[-2:]} recall"
        lines.append(at_most(SUITE, what, best[key], limit))
    ece = metrics.calibration_error(seen.label, metrics.sigmoid(wide))
    lines.append(note(SUITE, "all windows, linear: ECE", ece))
    beside: Dict[str, Array] = {"all windows, gradient boosting": boosted}
    for window in WINDOWS:
        columns = [WIDE_NAMES.index(f"{name}_{window}") for name in FEATURE_NAMES]
        beside[f"{window} frames, linear"] = _linear(train, seen, columns)
    beside[f"{GATE_WINDOW} frames, analytic"] = baselines.analytic(seen)
    beside["paper risk"] = baselines.paper_risk(seen)
    beside["speed only"] = baselines.speed_only(seen)
    for name, score in beside.items():
        lines += _notes(name, _figures(seen, score))
    lines.append(note(SUITE, "share of rows within 5 s of contact", float(seen.label.mean())))
    lines.append(note(SUITE, "recall lost to the gate", _lost_to_gate(seen, seed)))
    return lines


def draw(purpose: str, seed: int, n_scenes: int, is_gated: bool) -> Observed:
    """Return the rows of moving bodies; the same scenes with the gate and without."""
    watching = Watching(
        noise_m=(NOISE_M, NOISE_M),
        fps=(FPS, FPS),
        window=(GATE_WINDOW, GATE_WINDOW),
        adaptive_share=0.0,
        misjudged=(1.0, 1.0),
        n_frames=N_FRAMES,
        is_gated=is_gated,
        stride=STRIDE,
        is_wide=not is_gated,
    )
    rng = seeds.rng(purpose, seed)
    sensing = draw_sensing(rng, n_scenes, watching)
    truth = committed.draw(rng, sensing.frame_s, N_FRAMES)
    seen = look(rng, truth, sensing, watching, TriggerConfig())
    back = int(round(WITHIN_S * FPS))
    path = truth.other_m.reshape(-1, N_FRAMES, 2)
    moved = np.linalg.norm(path[:, back:] - path[:, :-back], axis=2) > MOVED_M
    is_moving = np.pad(moved, ((0, 0), (back, 0)))
    return seen.take(is_moving[seen.pair, seen.frame])


def _linear(train: Observed, seen: Observed, columns: List[int]) -> Array:
    """Return the logit (r,) of a fit on these columns of the wide set."""
    names = [WIDE_NAMES[column] for column in columns]
    model = fit_rows(train.wide[:, columns], train.label, names, solver="newton-cholesky")
    return model.logit(seen.wide[:, columns])


def _figures(seen: Observed, score: Array) -> Dict[str, float]:
    found = metrics.frame_figures(seen.label, score)
    return {key: float("nan") if value is None else value for key, value in found.items()}


def _notes(name: str, figures: Dict[str, float]) -> List[Line]:
    return [
        note(SUITE, f"{name}: average precision", figures["pr_auc"]),
        note(SUITE, f"{name}: false alarms at .99 recall", figures["fpr_at_recall_0.99"]),
    ]


def _lost_to_gate(seen: Observed, seed: int) -> float:
    """Return the share of rows before a contact that the device would not even judge."""
    passed = draw("bench", seed, N_BENCH, is_gated=True)
    n_frames = seen.is_judged.shape[1]
    kept = np.isin(seen.pair * n_frames + seen.frame, passed.pair * n_frames + passed.frame)
    return float(np.mean(~kept[seen.label]))
