"""Position and speed from sightings, simulated: against the paper's windows and the limit.

30 frames/s with 3 ms jitter of the frame times, stamped with the true capture time; 400 px/s in a
random direction; 0.5 px of noise per axis. Errors are those along the path, one axis, RMS over all
trials. Source: shared conditions of facts and paper; the estimators of the paper's code are peers.
"""

from dataclasses import dataclass
from typing import Callable, Dict, List, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.perception.motion import MotionEstimator, MotionRules
from apex_edge.perception.settings import PerceptionConfig
from apex_edge.types import Array
from apex_edge.verbs.progress import Progress
from offline_train.benchmarks.lines import Line, at_most, note
from offline_train.benchmarks.perception import peer

FPS = 30.0
JITTER_S = 0.003
SPEED_PX_S = 400.0
NOISE_PX = 0.5
SLOWING_PX_S2 = 600.0
OUTLIER_SHARE, OUTLIER_PX = 0.05, 40.0
CHANGE_S = 0.1  # a bounce or start lies this far back
N_SIGHTINGS = 30
N_TRIALS = 2000
N_PHASES = 10
LIMIT_RATIO = 1.15
N_CHECKED = (5, 10, 20)

Path = Callable[[Array], Tuple[Array, Array]]
"""Times (n, m) -> way along the path (n, m) px and speed (n, m) px/s."""


class Trials(NamedTuple):
    """Sightings of n tracks: ``t_s (n, m)``, noisy ``x_px (n, m, 2)``, truth along ``way (n, 2)``.

    ``true_px``, ``true_px_s (n, m)`` are along the path; ``is_outlier (n, m)``.
    """

    t_s: Array
    x_px: Array
    way: Array
    true_px: Array
    true_px_s: Array
    is_outlier: Array


@dataclass(frozen=True)
class Errors:
    """Errors along the path after each sighting: ``pos_px (n, m)``, ``speed_px_s (n, m)``."""

    pos_px: Array
    speed_px_s: Array
    has_speed: Array

    def at(self, n_seen: int) -> Tuple[float, float]:
        """Return RMS position and speed error after ``n_seen`` sightings (-1: the last)."""
        column = n_seen - 1 if n_seen > 0 else n_seen
        return rms(self.pos_px[:, column]), rms(self.speed_px_s[:, column])


def rules_px(config: PerceptionConfig) -> MotionRules:
    """Return what the tracker takes for granted in pixels."""
    return MotionRules(
        speed_sd=config.speed_sd_px_s,
        acc_sd=config.acc_sd_px_s2,
        stamp_sd_s=config.stamp_sd_s,
        window=config.window,
        min_samples=config.min_samples,
        gate_sigma=config.gate_sigma,
        max_gap_s=config.max_miss_s,
    )


def rms(values: Array) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def steady(t: Array) -> Tuple[Array, Array]:
    """Move on at one speed."""
    return SPEED_PX_S * t, np.full_like(t, SPEED_PX_S)


def bounce(t: Array) -> Tuple[Array, Array]:
    """Come, turn about at once 0.1 s before the end, and go at the same speed."""
    return SPEED_PX_S * np.abs(t + CHANGE_S), SPEED_PX_S * np.sign(t + CHANGE_S)


def start(t: Array) -> Tuple[Array, Array]:
    """Rest, and move from 0.1 s before the end on."""
    since = np.maximum(t + CHANGE_S, 0.0)
    return SPEED_PX_S * since, SPEED_PX_S * (since > 0.0)


def slowing(t: Array) -> Tuple[Array, Array]:
    """Slow down evenly, with 400 px/s left at the end."""
    return SPEED_PX_S * t - 0.5 * SLOWING_PX_S2 * t * t, SPEED_PX_S - SLOWING_PX_S2 * t


