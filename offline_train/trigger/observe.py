"""What perception would publish of the true motion: noisy, windowed, with its covariance.

Positions carry white noise; motion and covariance come from a fit over a window (see estimate).
Pairs, gate and features are then the device's own code.
"""

from dataclasses import dataclass, fields
from typing import Any, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.triggers.analytic import k_sigma_rule
from apex_edge.triggers.approach import Pairs
from apex_edge.triggers.base import TriggerConfig, movers_first, pairs_of, weigh
from apex_edge.triggers.features import edge_features
from apex_edge.triggers.wide import wide_features
from apex_edge.triggers.windows import WINDOWS, fit_lines, line_pairs
from apex_edge.types import Array, Tracks
from offline_train.scenes.truth import Truth, scenario
from offline_train.trigger import estimate
from offline_train.trigger.estimate import Fit, Sensing

_CHUNK = 20000
_ROW_WISE = (
    "pair",
    "frame",
    "centre_moves",
    "features",
    "wide",
    "rule_probability",
    "rule_hit",
    "label",
    "soft",
)


@dataclass(frozen=True)
class Watching:
    """How scenes are watched; ranges are drawn from for each scene.

    ``noise_m`` sd per axis (log-uniform), ``fps``, ``window`` frames of the motion fit,
    ``adaptive_share`` of the scenes whose fit looks for bends, ``misjudged`` range of the factor
    by which perception misjudges its own noise, ``n_frames`` watched, ``horizon_s`` of the label.
    Without ``is_gated`` every pair is a row, as a study of the classifier alone needs; the device
    judges only what passes its gate. Every ``stride``-th frame is judged, the last one included;
    a vote needs them all. ``is_wide``: the features of several windows are worked out too.
    ``n_rollouts`` soften a few rows of each pair in a data folder to learn from (see ``soft``), and
    only those are kept; 0 = none.
    """

    noise_m: Tuple[float, float] = (0.0005, 0.003)
    fps: Tuple[float, float] = (20.0, 30.0)
    window: Tuple[int, int] = (5, 20)
    adaptive_share: float = 0.5
    misjudged: Tuple[float, float] = (0.8, 1.25)
    n_frames: int = 150
    horizon_s: float = 5.0
    is_gated: bool = True
    stride: int = 1
    is_wide: bool = False
    n_rollouts: int = 0


