"""Random pairs and stars for the benches of cost and parity; numpy and the device's code only.

Source: ours.
"""

from typing import Dict, List

import numpy as np

from apex_edge import graph
from apex_edge.triggers.approach import Pairs
from apex_edge.triggers.windows import WINDOWS
from apex_edge.types import Array, DifferenceGraph, Tracks, TrackStatus

HORIZON_S = 5.0
FRAME_S = 0.05


def random_pairs(rng: np.random.Generator, n: int, slowing_share: float = 0.0) -> Pairs:
    """Draw n planar pairs of a table: half of the targets rest, noise as of 5 to 20 frames."""
    return Pairs(**_columns(rng, n, slowing_share))


def random_windows(rng: np.random.Generator, n: int) -> List[Pairs]:
    """Draw n pairs as each of ``WINDOWS`` sees them: alike, the short ones noisier."""
    base = _columns(rng, n, 0.0)
    found = []
    for window in WINDOWS:
        moved = {
            name: base[name] + rng.normal(size=base[name].shape) * 0.1 / window
            for name in ("offset_m", "mover_vel_m_s", "target_vel_m_s")
        }
        found.append(Pairs(**{**base, **moved, "cov": base["cov"] * (20.0 / window)}))
    return found


def star(rng: np.random.Generator, n_objects: int) -> DifferenceGraph:
    """Draw one frame of n objects of which one moves, and its difference graph."""
    now = _tracks(rng, n_objects)
    before = dict(now.__dict__, seq=now.seq - 1, t_s=now.t_s - FRAME_S)
    before["pos_m"] = now.pos_m - FRAME_S * now.vel_m_s
    return graph.difference(graph.build(Tracks(**before)), graph.build(now))


def _columns(rng: np.random.Generator, n: int, slowing_share: float) -> Dict[str, Array]:
    root = rng.normal(size=(n, 4, 4)) * np.array([0.002, 0.002, 0.01, 0.01])[:, None]
    is_slowing = rng.random(n) < slowing_share
    return {
        "offset_m": rng.normal(size=(n, 2)) * 0.25,
        "mover_vel_m_s": rng.normal(size=(n, 2)) * 0.15,
        "target_vel_m_s": rng.normal(size=(n, 2)) * 0.05 * (rng.random(n) < 0.5)[:, None],
        "decel_m_s2": np.where(is_slowing, rng.uniform(0.01, 0.3, n), 0.0),
        "radius_m": rng.uniform(0.024, 0.06, n),
        "cov": root @ root.transpose(0, 2, 1),
    }


def _tracks(rng: np.random.Generator, n: int) -> Tracks:
    place, velocity, still = rng.normal(size=(n, 3)) * 0.2, np.zeros((n, 3)), np.zeros((n, 3))
    velocity[0, :2] = (0.15, 0.05)
    cov = np.zeros((n, 6, 6))
    cov[:, range(3), range(3)] = 0.001**2
    cov[:, range(3, 6), range(3, 6)] = 0.004**2
    return Tracks(
        seq=1,
        t_s=1.0,
        name=("red",) * n,
        track_id=np.arange(1, n + 1),
        pos_m=place,
        vel_m_s=velocity,
        acc_m_s2=still,
        cov=cov,
        radius_m=np.full(n, 0.015),
        n_samples=np.full(n, 15),
        status=np.full(n, int(TrackStatus.SEEN)),
        age_s=np.zeros(n),
        centre_px=np.zeros((n, 2)),
        area_px2=np.full(n, 100.0),
        is_manoeuvre=np.zeros(n, dtype=bool),
        is_blurred=np.zeros(n, dtype=bool),
        smooth_m=place,
        seen_m=place,
        seen_sd_m=np.full(n, 0.001),
    )