def draw(
    rng: np.random.RandomState, path: Path, n_trials: int, outlier_share: float = 0.0
) -> Trials:
    """Return the sightings of ``n_trials`` tracks that end at about t = 0."""
    shape = (n_trials, N_SIGHTINGS)
    t_s = np.arange(1 - N_SIGHTINGS, 1) / FPS + JITTER_S * rng.standard_normal(shape)
    t_s = np.sort(t_s, axis=1)
    angle = rng.uniform(0.0, 2.0 * np.pi, n_trials)
    way = np.column_stack([np.cos(angle), np.sin(angle)])
    along, speed = path(t_s)
    x_px = along[..., None] * way[:, None, :] + NOISE_PX * rng.standard_normal((*shape, 2))
    is_outlier = rng.uniform(size=shape) < outlier_share
    # along the path, either way: all of it goes into the error that is measured
    jump = OUTLIER_PX * is_outlier * np.where(rng.uniform(size=shape) < 0.5, 1.0, -1.0)
    x_px += jump[..., None] * way[:, None, :]
    return Trials(t_s, x_px, way, along, speed, is_outlier)


def follow(trials: Trials, rules: MotionRules, read_at: Sequence[int]) -> Errors:
    """Feed each track to an estimator of its own, and read it after those sightings."""
    shape = trials.t_s.shape
    pos, speed = np.full(shape, np.nan), np.full(shape, np.nan)
    has_speed = np.zeros(shape, dtype=bool)
    wanted = {n_seen - 1 if n_seen > 0 else shape[1] + n_seen for n_seen in read_at}
    for i in range(shape[0]):
        estimator, way = MotionEstimator(rules), trials.way[i]
        for k in range(shape[1]):
            t_s = float(trials.t_s[i, k])
            estimator.add(t_s, trials.x_px[i, k], NOISE_PX)
            if k not in wanted:
                continue
            state = estimator.predict(t_s)
            pos[i, k] = state.x @ way - trials.true_px[i, k]
            speed[i, k] = state.v @ way - trials.true_px_s[i, k]
            has_speed[i, k] = bool(np.any(state.v != 0.0))
    return Errors(pos, speed, has_speed)


def limit_px_s(t_s: Array, n_samples: int, upto: int) -> float:
    """Return the Cramer-Rao limit of the speed, RMS over tracks, from the times really drawn."""
    t = t_s[:, upto - n_samples : upto]
    spread = np.square(t - t.mean(axis=1, keepdims=True)).sum(axis=1)
    return rms(NOISE_PX / np.sqrt(spread))


def peer_speed_error(trials: Trials, speed_of: Callable[[Array, Array], Array]) -> float:
    """Return the RMS error of another estimator's speed along the path at the last sighting."""
    found = (speed_of(trials.t_s, trials.x_px) * trials.way).sum(axis=1)
    return rms(found - trials.true_px_s[:, -1])


def peer_pos_error(trials: Trials) -> float:
    """Return the RMS error of the paper's position along the path at the last sighting."""
    found = (peer.mean_of_five(trials.x_px) * trials.way).sum(axis=1)
    return rms(found - trials.true_px[:, -1])


def measure(seed: int, n_trials: int = N_TRIALS, is_quiet: bool = False) -> List[Line]:
    """Simulate all kinds of motion and return their lines."""
    config = PerceptionConfig()
    rules = rules_px(config)
    rng = np.random.RandomState(seed)
    lines: List[Line] = []
    parts = (_steady, _window_of_ten, _outliers, _bounce, _bounce_any_phase, _for_information)
    with Progress("kinds of motion", len(parts), is_quiet) as progress:
        for part in parts:
            lines += part(rng, rules, n_trials)
            progress.advance()
    return lines


def _steady(rng: np.random.RandomState, rules: MotionRules, n_trials: int) -> List[Line]:
    trials = draw(rng, steady, n_trials)
    errors = follow(trials, rules, (1, 2, 3, *N_CHECKED, -1))
    now_px, _ = errors.at(-1)
    lines = [
        at_most("motion", "position now at 400 px/s, RMS px", now_px, 0.5),
        note("motion", "  the paper's mean of five", peer_pos_error(trials), "{:.1f}"),
    ]
    for n_seen in N_CHECKED:
        ratio = errors.at(n_seen)[1] / limit_px_s(trials.t_s, n_seen, n_seen)
        what = f"steady speed after {n_seen} sightings, x Cramer-Rao limit"
        lines.append(at_most("motion", what, ratio, LIMIT_RATIO))
    first = [n for n in (1, 2, 3) if errors.has_speed[:, n - 1].all()]
    lines.append(
        at_most("motion", "sightings until the first speed", min(first + [99]), 3.0, "{:.0f}")
    )
    ratio = errors.at(3)[1] / limit_px_s(trials.t_s, 3, 3)
    lines.append(note("motion", "  that first speed, x Cramer-Rao limit", ratio))
    return lines


