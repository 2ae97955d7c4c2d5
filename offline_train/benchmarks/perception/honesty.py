"""Does the stated covariance say how large the errors really are.

Normalised innovation squared (NIS): how far a sighting falls from its prediction, in units of the
predicted covariance plus the sighting's own noise; divided by its degrees of freedom its mean is 1
when the covariance is honest, below 1 when it is too wide. The noise is the one that the estimator
itself takes for that sighting. NEES is the same for the state against the twin's truth.

The 95 % band is that of a chi-square with as many degrees of freedom as there are INDEPENDENT
innovations: neighbours in time are alike, so their number is divided by the integrated
autocorrelation time of the NIS of that run, measured within tracks. Wide tails do not widen it.
First sightings (fewer than three before) have no speed yet and are left out. Frames within 0.7 s
(the window) of a change of motion are told apart by the truth, never by what the estimator flags:
that would pick the good ones. Source: ours; the test is Bar-Shalom's.
"""

import math
from dataclasses import dataclass, replace
from typing import Dict, Iterable, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge import geometry
from apex_edge.cameras.twin import TwinCamera, TwinConfig
from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.twin.scenarios import KINDS, make
from apex_edge.twin.world import TwinWorld, WorldState
from apex_edge.types import Array, Tracks, TrackStatus
from apex_edge.verbs.progress import Progress
from offline_train.benchmarks.lines import Line
from offline_train.benchmarks.perception.clips import ClipRun
from offline_train.benchmarks.perception.recorder import Note, listening
from offline_train.benchmarks.perception.truth import ClipTruth

MIN_SEEN = 3
MEMORY_S = 0.7  # a window of 20 frames
CHANGE_M_S2 = 0.03
HAND_RADII = 3.0
MAX_LAG = 20
BOUNCE_S = 0.12
CLASSES = CALM, CHANGING, HELD = "calm", "changing", "by a hand"
FIELDS = {
    "nis_m": "NIS in metres",
    "nis_px": "NIS in pixels",
    "nees_pos": "NEES of position",
    "nees_vel": "NEES of velocity",
}
PROMISED = ("nis_m",)
"""The agent acts on metres. In pixels the twin is known to 0.01 px at rest, less than is ever
stated; NEES holds biases that no sighting shows: where the colour sits on an object, what a hand
covers."""
_WIDE_95 = {1: 3.841, 2: 5.991, 3: 7.815}


class Errors(NamedTuple):
    """Squared normalised errors (n,) of one track in time order, with their degrees of freedom."""

    squared: Array
    dof: int


@dataclass(frozen=True)
class Consistency:
    """Mean per degree of freedom, its 95 % band, the share beyond the 95 % ellipse, and counts."""

    mean: float
    low: float
    high: float
    beyond: float
    n: int
    n_independent: float

    @property
    def is_inside(self) -> bool:
        """Say whether the mean lies in its band."""
        return self.low <= self.mean <= self.high


def consistency(tracks: Sequence[Errors]) -> Consistency:
    """Return the test of one run's errors; all tracks have the same degrees of freedom."""
    values = np.concatenate([track.squared for track in tracks]) if tracks else np.zeros(0)
    if not len(values):
        return Consistency(math.nan, math.nan, math.nan, math.nan, 0, 0.0)
    dof = tracks[0].dof
    independent = max(1.0, len(values) / _correlation_time([track.squared for track in tracks]))
    low, high = (_chi2(independent * dof, z) / (independent * dof) for z in (-1.96, 1.96))
    beyond = float(np.mean(values > _WIDE_95[dof]))
    return Consistency(float(values.mean()) / dof, low, high, beyond, len(values), independent)


def _correlation_time(tracks: Sequence[Array]) -> float:
    """Return 1 + twice the sum of autocorrelations up to the first that is not positive."""
    middle = float(np.concatenate(tracks).mean())
    variance = float(np.mean(np.square(np.concatenate(tracks) - middle)))
    total = 1.0
    for lag in range(1, MAX_LAG + 1):
        pairs = [(t[:-lag] - middle) * (t[lag:] - middle) for t in tracks if len(t) > lag]
        if not pairs or variance <= 0.0:
            break
        correlation = float(np.concatenate(pairs).mean()) / variance
        if correlation <= 0.0:
            break
        total += 2.0 * correlation
    return total


