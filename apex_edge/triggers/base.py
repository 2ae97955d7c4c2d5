"""What all triggers share: the pairs, the moving gate, persistence; each adds its judgement.

A pair is only judged when its mover truly moves (a still table with noisy tracks never fires) and
when contact within the horizon is possible at the pessimistic end. It fires when the judgement
says hit in n of the last m frames. The trigger knows nothing of protected objects; the agent
filters. Source: APEX section "Trigger"; gate and persistence are ours.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, Optional, Tuple, Union

import numpy as np

from apex_edge.config import setting
from apex_edge.triggers.approach import (
    Approach,
    Pairs,
    closest,
    early_contact,
    first_contact,
)
from apex_edge.triggers.vote import Persistence
from apex_edge.triggers.windows import History, line_pairs
from apex_edge.types import Array, DifferenceGraph, HazardScores, Tracks

# The table is a plane; heights are the least certain part of a depth camera.
N_DIMS = 2
# Used when perception could not measure a size; about the largest toy on the table.
UNKNOWN_RADIUS_M = 0.02
# sd of the acceleration of a parabola fitted to a window of length T, as a multiple of (sd of its
# velocity at the end / T): sqrt(720) / sqrt(192). Perception publishes an acceleration only with a
# parabola. Only the slowing down beyond 1.64 of these sd counts, since believing in a stop that
# never comes would silence the alarm.
_ACC_SD_FACTOR = 1.94
_Z_PROVEN = 1.6449
_MAX_DECEL_M_S2 = 5.0


@dataclass(frozen=True)
class TriggerConfig:
    """Settings of the trigger stage, ``[trigger]``."""

    type: str = setting("linear", "name of the trigger plug-in")
    weights: str = setting("", "model file of a trained trigger; empty = the shipped one")
    k_sigma: float = setting(1.0, "sd of miss distance the analytic rule adds to the radius", 0, 6)
    min_speed_m_s: float = setting(0.02, "m/s below which an object counts as at rest", 0.0, 1.0)
    # Measured on white noise, windows of 5 to 20 frames: with 3 sd a still track passes the gate
    # in 3 of 5 frames up to 4 times in 1000 frames, with 4 sd at most 0.08 times.
    min_speed_sd: float = setting(4.0, "sd of velocity below which an object is at rest", 0, 20)
    persist_hits: int = setting(3, "frames with a hit needed to fire", 1, 60)
    persist_frames: int = setting(5, "frames looked back for the hits", 1, 60)
    drift_window_s: float = setting(30.0, "s of judged pairs the drift alarm looks at", 1.0, 3600.0)
    drift_min_pairs: int = setting(300, "judged pairs before the drift alarm speaks", 1, 1000000)
    # Of fresh scenes drawn like the training's, 0.07 % of 34 000 judged pairs lay outside the
    # domain, and at worst 2.7 % of any 300 in a row: frames of one approach are alike.
    drift_share: float = setting(
        0.1, "share of pairs unlike the training set that raises the alarm; 1 = never", 0.0, 1.0
    )


@dataclass(frozen=True)
class Evidence:
    """What is known of m pairs: who, geometry, noise, and how much was seen.

    ``mover_id``, ``target_id (m,)`` say which pairs share a mover or a target in this frame;
    ``ttc_s``, ``early_s (m,)`` time to contact, as estimated and at the pessimistic end;
    ``is_moving (m,)`` of the mover, ``n_samples (m,)`` behind the younger of the two tracks,
    ``horizon_s`` scalar; ``windows`` the same pairs as each window of a line fit sees them, none
    when the trigger has no use for them.
    """

    pairs: Pairs
    approach: Approach
    ttc_s: Array
    early_s: Array
    is_moving: Array
    n_samples: Array
    horizon_s: float
    mover_id: Array
    target_id: Array
    windows: Tuple[Pairs, ...] = ()

    @property
    def is_possible(self) -> Array:
        """Say which pairs (m,) have a true mover and can touch at the pessimistic end."""
        possible: Array = self.is_moving & np.isfinite(self.early_s)
        return possible

    def take(self, rows: Array) -> "Evidence":
        """Return the pairs chosen by a mask or by indices."""
        return Evidence(
            pairs=self.pairs.take(rows),
            approach=self.approach.take(rows),
            ttc_s=self.ttc_s[rows],
            early_s=self.early_s[rows],
            is_moving=self.is_moving[rows],
            n_samples=self.n_samples[rows],
            horizon_s=self.horizon_s,
            mover_id=self.mover_id[rows],
            target_id=self.target_id[rows],
            windows=tuple(pairs.take(rows) for pairs in self.windows),
        )


@dataclass(frozen=True)
class Verdict:
    """A judgement on m pairs: ``probability``, ``is_hit`` and ``is_fallback``, each (m,)."""

    probability: Array
    is_hit: Array
    is_fallback: Array


class Trigger(ABC):
    """Score each edge of a difference graph for contact within the horizon.

    Parameters
    ----------
    config : see TriggerConfig; None = defaults.
    windows : frames of the line fits ``judge`` needs of each pair; without any no sighting is kept.
    """

    def __init__(
        self, config: Optional[TriggerConfig] = None, windows: Tuple[int, ...] = ()
    ) -> None:
        self.config = config if config is not None else TriggerConfig()
        self._history = History(windows) if windows else None
        self._persistence = Persistence(self.config.persist_hits, self.config.persist_frames)

    def reset(self) -> None:
        """Forget earlier frames, as at start-up."""
        self._persistence.reset()
        if self._history is not None:
            self._history.reset()

    def score(self, diff: DifferenceGraph, horizon_s: float) -> HazardScores:
        """Score the edges of ``diff.graph``; call once per frame, in order."""
        tracks = diff.graph.tracks
        edges, is_moving = movers_first(tracks, diff.graph.edges, self.config)
        known = _Known.of(tracks)
        table = _Table.at_rest(tracks, edges, known)
        ids = tracks.track_id[edges]
        n_samples = tracks.n_samples
        if self._history is not None:
            self._history.update(tracks)
            n_samples = np.minimum(n_samples, self._history.counts())
        moving = np.flatnonzero(is_moving)
        if len(moving):
            some = edges[moving]
            pairs = _pairs(tracks, some, diff.dt_s, known)
            evidence = weigh(
                pairs,
                is_moving[moving],
                np.min(n_samples[some], axis=1),
                horizon_s,
                ids[moving],
                self._seen_by_windows(some, pairs.radius_m, diff.t_s),
            )
            table.put_approach(moving, evidence)
            possible = np.flatnonzero(evidence.is_possible)
            if len(possible):
                table.put_verdict(moving[possible], self.judge(evidence.take(possible)))
        voted = self._persistence.update(ids, table.is_hit)
        return HazardScores(
            seq=diff.seq,
            t_s=diff.t_s,
            mover_id=ids[:, 0],
            target_id=ids[:, 1],
            probability=table.probability,
            dca_m=table.dca_m,
            tca_s=table.tca_s,
            ttc_s=table.ttc_s,
            ttc_early_s=table.early_s,
            sigma_m=table.sigma_m,
            is_fired=voted & np.isfinite(table.early_s),
            is_fallback=table.is_fallback,
        )

    def _seen_by_windows(self, edges: Array, radius_m: Array, t_s: float) -> Tuple[Pairs, ...]:
        if self._history is None:
            return ()
        return tuple(line_pairs(lines, edges, radius_m) for lines in self._history.lines(t_s))

    @abstractmethod
    def judge(self, evidence: Evidence) -> Verdict:
        """Judge pairs which move and can touch."""


@dataclass
class _Table:
    """The columns of HazardScores while they are filled in, m edges."""

    dca_m: Array
    tca_s: Array
    ttc_s: Array
    early_s: Array
    sigma_m: Array
    probability: Array
    is_hit: Array
    is_fallback: Array

    @classmethod
    def at_rest(cls, tracks: Tracks, edges: Array, known: "_Known") -> "_Table":
        """Start with what holds for ``edges (m, 2)`` of which nothing moves."""
        n = len(edges)
        mover, target = edges[:, 0], edges[:, 1]
        variance = np.einsum("nii->n", known.cov[:, :N_DIMS, :N_DIMS])
        radius = known.radius_m
        offset = tracks.pos_m[target, :N_DIMS] - tracks.pos_m[mover, :N_DIMS]
        gap = np.sqrt((offset * offset).sum(axis=1))
        place_var = np.maximum(variance[mover] + variance[target], 0.0) / N_DIMS
        return cls(
            dca_m=gap,
            tca_s=np.zeros(n),
            ttc_s=np.where(gap <= radius[mover] + radius[target], 0.0, np.inf),
            early_s=np.full(n, np.inf),
            sigma_m=np.sqrt(place_var),
            probability=np.zeros(n),
            is_hit=np.zeros(n, dtype=bool),
            is_fallback=np.zeros(n, dtype=bool),
        )

    def put_approach(self, rows: Array, evidence: Evidence) -> None:
        """Fill in the geometry of the pairs that move."""
        self.dca_m[rows] = evidence.approach.dca_m
        self.tca_s[rows] = evidence.approach.tca_s
        self.ttc_s[rows] = evidence.ttc_s
        self.early_s[rows] = evidence.early_s
        self.sigma_m[rows] = evidence.approach.miss_sd_m

    def put_verdict(self, rows: Array, verdict: Verdict) -> None:
        """Fill in the judgement on the pairs that can touch."""
        self.probability[rows] = verdict.probability
        self.is_hit[rows] = verdict.is_hit
        self.is_fallback[rows] = verdict.is_fallback


def movers_first(tracks: Tracks, edges: Array, config: TriggerConfig) -> Tuple[Array, Array]:
    """Order each edge (mover, target) and say whether the mover moves.

    The mover is the faster of the two; one that truly moves goes before one that only jitters.

    Returns
    -------
    edges (m, 2) as indices of tracks, is_moving (m,). A track whose velocity or covariance is
    not finite does not count as moving: nothing is known of its motion.
    """
    velocity = tracks.vel_m_s[:, :N_DIMS]
    speed = np.sqrt(np.einsum("nd,nd->n", _finite(velocity), _finite(velocity)))
    spread = tracks.cov[:, 3 : 3 + N_DIMS, 3 : 3 + N_DIMS]
    is_known = np.all(np.isfinite(velocity), axis=1) & np.all(np.isfinite(spread), axis=(1, 2))
    variance = np.where(is_known, np.einsum("nii->n", spread) / N_DIMS, 0.0)
    floor = np.maximum(config.min_speed_m_s, config.min_speed_sd * np.sqrt(np.maximum(variance, 0)))
    moves = is_known & (speed > floor)
    rank = speed + np.where(moves, 1e6, 0.0)
    swap = rank[edges[:, 1]] > rank[edges[:, 0]]
    ordered = np.where(swap[:, None], edges[:, ::-1], edges)
    return ordered, moves[ordered[:, 0]]


def weigh(
    pairs: Pairs,
    is_moving: Array,
    n_samples: Array,
    horizon_s: float,
    ids: Optional[Array] = None,
    windows: Tuple[Pairs, ...] = (),
) -> Evidence:
    """Work out closest approach, noise and pessimistic contact of m pairs.

    ``ids (m, 2)`` of movers and targets; None = no two pairs have an object in common. ``windows``
    as in Evidence.
    """
    approach = closest(pairs, horizon_s)
    if ids is None:
        ids = np.arange(2 * len(is_moving)).reshape(-1, 2)
    return Evidence(
        pairs=pairs,
        approach=approach,
        ttc_s=first_contact(pairs, approach, horizon_s),
        early_s=early_contact(pairs, approach, horizon_s),
        is_moving=is_moving,
        n_samples=n_samples,
        horizon_s=horizon_s,
        mover_id=ids[:, 0],
        target_id=ids[:, 1],
        windows=windows,
    )


class _Known(NamedTuple):
    """Per track: ``cov (n, 4, 4)`` of place and velocity in the plane, ``radius_m (n,)``.

    What is unknown is zero, or the radius about the largest of a toy.
    """

    cov: Array
    radius_m: Array

    @classmethod
    def of(cls, tracks: Tracks) -> "_Known":
        """Take them from tracks."""
        wanted = np.concatenate([np.arange(N_DIMS), 3 + np.arange(N_DIMS)])
        cov = tracks.cov[:, wanted[:, None], wanted]
        cov = np.where(np.all(np.isfinite(cov), axis=(1, 2))[:, None, None], cov, 0.0)
        is_sized = np.isfinite(tracks.radius_m) & (tracks.radius_m > 0.0)
        return cls(cov, np.where(is_sized, tracks.radius_m, UNKNOWN_RADIUS_M))


def pairs_of(tracks: Tracks, edges: Array, frame_s: Union[float, Array]) -> Pairs:
    """Return the planar pairs (mover, target) of ``edges (m, 2)``; ``frame_s`` is the time
    between frames, scalar or one per track.

    Unknown velocity or covariance becomes zero here; the moving gate keeps such pairs silent.
    """
    return _pairs(tracks, edges, frame_s, _Known.of(tracks))


def _pairs(tracks: Tracks, edges: Array, frame_s: Union[float, Array], known: _Known) -> Pairs:
    mover, target = edges[:, 0], edges[:, 1]
    place = tracks.pos_m[:, :N_DIMS]
    velocity = _finite(tracks.vel_m_s[:, :N_DIMS])
    cov, radius = known.cov, known.radius_m
    decel = proven_decel(
        velocity,
        tracks.acc_m_s2[:, :N_DIMS],
        cov[:, N_DIMS:, N_DIMS:],
        (tracks.n_samples - 1) * frame_s,
    )
    return Pairs(
        offset_m=place[target] - place[mover],
        mover_vel_m_s=velocity[mover],
        target_vel_m_s=velocity[target],
        decel_m_s2=decel[mover],
        radius_m=radius[mover] + radius[target],
        cov=cov[mover] + cov[target],
    )


def proven_decel(velocity: Array, acc: Array, vel_cov: Array, window_s: Array) -> Array:
    """Return the slowing down (n,) in m/s^2 that the samples prove, 0 where they prove none.

    Parameters
    ----------
    velocity, acc : (n, d) in m/s and m/s^2; NaN in acc counts as none given.
    vel_cov : (n, d, d); window_s : (n,) time covered by the samples behind the fit.
    """
    speed = np.sqrt(np.einsum("nd,nd->n", velocity, velocity))
    heading = velocity / np.where(speed > 0.0, speed, 1.0)[:, None]
    against = -np.einsum("nd,nd->n", _finite(acc), heading)
    variance = np.maximum(np.einsum("ni,nij,nj->n", heading, vel_cov, heading), 0.0)
    has_window = window_s > 0.0
    doubt = _ACC_SD_FACTOR * np.sqrt(variance) / np.where(has_window, window_s, 1.0)
    proven = np.clip(against - _Z_PROVEN * doubt, 0.0, _MAX_DECEL_M_S2)
    decel: Array = np.where(has_window & (speed > 0.0), proven, 0.0)
    return decel


def _finite(values: Array) -> Array:
    known: Array = np.where(np.isfinite(values), values, 0.0)
    return known