@dataclass(frozen=True)
class Observed:
    """n pairs of f frames, judged frame by frame up to contact; pairs of one scene share bodies.

    r rows, those frames in which the pair passes the gate and can touch: ``pair (r,)``,
    ``frame (r,)``, ``geometry`` the pairs as the device sees them, ``centre_moves (r,)`` the mover
    is the scene's centre body, ``features (r, 12)``, ``wide (r, k)`` of several windows (k = 0
    when not asked for), ``rule_probability``, ``rule_hit (r,)`` of the k-sigma rule,
    ``label (r,)`` true contact within the horizon, ``soft (r,)`` its probability from perturbed
    roll-outs, NaN where none were made. Per pair: ``scene``, ``body`` (1 to k),
    ``kind``, ``contact_s``, ``frame_s``, ``horizon_s (n,)``. ``is_judged (n, f)`` a full window
    lies before contact; ``is_clear (n, f)`` and the true mover is faster than the gate by a
    quarter.
    """

    pair: Array
    frame: Array
    geometry: Pairs
    centre_moves: Array
    features: Array
    wide: Array
    rule_probability: Array
    rule_hit: Array
    label: Array
    soft: Array
    scene: Array
    body: Array
    kind: Array
    contact_s: Array
    frame_s: Array
    horizon_s: Array
    is_judged: Array
    is_clear: Array

    @property
    def speed_m_s(self) -> Array:
        """Return the measured speed (r,) of the mover."""
        speed: Array = np.linalg.norm(self.geometry.mover_vel_m_s, axis=1)
        return speed

    @property
    def group(self) -> Array:
        """Return one number (r,) per scene and frame: the rows that were seen at once."""
        group: Array = self.scene[self.pair] * self.is_judged.shape[1] + self.frame
        return group

    @property
    def bodies(self) -> Array:
        """Return mover and target (r, 2) of each row; the centre body is 0."""
        other = self.body[self.pair]
        mover = np.where(self.centre_moves, 0, other)
        return np.column_stack([mover, other - mover])

    def take(self, rows: Array) -> "Observed":
        """Return only those rows, chosen by a mask or by indices; the pairs stay."""
        arrays = self.to_arrays()
        arrays.update({name: arrays[name][rows] for name in arrays if _is_row_wise(name)})
        return Observed.from_arrays(arrays)

    def to_arrays(self) -> Dict[str, Array]:
        """Return everything as arrays by name, as a shard stores it."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "geometry"}
        for spec in fields(Pairs):
            arrays["geometry." + spec.name] = getattr(self.geometry, spec.name)
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> "Observed":
        """Return what ``to_arrays`` laid out.

        Raises
        ------
        KeyError : an array is missing.
        """
        geometry = Pairs(**{s.name: arrays["geometry." + s.name] for s in fields(Pairs)})
        plain = {f.name: arrays[f.name] for f in fields(cls) if f.name != "geometry"}
        return cls(geometry=geometry, **plain)


def _is_row_wise(name: str) -> bool:
    return name in _ROW_WISE or name.startswith("geometry.")


class _Look(NamedTuple):
    """What is looked at and what is seen of it; ``seen`` and ``fits`` the centre body first."""

    truth: Truth
    sensing: Sensing
    seen: List[Array]
    fits: List[Fit]
    watching: Watching
    config: TriggerConfig


class _Rows(NamedTuple):
    """Which scene, other body and frame each row of a table is about, (r,) each."""

    scene: Array
    other: Array
    frame: Array


def join(parts: Sequence[Observed]) -> Observed:
    """Return the parts as one, their pairs and scenes numbered on."""
    n_pairs = np.cumsum([0] + [len(part.kind) for part in parts])
    n_scenes = np.cumsum([0] + [1 + int(part.scene.max(initial=-1)) for part in parts])
    tables = [part.to_arrays() for part in parts]
    joined: Dict[str, Array] = {}
    for name in tables[0]:
        shift = {"pair": n_pairs, "scene": n_scenes}.get(name)
        columns = [t[name] if shift is None else t[name] + shift[i] for i, t in enumerate(tables)]
        joined[name] = np.concatenate(columns)
    return Observed.from_arrays(joined)


def observe(
    rng: np.random.Generator,
    name: str,
    n_scenes: int,
    watching: Watching,
    config: TriggerConfig,
    only_contacts: bool = False,
) -> Observed:
    """Draw scenes of a scenario and look at them through noisy perception.

    ``only_contacts`` keeps those scenes that end in contact, for calibration: same events, less
    work.

    Raises
    ------
    PluginError : no scenario of that name.
    """
    sensing = draw_sensing(rng, n_scenes, watching)
    truth = scenario(name).draw(rng, sensing.frame_s, watching.n_frames)
    if only_contacts:
        keep = np.isfinite(truth.contact_s).any(axis=1)
        truth, sensing = _take(truth, keep), _take(sensing, keep)
    return look(rng, truth, sensing, watching, config)


def look(
    rng: np.random.Generator,
    truth: Truth,
    sensing: Sensing,
    watching: Watching,
    config: TriggerConfig,
) -> Observed:
    """Look at true motion through noisy perception and judge it frame by frame."""
    n_scenes, n_others = truth.kind.shape
    times = np.arange(watching.n_frames) * truth.frame_s[:, None]
    bodies = [truth.centre_m] + [truth.other_m[:, i] for i in range(n_others)]
    seen = [body + rng.normal(size=body.shape) * sensing.sd_m[:, None, None] for body in bodies]
    fits = [estimate.fit(sightings, sensing) for sightings in seen]
    frames = np.arange(watching.n_frames)
    is_full = frames >= sensing.window[:, None] - 1
    is_judged = is_full[:, None] & (times[:, None] < truth.contact_s[:, :, None])
    is_asked = is_judged & ((frames - frames[-1]) % watching.stride == 0)
    rows = _Rows(*np.nonzero(is_asked))
    scene = _Look(truth, sensing, seen, fits, watching, config)
    found = [
        _judge_rows(scene, _Rows(*(part[first : first + _CHUNK] for part in rows)))
        for first in range(0, max(1, len(rows.scene)), _CHUNK)
    ]
    columns = {key: np.concatenate([part[key] for part in found]) for key in found[0]}
    is_clear = [_is_clear(truth, i, sensing, config) for i in range(n_others)]
    flat = {"kind": truth.kind, "contact_s": truth.contact_s, "is_judged": is_judged}
    flat["is_clear"] = is_judged & np.stack(is_clear, axis=1)
    per_pair = {key: value.reshape(-1, *value.shape[2:]) for key, value in flat.items()}
    left_s = (
        per_pair["contact_s"][columns["pair"]]
        - times[columns["pair"] // n_others, columns["frame"]]
    )
    return Observed.from_arrays(
        dict(
            columns,
            label=left_s <= watching.horizon_s,
            soft=np.full(len(left_s), np.nan),
            scene=np.repeat(np.arange(n_scenes), n_others),
            body=np.tile(np.arange(1, n_others + 1), n_scenes),
            frame_s=np.repeat(truth.frame_s, n_others),
            horizon_s=np.full(n_scenes * n_others, watching.horizon_s),
            **per_pair,
        )
    )


def draw_sensing(rng: np.random.Generator, n: int, watching: Watching) -> Sensing:
    """Draw how each of n scenes is seen."""
    low, high = np.log(watching.noise_m)
    sd = np.exp(rng.uniform(low, high, n))
    return Sensing(
        frame_s=1.0 / rng.uniform(watching.fps[0], watching.fps[1], n),
        sd_m=sd,
        told_sd_m=sd * rng.uniform(watching.misjudged[0], watching.misjudged[1], n),
        window=rng.integers(watching.window[0], watching.window[1] + 1, n),
        is_adaptive=rng.random(n) < watching.adaptive_share,
    )


def _take(table: Any, keep: Array) -> Any:
    return type(table)(**{spec.name: getattr(table, spec.name)[keep] for spec in fields(table)})


def _is_clear(truth: Truth, other: int, sensing: Sensing, config: TriggerConfig) -> Array:
    """Say in which frames (s, f) the body that brings the contact is faster than the gate by 1/4.

    That body is the one with the higher peak speed before contact: a target that creeps before the
    hand has started says nothing of the hand, and one that is struck runs off as fast.
    """
    speed_sd = estimate.moving_speed_sd(sensing)
    gate = np.maximum(config.min_speed_m_s, config.min_speed_sd * speed_sd)
    speeds = [
        np.linalg.norm(np.gradient(body, axis=1), axis=2) / truth.frame_s[:, None]
        for body in (truth.other_m[:, other], truth.centre_m)
    ]
    time = np.arange(speeds[0].shape[1]) * truth.frame_s[:, None]
    is_before = time < truth.contact_s[:, other, None]
    peaks = [np.where(is_before, speed, 0.0).max(axis=1) for speed in speeds]
    is_mover = peaks[0] >= peaks[1]
    clear: Array = np.where(is_mover[:, None], speeds[0], speeds[1]) > 1.25 * gate[:, None]
    return clear


def _judge_rows(look: _Look, rows: _Rows) -> Dict[str, Array]:
    """Run the device's code over rows of (scene, other body, frame); return those it judges."""
    watching, config = look.watching, look.config
    tracks, frame_s = _as_tracks(look, rows)
    edges, is_moving = movers_first(tracks, np.arange(len(frame_s)).reshape(-1, 2), config)
    keep = np.flatnonzero(is_moving | (not watching.is_gated))
    pairs = pairs_of(tracks, edges[keep], frame_s)
    n_samples = tracks.n_samples[edges[keep, 0]]
    evidence = weigh(pairs, is_moving[keep], n_samples, watching.horizon_s)
    can = np.flatnonzero(evidence.is_possible | (not watching.is_gated))
    keep, evidence = keep[can], evidence.take(can)
    rule = k_sigma_rule(evidence, config.k_sigma)
    columns = {
        "pair": rows.scene[keep] * look.truth.kind.shape[1] + rows.other[keep],
        "frame": rows.frame[keep],
        "centre_moves": edges[keep, 0] % 2 == 1,
        "features": edge_features(evidence.pairs, evidence.approach, watching.horizon_s),
        "wide": _wide(look, _Rows(*(part[keep] for part in rows)), evidence.pairs, edges[keep]),
        "rule_probability": rule.probability,
        "rule_hit": rule.is_hit,
    }
    for spec in fields(Pairs):
        columns["geometry." + spec.name] = getattr(evidence.pairs, spec.name)
    return columns


