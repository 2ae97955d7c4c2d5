"""Straight lines through the newest sightings of each track, over several windows at once.

A long window knows the velocity well but lags behind a bend; a short one is noisy but up to date.
Motion that is meant to end somewhere shows in what they disagree on. One source for the trainer,
which fits many rows at once, and the device, which keeps the last sightings of each track.
Source: ours; the paper takes the mean of five positions.
"""

from typing import NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.triggers.approach import Pairs
from apex_edge.types import Array, Tracks

WINDOWS: Tuple[int, ...] = (5, 11, 20)
# A line through two sightings has no doubt left to tell of.
MIN_SIGHTINGS = 3


class Lines(NamedTuple):
    """Lines of n tracks: ``position``, ``velocity (n, d)``, ``cov (n, 2d, 2d)`` of both.

    NaN where fewer than ``MIN_SIGHTINGS`` were given.
    """

    position: Array
    velocity: Array
    cov: Array


def fit_lines(t_s: Array, xy: Array, sd: Array, at_s: Optional[Array] = None) -> Lines:
    """Fit a least-squares line to the sightings of each of n tracks, by their real times.

    A track younger than the window uses what it has: its covariance says how little that is.

    Parameters
    ----------
    t_s : (n, w) times, the newest last; NaN where there is no sighting (the oldest, if any).
    xy : (n, w, d) sightings in metres.
    sd : (n,) random sd of a sighting, per axis.
    at_s : (n,) time the line is read at; None = that of the newest sighting.
    """
    n, _, n_dims = xy.shape
    is_there = np.isfinite(t_s)
    count = is_there.sum(axis=1)
    is_enough = count >= MIN_SIGHTINGS
    age = np.where(is_there, t_s - (t_s[:, -1] if at_s is None else at_s)[:, None], 0.0)
    share = is_there / np.maximum(count, 1)[:, None]
    middle = np.einsum("nw,nw->n", share, age)
    lever = np.where(is_there, age - middle[:, None], 0.0)
    spread = np.einsum("nw,nw->n", lever, lever)
    inverse = np.where(is_enough & (spread > 0.0), 1.0, np.nan) / np.where(spread > 0, spread, 1.0)
    seen = np.where(is_there[..., None], xy, 0.0)
    velocity = np.einsum("nw,nwd->nd", lever, seen) * inverse[:, None]
    position = np.einsum("nw,nwd->nd", share, seen) - middle[:, None] * velocity
    cov = np.zeros((n, 2 * n_dims, 2 * n_dims))
    place, rate = np.arange(n_dims), np.arange(n_dims, 2 * n_dims)
    unit = np.stack([1.0 / np.maximum(count, 1) + middle**2 * inverse, -middle * inverse, inverse])
    place_var, shared, rate_var = (sd * sd * unit)[..., None]
    cov[:, place, place], cov[:, rate, rate] = place_var, rate_var
    cov[:, place, rate] = cov[:, rate, place] = shared
    return Lines(position, velocity, cov)


def line_pairs(lines: Lines, edges: Array, radius_m: Array) -> Pairs:
    """Return the pairs (mover, target) of ``edges (m, 2)`` as one window sees them.

    ``radius_m (m,)`` of both together. Nothing is said of slowing down: a line knows none.
    """
    mover, target = edges[:, 0], edges[:, 1]
    return Pairs(
        offset_m=lines.position[target] - lines.position[mover],
        mover_vel_m_s=lines.velocity[mover],
        target_vel_m_s=lines.velocity[target],
        decel_m_s2=np.zeros(len(edges)),
        radius_m=radius_m,
        cov=lines.cov[mover] + lines.cov[target],
    )


class History:
    """The last sightings of each track, in the plane; ``update`` once per frame."""

    def __init__(self, windows: Tuple[int, ...] = WINDOWS, n_dims: int = 2) -> None:
        self._windows = windows
        self._n_dims = n_dims
        self.reset()

    def reset(self) -> None:
        """Forget all sightings."""
        depth = max(self._windows)
        self._ids = np.zeros(0, dtype=np.int64)
        self._t_s = np.zeros((0, depth))
        self._xy = np.zeros((0, depth, self._n_dims))
        self._sd = np.zeros((0, depth))

    def update(self, tracks: Tracks) -> None:
        """Take in the sightings of one frame; a track that is gone is forgotten."""
        self._follow(tracks.track_id)
        seen = np.flatnonzero(
            np.isfinite(tracks.seen_m[:, : self._n_dims]).all(axis=1)
            & np.isfinite(tracks.seen_sd_m)
        )
        newest = (
            (self._t_s, tracks.t_s),
            (self._xy, tracks.seen_m[seen, : self._n_dims]),
            (self._sd, tracks.seen_sd_m[seen]),
        )
        for ring, value in newest:
            ring[seen, :-1] = ring[seen, 1:]
            ring[seen, -1] = value

    def counts(self) -> Array:
        """Return how many sightings (n,) are kept of each track of the newest frame."""
        counts: Array = np.isfinite(self._t_s).sum(axis=1)
        return counts

    def lines(self, t_s: float) -> Tuple[Lines, ...]:
        """Return one line per window for each track of the newest frame, read at ``t_s``."""
        now = np.full(len(self._ids), t_s)
        found = []
        for window in self._windows:
            times, sd = self._t_s[:, -window:], self._sd[:, -window:]
            is_there = np.isfinite(times)
            mean_sq = np.where(is_there, sd * sd, 0.0).sum(axis=1) / np.maximum(
                is_there.sum(axis=1), 1
            )
            found.append(fit_lines(times, self._xy[:, -window:], np.sqrt(mean_sq), now))
        return tuple(found)

    def _follow(self, ids: Array) -> None:
        """Lay the rings out in the order of the newest frame's tracks."""
        rows = {track_id: row for row, track_id in enumerate(self._ids.tolist())}
        old = np.array([rows.get(track_id, -1) for track_id in ids.tolist()], dtype=np.int64)
        is_new = old < 0
        padded = [
            np.concatenate([ring, np.full((1,) + ring.shape[1:], np.nan)])
            for ring in (self._t_s, self._xy, self._sd)
        ]
        self._t_s, self._xy, self._sd = (ring[np.where(is_new, -1, old)] for ring in padded)
        self._ids = ids.copy()
