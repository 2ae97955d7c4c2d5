"""What perception would publish of the true motion: noisy, windowed, with its covariance.

Positions carry white noise; position and velocity come from a least-squares line over the window,
evaluated at its newest frame, with the propagated covariance; the acceleration, where given,
from a parabola over the same window. Pairs, gate and features are then the device's own code.
"""

from dataclasses import dataclass
from typing import Dict, List, Tuple

import numpy as np

from apex_edge.triggers.analytic import k_sigma_rule
from apex_edge.triggers.base import TriggerConfig, movers_first, pairs_of, weigh
from apex_edge.triggers.features import edge_features
from apex_edge.types import Array, Tracks
from offline_train.trigger.generate import Scenes, contact_time, draw, place

NOISE_M = (0.0005, 0.003)
FPS = (20.0, 30.0)
WINDOWS = (5, 20)
N_FRAMES = 150
HORIZON_S = 5.0
_CHUNK = 20000
Fit = Tuple[Array, Array, Array]


@dataclass(frozen=True)
class Sensing:
    """How each of n scenes is seen.

    ``frame_s``, ``sd_m``, ``told_sd_m`` (what perception believes of its noise) and ``window``,
    each (n,); ``has_acc (n,)`` whether an acceleration is published.
    """

    frame_s: Array
    sd_m: Array
    told_sd_m: Array
    window: Array
    has_acc: Array


@dataclass(frozen=True)
class Observed:
    """n scenes of f frames, judged frame by frame up to contact.

    r rows, those frames in which the pair passes the gate and can touch: ``scene (r,)``,
    ``frame (r,)``, ``features (r, 12)``, ``radius_m (r,)``, ``speed_m_s (r,)`` measured speed of
    the mover, ``rule_probability``, ``rule_hit (r,)`` of the k-sigma rule, ``label (r,)`` true
    contact within the horizon. Per scene: ``kind``, ``contact_s``, ``frame_s (n,)``.
    ``is_judged (n, f)`` a full window lies before contact; ``is_clear (n, f)`` and the true mover
    is faster than the gate by a quarter.
    """

    scene: Array
    frame: Array
    features: Array
    radius_m: Array
    speed_m_s: Array
    rule_probability: Array
    rule_hit: Array
    label: Array
    kind: Array
    contact_s: Array
    frame_s: Array
    is_judged: Array
    is_clear: Array


def observe(seed: int, n: int, config: TriggerConfig, only_contacts: bool = False) -> Observed:
    """Draw n scenes from a seed and look at them through noisy perception.

    ``only_contacts`` keeps those scenes that end in contact, for calibration: same events, less
    work.
    """
    rng = np.random.default_rng(seed)
    scenes = draw(rng, n)
    until_s = N_FRAMES / FPS[0] + HORIZON_S
    contact = contact_time(scenes, until_s)
    if only_contacts:
        keep = np.isfinite(contact)
        scenes, contact = scenes.take(keep), contact[keep]
    sensing = _draw_sensing(rng, len(contact))
    times = np.arange(N_FRAMES) * sensing.frame_s[:, None]
    mover, target = place(scenes, times)
    fits = [_fit(seen + _noise(rng, seen.shape, sensing), sensing) for seen in (mover, target)]
    is_full = np.arange(N_FRAMES) >= sensing.window[:, None] - 1
    is_judged = is_full & (times < contact[:, None])
    rows = np.nonzero(is_judged)
    found = [
        _judge_rows(
            scenes, sensing, fits, (rows[0][a : a + _CHUNK], rows[1][a : a + _CHUNK]), config
        )
        for a in range(0, len(rows[0]), _CHUNK)
    ]
    columns = {key: np.concatenate([part[key] for part in found]) for key in found[0]}
    scene, frame = columns["scene"], columns["frame"]
    return Observed(
        **columns,
        label=contact[scene] - times[scene, frame] <= HORIZON_S,
        kind=scenes.kind,
        contact_s=contact,
        frame_s=sensing.frame_s,
        is_judged=is_judged,
        is_clear=is_judged & _is_clear(mover, target, sensing, config),
    )


def _draw_sensing(rng: np.random.Generator, n: int) -> Sensing:
    sd = np.exp(rng.uniform(np.log(NOISE_M[0]), np.log(NOISE_M[1]), n))
    return Sensing(
        frame_s=1.0 / rng.uniform(FPS[0], FPS[1], n),
        sd_m=sd,
        told_sd_m=sd * rng.uniform(0.8, 1.25, n),
        window=rng.integers(WINDOWS[0], WINDOWS[1] + 1, n),
        has_acc=rng.random(n) < 0.5,
    )


def _noise(rng: np.random.Generator, shape: Tuple[int, ...], sensing: Sensing) -> Array:
    noise: Array = rng.normal(size=shape) * sensing.sd_m[:, None, None]
    return noise