def _wide(look: _Look, rows: _Rows, pairs: Pairs, edges: Array) -> Array:
    """Return the features of several windows (r, k).

    Until the longest window is full its line runs through the frames there are, as on the device;
    its covariance says how little that is.
    """
    n = len(rows.scene)
    if not look.watching.is_wide:
        return np.zeros((n, 0))
    # As in _as_tracks: the other body is at 2r, the centre at 2r + 1.
    back = np.arange(1 - max(WINDOWS), 1)
    frame = rows.frame[:, None] + back
    scene, spot = rows.scene[:, None], np.maximum(frame, 0)
    others = np.stack(look.seen[1:])[rows.other[:, None], scene, spot]
    seen = np.stack([others, look.seen[0][scene, spot]], axis=1).reshape(2 * n, len(back), 2)
    time = np.where(frame >= 0, frame * look.truth.frame_s[scene], np.nan)
    time, told = np.repeat(time, 2, axis=0), np.repeat(look.sensing.told_sd_m[rows.scene], 2)
    mover = 2 * np.arange(n) + edges[:, 0] % 2
    ends = np.column_stack([mover, mover ^ 1])
    lines = [fit_lines(time[:, -w:], seen[:, -w:], told) for w in WINDOWS]
    views = [line_pairs(line, ends, pairs.radius_m) for line in lines]
    return wide_features(views, look.watching.horizon_s)