def _window_of_ten(rng: np.random.RandomState, rules: MotionRules, n_trials: int) -> List[Line]:
    trials = draw(rng, steady, n_trials)
    errors = follow(trials, rules._replace(window=10), (-1,))
    speed = errors.at(-1)[1]
    limit = limit_px_s(trials.t_s, 10, N_SIGHTINGS)
    paper = peer_speed_error(trials, peer.two_windows)
    return [
        at_most("motion", "steady speed, window of 10, x limit", speed / limit, LIMIT_RATIO),
        note("motion", "  the paper's two windows, x limit", paper / limit),
    ]


def _outliers(rng: np.random.RandomState, rules: MotionRules, n_trials: int) -> List[Line]:
    trials = draw(rng, steady, n_trials, OUTLIER_SHARE)
    errors = follow(trials, rules, (10, -1))
    is_hit = trials.is_outlier[:, -1]
    speed = errors.speed_px_s[:, -1]
    return [
        at_most("motion", "5 % outliers of 40 px: speed, RMS px/s, all trials", rms(speed), 3.0),
        *_peers(trials),
        note("motion", "  ours where the newest sighting is one", rms(speed[is_hit])),
        note("motion", "  ours, 95 % within", float(np.percentile(np.abs(speed), 95.0))),
        note("motion", "  ours after 10 sightings", errors.at(10)[1]),
        note("motion", "  ours, position now, RMS px", errors.at(-1)[0]),
    ]


def _bounce(rng: np.random.RandomState, rules: MotionRules, n_trials: int) -> List[Line]:
    trials = draw(rng, bounce, n_trials)
    speed = follow(trials, rules, (-1,)).at(-1)[1]
    what = "100 ms after a bounce: speed, RMS px/s"
    return [at_most("motion", what, speed, 15.0), *_peers(trials)]


def _bounce_any_phase(rng: np.random.RandomState, rules: MotionRules, n_trials: int) -> List[Line]:
    """Let the bounce fall anywhere between two frames, three sightings before the end."""
    share = np.sort(rng.uniform(size=(n_trials, 1)), axis=0)

    def path(t: Array) -> Tuple[Array, Array]:
        since = t - (share * t[:, -4:-3] + (1.0 - share) * t[:, -3:-2])
        return SPEED_PX_S * np.abs(since), SPEED_PX_S * np.sign(since)

    errors = follow(draw(rng, path, n_trials), rules, (-1,)).speed_px_s[:, -1]
    by_phase = [rms(part) for part in np.array_split(errors, N_PHASES) if len(part)]
    what = "third sighting after a bounce between frames: speed, RMS px/s"
    return [
        at_most("motion", what, rms(errors), 15.0),
        note("motion", "  the worst tenth of all phases", max(by_phase)),
        note("motion", "  95 % within", float(np.percentile(np.abs(errors), 95.0))),
    ]


def _for_information(rng: np.random.RandomState, rules: MotionRules, n_trials: int) -> List[Line]:
    lines: List[Line] = []
    kinds: Dict[str, Path] = {"slowing by 600 px/s^2": slowing, "started 100 ms ago": start}
    for name, path in kinds.items():
        trials = draw(rng, path, n_trials)
        speed = follow(trials, rules, (-1,)).at(-1)[1]
        lines += [note("motion", f"{name}: speed, RMS px/s", speed), *_peers(trials)]
    return lines


def _peers(trials: Trials) -> List[Line]:
    paper = peer_speed_error(trials, peer.two_windows)
    fit = peer_speed_error(trials, peer.line_fit)
    return [
        note("motion", "  the paper's two windows", paper),
        note("motion", "  least squares over 10", fit),
    ]