def _fit(seen: Array, sensing: Sensing) -> Fit:
    """Return position, velocity, acceleration (n, f, 2) fitted over each trailing window."""
    n, n_frames, _ = seen.shape
    index = np.arange(n_frames)
    # Moments of the window about its middle, from running sums; frames count as units of time.
    sums = [np.cumsum(seen * (index[:, None] ** power), axis=1) for power in range(3)]
    sums = [np.concatenate([np.zeros((n, 1, 2)), total], axis=1) for total in sums]
    width = sensing.window[:, None]
    first = np.maximum(index + 1 - width, 0)
    rows = np.arange(n)[:, None]
    m0, m1, m2 = (total[:, 1:] - total[rows, first] for total in sums)
    w = width[..., None].astype(float)
    middle = (index[None, :, None] + 1 - w + index[None, :, None]) / 2.0
    first_moment = m1 - middle * m0
    second_moment = m2 - 2.0 * middle * m1 + middle * middle * m0
    slope = first_moment * 12.0 / (w * (w * w - 1.0))
    mean_sq = (w * w - 1.0) / 12.0
    curve = (second_moment - mean_sq * m0) * 180.0 / (w * (w * w - 1.0) * (w * w - 4.0))
    step = sensing.frame_s[:, None, None]
    acc = np.where(sensing.has_acc[:, None, None], 2.0 * curve / step**2, np.nan)
    return m0 / w + slope * (w - 1.0) / 2.0, slope / step, acc


def line_covariance(sd_m: Array, window: Array, frame_s: Array) -> Array:
    """Return cov (n, 6, 6) of position and velocity at the newest end of a fitted line."""
    w = window.astype(float)
    place_var = sd_m**2 * (4.0 * w - 2.0) / (w * (w + 1.0))
    cross = sd_m**2 * 6.0 / (w * (w + 1.0) * frame_s)
    vel_var = sd_m**2 * 12.0 / (w * (w * w - 1.0) * frame_s**2)
    axes = np.arange(3)
    cov = np.zeros((len(w), 6, 6))
    cov[:, axes, axes] = place_var[:, None]
    cov[:, axes, axes + 3] = cov[:, axes + 3, axes] = cross[:, None]
    cov[:, axes + 3, axes + 3] = vel_var[:, None]
    return cov


def _is_clear(mover: Array, target: Array, sensing: Sensing, config: TriggerConfig) -> Array:
    """Say in which frames (n, f) the body that brings the contact is faster than the gate by 1/4.

    That body is the one with the higher peak speed: a target that creeps before the hand has
    started says nothing of the hand.
    """
    cov = line_covariance(sensing.sd_m, sensing.window, sensing.frame_s)
    gate = np.maximum(config.min_speed_m_s, config.min_speed_sd * np.sqrt(cov[:, 3, 3]))
    speeds = [
        np.linalg.norm(np.gradient(body, axis=1), axis=2) / sensing.frame_s[:, None]
        for body in (mover, target)
    ]
    is_mover = speeds[0].max(axis=1) >= speeds[1].max(axis=1)
    clear: Array = np.where(is_mover[:, None], speeds[0], speeds[1]) > 1.25 * gate[:, None]
    return clear


def _judge_rows(
    scenes: Scenes,
    sensing: Sensing,
    fits: List[Fit],
    rows: Tuple[Array, Array],
    config: TriggerConfig,
) -> Dict[str, Array]:
    """Run the device's code over (scene, frame) rows; return columns of those it judges."""
    tracks, frame_s = _as_tracks(scenes, sensing, fits, rows)
    edges, is_moving = movers_first(tracks, np.arange(2 * len(rows[0])).reshape(-1, 2), config)
    keep = np.flatnonzero(is_moving)
    pairs = pairs_of(tracks, edges[keep], frame_s)
    evidence = weigh(pairs, is_moving[keep], tracks.n_samples[edges[keep, 0]], HORIZON_S)
    can = np.flatnonzero(evidence.is_possible)
    keep, evidence = keep[can], evidence.take(can)
    rule = k_sigma_rule(evidence, config.k_sigma)
    return {
        "scene": rows[0][keep],
        "frame": rows[1][keep],
        "features": edge_features(evidence.pairs, evidence.approach, HORIZON_S),
        "radius_m": evidence.pairs.radius_m,
        "speed_m_s": np.linalg.norm(evidence.pairs.mover_vel_m_s, axis=1),
        "rule_probability": rule.probability,
        "rule_hit": rule.is_hit,
    }


def _as_tracks(
    scenes: Scenes, sensing: Sensing, fits: List[Fit], rows: Tuple[Array, Array]
) -> Tuple[Tracks, Array]:
    """Lay the pair of each row out as two tracks, mover 2r and target 2r + 1."""
    scene, frame = rows
    n = 2 * len(scene)
    position, velocity, acc = (np.zeros((n, 3)) for _ in range(3))
    for body, fit in enumerate(fits):
        for filled, part in zip((position, velocity, acc), fit):
            filled[body::2, :2] = part[scene, frame]
    owner = np.repeat(scene, 2)
    cov = line_covariance(sensing.told_sd_m, sensing.window, sensing.frame_s)
    tracks = Tracks(
        seq=0,
        t_s=0.0,
        name=("object",) * n,
        track_id=np.arange(n),
        pos_m=position,
        vel_m_s=velocity,
        acc_m_s2=acc,
        cov=cov[owner],
        radius_m=0.5 * scenes.radius_m[owner],
        n_samples=sensing.window[owner],
        status=np.zeros(n, dtype=np.int64),
        age_s=np.zeros(n),
        centre_px=np.zeros((n, 2)),
        area_px2=np.zeros(n),
        is_manoeuvre=np.zeros(n, dtype=bool),
        smooth_m=position,
    )
    return tracks, sensing.frame_s[owner]