def _chi2(dof: float, z: float) -> float:
    """Return a quantile of chi-square (Wilson and Hilferty), ``z`` that of a normal."""
    spread = 2.0 / (9.0 * dof)
    return float(dof * max(0.0, 1.0 - spread + z * math.sqrt(spread)) ** 3)


def innovation(taken: Note) -> float:
    """Return the NIS of a sighting that was predicted."""
    assert taken.expected is not None
    dim = len(taken.x)
    miss = taken.x - taken.expected.x
    spread = taken.expected.cov[:dim, :dim] + taken.noise_sd**2 * np.eye(dim)
    return float(miss @ np.linalg.solve(spread, miss))


def is_tested(taken: Note) -> bool:
    """Say whether a sighting was predicted from a speed."""
    return taken.expected is not None and taken.n_before >= MIN_SEEN


def by_track(notes: Iterable[Note]) -> List[Errors]:
    """Return the NIS of each track."""
    found: Dict[int, List[float]] = {}
    dim = 0
    for taken in notes:
        if is_tested(taken):
            found.setdefault(taken.source, []).append(innovation(taken))
            dim = len(taken.x)
    return [Errors(np.array(values), dim) for values in found.values()]


class TwinErrors(NamedTuple):
    """Errors per class of motion of twin runs: NIS in px and m, NEES of position and velocity."""

    nis_px: Dict[str, List[Errors]]
    nis_m: Dict[str, List[Errors]]
    nees_pos: Dict[str, List[Errors]]
    nees_vel: Dict[str, List[Errors]]


class _Truth(NamedTuple):
    """The world at one frame: its state, the objects' pixels (n, 2), their classes of motion."""

    state: WorldState
    pixels: Array
    classes: Tuple[str, ...]


class _Watcher:
    """Classes the objects' motion by the truth alone."""

    def __init__(self) -> None:
        self._before: Dict[str, Tuple[float, Array]] = {}
        self._changed_s: Dict[str, float] = {}

    def classes(self, state: WorldState) -> Tuple[str, ...]:
        """Return the class of each object at a frame; to be asked for every frame in turn."""
        result = []
        for i, name in enumerate(state.objects.name):
            velocity = state.objects.vel_m_s[i]
            t_before, before = self._before.get(name, (state.t_s - 1.0, velocity))
            step = float(np.linalg.norm(velocity - before)) / max(state.t_s - t_before, 1e-6)
            if step > CHANGE_M_S2:
                self._changed_s[name] = state.t_s
            self._before[name] = (state.t_s, velocity)
            is_changing = state.t_s - self._changed_s.get(name, -math.inf) < MEMORY_S
            result.append(HELD if _is_held(state, i) else CHANGING if is_changing else CALM)
        return tuple(result)


def _is_held(state: WorldState, i: int) -> bool:
    reach = HAND_RADII * state.objects.radius_m[i]
    x, y, _ = state.objects.pos_m[i]
    return any(math.hypot(x - h.pos_m[0], y - h.pos_m[1]) < reach for h in state.hands)


def run_scene(kind: str, seed: int, config: PerceptionConfig) -> TwinErrors:
    """Play one scene of the twin through perception, in metres and in pixels."""
    camera = TwinCamera(TwinConfig(delay_s=0.0, seed=seed), TwinWorld(make(kind, seed)))
    truths: Dict[float, _Truth] = {}
    reported: List[Tracks] = []
    watcher = _Watcher()
    with listening() as notes:
        metric, flat = (Perception(config, ColourTable.builtin()) for _ in range(2))
        for frame in iter(camera.advance, None):
            state = camera.world.state()
            pixels, _ = geometry.project(camera.camera, state.objects.pos_m)
            truths[frame.t_s] = _Truth(state, pixels, watcher.classes(state))
            reported.append(metric.step(frame)[1])
            flat.step(replace(frame, depth_mm=None, camera=None))
    return TwinErrors(
        nis_px=_by_class([taken for taken in notes if len(taken.x) == 2], truths),
        nis_m=_by_class([taken for taken in notes if len(taken.x) == 3], truths),
        nees_pos=_against_truth(reported, truths, slice(0, 3)),
        nees_vel=_against_truth(reported, truths, slice(3, 6)),
    )


