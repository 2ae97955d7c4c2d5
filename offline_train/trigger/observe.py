"""What perception would publish of the true motion: noisy, windowed, with its covariance.

Positions carry white noise; motion and covariance come from a fit over a window (see estimate).
Pairs, gate and features are then the device's own code.
"""

from dataclasses import dataclass
from typing import Dict, List, Tuple

import numpy as np

from apex_edge.triggers.analytic import k_sigma_rule
from apex_edge.triggers.base import TriggerConfig, movers_first, pairs_of, weigh
from apex_edge.triggers.features import edge_features
from apex_edge.types import Array, Tracks
from offline_train.trigger import estimate
from offline_train.trigger.estimate import Fit, Sensing
from offline_train.trigger.generate import Scenes, contact_time, draw, place

NOISE_M = (0.0005, 0.003)
FPS = (20.0, 30.0)
WINDOWS = (5, 20)
N_FRAMES = 150
HORIZON_S = 5.0
_CHUNK = 20000


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
    fits = [
        estimate.fit(seen + _noise(rng, seen.shape, sensing), sensing) for seen in (mover, target)
    ]
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
        is_adaptive=rng.random(n) < 0.5,
    )


def _noise(rng: np.random.Generator, shape: Tuple[int, ...], sensing: Sensing) -> Array:
    noise: Array = rng.normal(size=shape) * sensing.sd_m[:, None, None]
    return noise


def _is_clear(mover: Array, target: Array, sensing: Sensing, config: TriggerConfig) -> Array:
    """Say in which frames (n, f) the body that brings the contact is faster than the gate by 1/4.

    That body is the one with the higher peak speed: a target that creeps before the hand has
    started says nothing of the hand.
    """
    speed_sd = estimate.moving_speed_sd(sensing)
    gate = np.maximum(config.min_speed_m_s, config.min_speed_sd * speed_sd)
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
    cov = np.zeros((n, 6, 6))
    for body, fit in enumerate(fits):
        position[body::2, :2] = fit.position[scene, frame]
        velocity[body::2, :2] = fit.velocity[scene, frame]
        acc[body::2, :2] = fit.acc[scene, frame]
        cov[body::2] = estimate.covariance(fit, sensing, rows)
    owner = np.repeat(scene, 2)
    tracks = Tracks(
        seq=0,
        t_s=0.0,
        name=("object",) * n,
        track_id=np.arange(n),
        pos_m=position,
        vel_m_s=velocity,
        acc_m_s2=acc,
        cov=cov,
        radius_m=0.5 * scenes.radius_m[owner],
        n_samples=sensing.window[owner],
        status=np.zeros(n, dtype=np.int64),
        age_s=np.zeros(n),
        centre_px=np.zeros((n, 2)),
        area_px2=np.zeros(n),
        is_manoeuvre=np.zeros(n, dtype=bool),
        is_blurred=np.zeros(n, dtype=bool),
        smooth_m=position,
    )
    return tracks, sensing.frame_s[owner]
