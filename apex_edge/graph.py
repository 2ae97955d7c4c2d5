"""Relational graphs over the tracks, their difference, the most salient edges and their words.

Source: APEX sections "Graph: Relational Scene Representation" and "Trigger".
"""

import re
from collections import Counter
from dataclasses import fields, replace
from typing import Dict, List, Tuple

import numpy as np

from apex_edge.types import (
    Array,
    DifferenceGraph,
    HazardScores,
    SceneGraph,
    Tracks,
    TrackStatus,
)

NOTHING = "nothing on the table is about to meet"
# A pair less likely than this to touch, and not fired, is not worth a word.
_SALIENT = 0.05
_MAX_NAME = 24
# Below this (share of the horizon left) the closest approach still lies ahead.
_STILL_NEARING = 0.999


def build(tracks: Tracks) -> SceneGraph:
    """Build G_t: tracks with a finite metric position that are not lost, and all their pairs."""
    is_placed = np.all(np.isfinite(tracks.pos_m), axis=1)
    kept = _take(tracks, is_placed & (tracks.status != TrackStatus.LOST))
    first, second = np.triu_indices(len(kept.name), k=1)
    offset = kept.pos_m[second] - kept.pos_m[first]
    return SceneGraph(
        seq=kept.seq,
        t_s=kept.t_s,
        tracks=kept,
        edges=np.column_stack([first, second]),
        offset_m=offset,
        rel_vel_m_s=kept.vel_m_s[second] - kept.vel_m_s[first],
        distance_m=np.linalg.norm(offset, axis=1),
    )


def difference(older: SceneGraph, newer: SceneGraph) -> DifferenceGraph:
    """Form dG = newer - older, edge by edge, matched by track ids.

    A relation the older graph does not have is ``is_new`` and has zero displacement.
    """
    keys_old, sign_old, keys_new, sign_new = _edge_keys(older, newer)
    order = np.argsort(keys_old, kind="stable")
    slot = np.searchsorted(keys_old[order], keys_new)
    is_known = np.isin(keys_new, keys_old)
    match = order[slot[is_known]]
    displacement = np.zeros_like(newer.offset_m)
    turn = (sign_old[match] * sign_new[is_known])[:, None]
    displacement[is_known] = newer.offset_m[is_known] - turn * older.offset_m[match]
    gone = ~np.isin(keys_old, keys_new)
    ids = np.sort(older.tracks.track_id[older.edges[gone]], axis=1)
    safe = np.where(newer.distance_m > 0.0, newer.distance_m, 1.0)
    return DifferenceGraph(
        seq=newer.seq,
        t_s=newer.t_s,
        dt_s=newer.t_s - older.t_s,
        graph=newer,
        displacement_m=displacement,
        rel_vel_m_s=newer.rel_vel_m_s,
        closing_m_s=-np.einsum("md,md->m", newer.offset_m, newer.rel_vel_m_s) / safe,
        is_new=~is_known,
        vanished=tuple((int(a), int(b)) for a, b in ids),
    )


def top_k(scores: HazardScores, k: int) -> Array:
    """Return the indices (<= k,) of the most salient edges: most likely first, then soonest."""
    likely = np.nan_to_num(scores.probability, nan=0.0)
    soon = np.where(np.isfinite(scores.ttc_s), scores.ttc_s, 1e3 + np.nan_to_num(scores.tca_s))
    chosen: Array = np.lexsort((soon, -likely))[: max(k, 0)]
    return chosen


def summarise(diff: DifferenceGraph, scores: HazardScores, k: int, horizon_s: float) -> str:
    """Say in plain words what the k most salient edges are about to do: the summary S.

    Gaps are edge to edge. Names are reduced to ``[a-z0-9 _-]``, so that no text from outside
    reaches a prompt. Source: APEX section "Trigger" ("sphere A is about to collide with B").
    """
    is_worth = scores.is_fired | (scores.probability >= _SALIENT)
    rows = [int(row) for row in top_k(scores, len(is_worth)) if is_worth[row]][: max(k, 0)]
    if not rows:
        return NOTHING
    names = _spoken_names(diff.graph.tracks)
    radius = dict(zip(diff.graph.tracks.track_id.tolist(), diff.graph.tracks.radius_m.tolist()))
    said = []
    for row in rows:
        mover, target = int(scores.mover_id[row]), int(scores.target_id[row])
        reach = np.nansum([radius[mover], radius[target]])
        pair = (names[mover], names[target])
        said.append(_sentence(pair, scores, row, (float(reach), horizon_s)))
    return "; ".join(said)


def _sentence(
    pair: Tuple[str, str], scores: HazardScores, row: int, reach_and_horizon: Tuple[float, float]
) -> str:
    reach_m, horizon_s = reach_and_horizon
    mover, target = pair
    gap_cm = 100.0 * (float(scores.dca_m[row]) - reach_m)
    ttc_s, tca_s = float(scores.ttc_s[row]), float(scores.tca_s[row])
    if ttc_s < 0.05:
        return f"{mover} touches {target} now"
    if gap_cm <= 0.0 or np.isfinite(ttc_s):
        return f"{mover} will touch {target} in {min(ttc_s, tca_s):.1f} s"
    if tca_s >= _STILL_NEARING * horizon_s:
        return f"{mover} is nearing {target} and will be {gap_cm:.1f} cm away in {tca_s:.1f} s"
    return f"{mover} will pass within {gap_cm:.1f} cm of {target} in {tca_s:.1f} s"


def _spoken_names(tracks: Tracks) -> Dict[int, str]:
    plain = [re.sub(r"[^a-z0-9 _-]", "_", name.lower())[:_MAX_NAME].strip() for name in tracks.name]
    plain = [name or "object" for name in plain]
    count = Counter(plain)
    ids: List[int] = tracks.track_id.tolist()
    return {
        track: name if count[name] == 1 else f"{name} #{track}" for track, name in zip(ids, plain)
    }


def _take(tracks: Tracks, keep: Array) -> Tracks:
    changes = {
        spec.name: getattr(tracks, spec.name)[keep]
        for spec in fields(tracks)
        if isinstance(getattr(tracks, spec.name), np.ndarray)
    }
    name = tuple(name for name, is_kept in zip(tracks.name, keep.tolist()) if is_kept)
    return replace(tracks, name=name, **changes)


def _edge_keys(older: SceneGraph, newer: SceneGraph) -> Tuple[Array, Array, Array, Array]:
    """Return one integer per edge, the same for the same two tracks, and the edge's direction."""
    known = np.unique(np.concatenate([older.tracks.track_id, newer.tracks.track_id]))
    keys: List[Array] = []
    for graph in (older, newer):
        rank = np.searchsorted(known, graph.tracks.track_id)[graph.edges].reshape(-1, 2)
        keys.append(rank.min(axis=1) * len(known) + rank.max(axis=1))
        keys.append(np.where(rank[:, 0] <= rank[:, 1], 1.0, -1.0))
    return keys[0], keys[1], keys[2], keys[3]