def _by_class(notes: Iterable[Note], truths: Mapping[float, _Truth]) -> Dict[str, List[Errors]]:
    """Return the NIS of each track, apart for each class of motion of its object."""
    sorted_notes: Dict[str, List[Note]] = {}
    for taken in notes:
        truth = truths[taken.t_s]
        where = truth.pixels if len(taken.x) == 2 else truth.state.objects.pos_m
        nearest = int(np.argmin(np.linalg.norm(where - taken.x, axis=1)))
        sorted_notes.setdefault(truth.classes[nearest], []).append(taken)
    return {name: by_track(part) for name, part in sorted_notes.items()}


def _against_truth(
    reported: Iterable[Tracks], truths: Mapping[float, _Truth], part: slice
) -> Dict[str, List[Errors]]:
    """Return the NEES of position (first three of the state) or velocity (last three)."""
    found: Dict[Tuple[str, int], List[float]] = {}
    for tracks in reported:
        truth = truths[tracks.t_s]
        true = np.hstack([truth.state.objects.pos_m, truth.state.objects.vel_m_s])
        stated = np.hstack([tracks.pos_m, tracks.vel_m_s])
        is_told = (tracks.status == TrackStatus.SEEN) & (tracks.n_samples >= MIN_SEEN)
        for i in np.flatnonzero(is_told):
            nearest = int(np.argmin(np.linalg.norm(true[:, :3] - tracks.pos_m[i], axis=1)))
            off = (stated[i] - true[nearest])[part]
            squared = float(off @ np.linalg.solve(tracks.cov[i][part, part], off))
            key = (truth.classes[nearest], int(tracks.track_id[i]))
            found.setdefault(key, []).append(squared)
    result: Dict[str, List[Errors]] = {}
    for (name, _), values in found.items():
        result.setdefault(name, []).append(Errors(np.array(values), 3))
    return result


def measure_twin(
    config: PerceptionConfig, seeds: Sequence[int], is_quiet: bool = False
) -> List[Line]:
    """Play scenes of all kinds and return the lines of NIS and NEES."""
    runs: List[Tuple[str, TwinErrors]] = []
    with Progress("twin scenes", len(KINDS) * len(seeds), is_quiet) as progress:
        for kind in KINDS:
            for seed in seeds:
                runs.append((kind, run_scene(kind, seed, config)))
                progress.advance()
    lines: List[Line] = []
    for field, what in FIELDS.items():
        found = [(kind, getattr(run, field)) for kind, run in runs]
        lines += _field_lines(what, found, field in PROMISED)
    return lines


def _field_lines(
    what: str, runs: Sequence[Tuple[str, Dict[str, List[Errors]]]], is_promised: bool
) -> List[Line]:
    """Return the calm line, then changing and held, then each kind of scene."""
    pooled = {name: [e for _, run in runs for e in run.get(name, [])] for name in CLASSES}
    lines = [_line(f"twin: {what}, {CALM}", consistency(pooled[CALM]), is_promised)]
    for name in (CHANGING, HELD):
        lines.append(_line(f"  {name}", consistency(pooled[name]), is_promised=False))
    for kind in KINDS:
        errors = [e for k, run in runs if k == kind for e in run.get(CALM, [])]
        lines.append(_line(f"  {CALM}, {kind}", consistency(errors), is_promised=False))
    return lines


def measure_clip(name: str, truth: ClipTruth, run: ClipRun) -> List[Line]:
    """Return the lines of a labelled clip, the sightings after its labelled bounces apart."""
    times = [seen.t_s for seen in run.seen]
    bounces = [times[frame] for frame in truth.bounce_frames if frame < len(times)]

    def is_near(taken: Note) -> bool:
        # a labelled bounce is right to a frame
        return any(-1.5 / truth.fps <= taken.t_s - t < BOUNCE_S for t in bounces)

    calm = consistency(by_track(taken for taken in run.notes if not is_near(taken)))
    lines = [_line(f"{name}: NIS", calm, is_promised=True)]
    if bounces:
        near = consistency(by_track(taken for taken in run.notes if is_near(taken)))
        lines.append(_line(f"  within {BOUNCE_S:g} s after a bounce", near, is_promised=False))
    return lines


def _line(what: str, found: Consistency, is_promised: bool) -> Line:
    if not found.n:
        return Line("nis", what, "none", "", None)
    measured = f"{found.mean:.3g} ({found.beyond:.1%} beyond, {found.n} of them)"
    goal = f"in {found.low:.2f}..{found.high:.2f}"
    is_ok = found.is_inside if is_promised else None
    return Line("nis", what, measured, goal, is_ok, dict(vars(found)))
