"""Tracks, graphs and noisy watches for the tests of graph and trigger."""

import numpy as np

from apex_edge import graph
from apex_edge.types import Tracks, TrackStatus


def tracks(pos_m, vel_m_s=None, seq=1, t_s=1.0, sd_m=0.001, sd_m_s=0.004, **changes):
    """Return tracks at (n, 2) positions with (n, 2) velocities and white covariances."""
    pos = np.column_stack([np.asarray(pos_m, dtype=float), np.full(len(pos_m), 0.015)])
    vel = np.zeros_like(pos)
    if vel_m_s is not None:
        vel[:, :2] = vel_m_s
    n = len(pos)
    cov = np.zeros((n, 6, 6))
    cov[:, range(3), range(3)] = sd_m**2
    cov[:, range(3, 6), range(3, 6)] = sd_m_s**2
    values = {
        "seq": seq,
        "t_s": t_s,
        "name": ("red", "green", "blue", "yellow", "orange")[:n],
        "track_id": np.arange(1, n + 1),
        "pos_m": pos,
        "vel_m_s": vel,
        "acc_m_s2": np.zeros_like(pos),
        "cov": cov,
        "radius_m": np.full(n, 0.015),
        "n_samples": np.full(n, 15),
        "status": np.full(n, int(TrackStatus.SEEN)),
        "age_s": np.zeros(n),
        "centre_px": np.zeros((n, 2)),
        "area_px2": np.full(n, 100.0),
        "is_manoeuvre": np.zeros(n, dtype=bool),
        "is_blurred": np.zeros(n, dtype=bool),
        "smooth_m": pos.copy(),
        "seen_m": pos.copy(),
        "seen_sd_m": np.full(n, 0.001),
    }
    values.update(changes)
    return Tracks(**values)


def difference(now, dt_s=1.0 / 30.0):
    """Return the difference graph of ``now`` against the same objects one frame earlier."""
    older = tracks(
        now.pos_m[:, :2] - np.nan_to_num(now.vel_m_s[:, :2]) * dt_s,
        seq=now.seq - 1,
        t_s=now.t_s - dt_s,
        name=now.name,
        track_id=now.track_id,
    )
    return graph.difference(graph.build(older), graph.build(now))


def line_fit(seen, dt_s, sd):
    """Return position, velocity (n, 2) and cov (n, 6, 6) of a line through ``seen (w, n, 2)``."""
    design = np.column_stack([np.ones(len(seen)), dt_s * np.arange(1.0 - len(seen), 1.0)])
    unit = np.linalg.inv(design.T @ design)
    fit = np.einsum("ij,wj,wnd->ind", unit, design, seen)
    cov = np.zeros((seen.shape[1], 6, 6))
    for axis in range(3):
        cov[:, axis, axis] = unit[0, 0] * sd**2
        cov[:, axis, axis + 3] = cov[:, axis + 3, axis] = unit[0, 1] * sd**2
        cov[:, axis + 3, axis + 3] = unit[1, 1] * sd**2
    return fit[0], fit[1], cov


def watch(true_m, sd, dt_s, window, rng):
    """Yield a difference graph per frame of noisy sightings of the true path ``(f, n, 2)``."""
    seen = true_m + rng.normal(size=true_m.shape) * sd
    older = None
    for frame in range(window - 1, len(seen)):
        pos, vel, cov = line_fit(seen[frame - window + 1 : frame + 1], dt_s, sd)
        now = tracks(
            pos, vel, seq=frame, t_s=frame * dt_s, cov=cov, n_samples=np.full(len(pos), window)
        )
        newer = graph.build(now)
        if older is not None:
            yield graph.difference(older, newer)
        older = newer