def _as_tracks(look: _Look, rows: _Rows) -> Tuple[Tracks, Array]:
    """Lay the pair of each row out as two tracks, the other body 2r and the centre 2r + 1."""
    truth, sensing = look.truth, look.sensing
    n = 2 * len(rows.scene)
    position, velocity, acc = (np.zeros((n, 3)) for _ in range(3))
    cov = np.zeros((n, 6, 6))
    spots = (rows.scene, rows.frame)
    for number, fit in enumerate(look.fits):
        mine = np.flatnonzero(rows.other == number - 1) if number else np.arange(len(rows.scene))
        into = 2 * mine + (0 if number else 1)
        spot = (spots[0][mine], spots[1][mine])
        position[into, :2] = fit.position[spot]
        velocity[into, :2] = fit.velocity[spot]
        acc[into, :2] = fit.acc[spot]
        cov[into] = estimate.covariance(fit, sensing, spot)
    owner = np.repeat(rows.scene, 2)
    tracks = Tracks(
        seq=0,
        t_s=0.0,
        name=("object",) * n,
        track_id=np.arange(n),
        pos_m=position,
        vel_m_s=velocity,
        acc_m_s2=acc,
        cov=cov,
        radius_m=0.5 * truth.radius_m[owner, np.repeat(rows.other, 2)],
        n_samples=sensing.window[owner],
        status=np.zeros(n, dtype=np.int64),
        age_s=np.zeros(n),
        centre_px=np.zeros((n, 2)),
        area_px2=np.zeros(n),
        is_manoeuvre=np.zeros(n, dtype=bool),
        is_blurred=np.zeros(n, dtype=bool),
        smooth_m=position,
        seen_m=np.full((n, 3), np.nan),
        seen_sd_m=np.full(n, np.nan),
    )
    return tracks, truth.frame_s[owner]
