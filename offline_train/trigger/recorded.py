"""Recordings as ``Observed`` rows: the same form as simulated scenes, for certifying a threshold.

The rows are those the device's trigger would have judged; the truth is that of
``offline_train.scenes.recordings``. A pair is a protected object and another track.
"""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from apex_edge.assemble import ApexConfig
from apex_edge.errors import RecordingError
from apex_edge.triggers.analytic import k_sigma_rule
from apex_edge.triggers.approach import Pairs
from apex_edge.triggers.base import Evidence, TriggerConfig
from apex_edge.triggers.features import FEATURE_NAMES, edge_features
from apex_edge.triggers.wide import WIDE_NAMES, wide_features
from apex_edge.types import Array
from offline_train.scenes.recordings import (
    Contact,
    Followed,
    contact_times,
    follow,
    labelled_times,
    read_contacts,
    until_arm_moves,
)
from offline_train.trigger.observe import Observed, Watching, join

# A younger track is left to the k-sigma rule by every model so far.
_MIN_SAMPLES = Watching.window[0]
_CLEAR = 1.25
_ABOUT_S = 0.25


@dataclass(frozen=True)
class Rig:
    """How recordings are looked at: the user's settings, and the horizon of the model."""

    config: ApexConfig
    horizon_s: float


class _Found(NamedTuple):
    """Rows of one recording: ``pair``, ``frame (r,)``, ``centre_moves (r,)`` and their evidence."""

    pair: Array
    frame: Array
    centre_moves: Array
    evidence: List[Evidence]


def read_folder(folder: Path, rig: Rig) -> Tuple[Observed, List[Path]]:
    """Return the rows of all recordings (``*.mcap``) of a folder, and their paths, by name.

    Raises
    ------
    RecordingError : none there, one cannot be read, or nothing protected is in view in any.
    """
    paths = sorted(Path(folder).glob("*.mcap"))
    if not paths:
        raise RecordingError(f"{folder}: no recording (*.mcap) in this folder")
    parts = []
    for path in paths:
        contacts = read_contacts(path)
        followed = follow(until_arm_moves(path), rig.config, rig.horizon_s, str(path))
        parts.append(observed(followed, rig, contacts))
    whole = [part for part in parts if part is not None]
    if not whole:
        names = ", ".join(rig.config.agent.protected)
        raise RecordingError(f"{folder}: no recording shows a protected object ({names}) and more")
    return joined(whole), paths


def joined(parts: Sequence[Observed]) -> Observed:
    """Return recordings of different lengths as one; frames that one has not are not judged."""
    longest = max(part.is_judged.shape[1] for part in parts)
    padded = []
    for part in parts:
        more = ((0, 0), (0, longest - part.is_judged.shape[1]))
        arrays = part.to_arrays()
        for name in ("is_judged", "is_clear"):
            arrays[name] = np.pad(arrays[name], more)
        padded.append(Observed.from_arrays(arrays))
    return join(padded)


def observed(
    followed: Followed, rig: Rig, contacts: Optional[Sequence[Contact]] = None
) -> Optional[Observed]:
    """Return the rows of one recording; None when no protected object is in view with another.

    Parameters
    ----------
    contacts : all there were, by the labels file; None = told from the tracks.

    Raises
    ------
    RecordingError : labels name objects that are not tracked then.
    """
    protected = rig.config.agent.protected
    centres = [track for track in sorted(followed.place) if followed.name[track] in protected]
    pairs = [
        (centre, other)
        for centre in centres
        for other in sorted(followed.place)
        if other != centre and followed.name[other] not in protected
    ]
    if not pairs:
        return None
    times = np.array(followed.t_s)
    frame_s = float((times[-1] - times[0]) / (len(times) - 1))
    when = (
        labelled_times(followed, pairs, contacts)
        if contacts is not None
        else contact_times(followed, pairs)
    )
    # On the scale of frames, which is what gate and vote count.
    on_frames = np.interp(when, times, np.arange(len(times)) * frame_s)
    contact_s = np.where(np.isfinite(when), on_frames, np.inf)
    return _table(followed, pairs, (contact_s, frame_s), rig)


def _table(
    followed: Followed, pairs: Sequence[Tuple[int, int]], when: Tuple[Array, float], rig: Rig
) -> Observed:
    contact_s, frame_s = when
    n, n_frames = len(pairs), len(followed.t_s)
    time = np.arange(n_frames) * frame_s
    is_old = np.array([_is_old(followed, pair, n_frames) for pair in pairs])
    left_s = contact_s[:, None] - time
    is_known = (left_s <= rig.horizon_s) | (time + rig.horizon_s <= time[-1])
    is_judged = is_old & is_known & (left_s > 0.0)
    is_clear = is_judged & np.array(
        [
            _is_clear(followed, pair, rig.config.trigger, left > _ABOUT_S)
            for pair, left in zip(pairs, left_s)
        ]
    )
    rows = _rows(followed, pairs)
    keep = is_judged[rows.pair, rows.frame]
    centres = [pair[0] for pair in pairs]
    scene = np.unique(centres, return_inverse=True)[1]
    body = np.array([1 + centres[:i].count(centres[i]) for i in range(n)])
    columns = _columns(rows, rig)
    chosen = {name: column[keep] for name, column in columns.items()}
    return Observed.from_arrays(
        dict(
            chosen,
            pair=rows.pair[keep],
            frame=rows.frame[keep],
            centre_moves=rows.centre_moves[keep],
            label=left_s[rows.pair[keep], rows.frame[keep]] <= rig.horizon_s,
            soft=np.full(int(keep.sum()), np.nan),
            scene=scene,
            body=body,
            kind=np.zeros(n, dtype=np.int64),
            contact_s=contact_s,
            frame_s=np.full(n, frame_s),
            horizon_s=np.full(n, rig.horizon_s),
            is_judged=is_judged,
            is_clear=is_clear,
        )
    )


def _is_old(followed: Followed, pair: Tuple[int, int], n_frames: int) -> Array:
    """Say in which frames (f,) both tracks rest on enough samples."""
    old = np.ones(n_frames, dtype=bool)
    for track in pair:
        samples = np.zeros(n_frames)
        for frame, count in followed.n_samples[track].items():
            samples[frame] = count
        old &= samples >= _MIN_SAMPLES
    return old


def _is_clear(
    followed: Followed, pair: Tuple[int, int], config: TriggerConfig, is_before: Array
) -> Array:
    """Say in which frames (f,) the faster of the two moves faster than the gate by a quarter.

    The speed is that of the seen places half a second apart, so it owes nothing to the motion fit
    that the gate itself looks at. Which is the faster shows in the frames ``is_before (f,)`` the
    contact: after it, what was struck may run ahead of what struck it.
    """
    times = np.array(followed.t_s)
    best, best_peak = np.zeros(len(times), dtype=bool), -1.0
    for track in pair:
        speed, gate = np.zeros(len(times)), np.full(len(times), np.inf)
        seen = np.array(sorted(followed.place[track]))
        places = np.array([followed.place[track][frame] for frame in seen.tolist()])
        for frame, sd in followed.speed_sd[track].items():
            gate[frame] = max(config.min_speed_m_s, config.min_speed_sd * sd)
        first = np.searchsorted(times[seen], times[seen] - _ABOUT_S)
        last = np.minimum(np.searchsorted(times[seen], times[seen] + _ABOUT_S), len(seen) - 1)
        span = np.maximum(times[seen][last] - times[seen][first], 1e-3)
        speed[seen] = np.linalg.norm(places[last] - places[first], axis=1) / span
        peak = float(np.max(speed[is_before], initial=0.0))
        if peak > best_peak:
            best, best_peak = speed > _CLEAR * gate, peak
    return best


def _rows(followed: Followed, pairs: Sequence[Tuple[int, int]]) -> _Found:
    """Pick the rows of the wanted pairs out of what the trigger was given."""
    number = {pair: index for index, pair in enumerate(pairs)}
    pair, frame, centre_moves, evidence = [], [], [], []
    for at, judged in zip(followed.evidence_frame, followed.evidence):
        ids = np.column_stack([judged.mover_id, judged.target_id]).tolist()
        wanted = []
        for row, (mover, target) in enumerate(ids):
            for key, is_centre in (((mover, target), True), ((target, mover), False)):
                if key in number:
                    wanted.append(row)
                    pair.append(number[key])
                    centre_moves.append(is_centre)
        frame += [at] * len(wanted)
        if wanted:
            evidence.append(judged.take(np.array(wanted)))
    return _Found(
        np.array(pair, dtype=np.int64),
        np.array(frame, dtype=np.int64),
        np.array(centre_moves, dtype=bool),
        evidence,
    )


def _columns(rows: _Found, rig: Rig) -> Dict[str, Array]:
    """Return geometry, features and the rule's verdict of the rows, by the device's own code."""
    parts: Dict[str, List[Any]] = {}
    for evidence in rows.evidence:
        rule = k_sigma_rule(evidence, rig.config.trigger.k_sigma)
        columns = {
            "features": edge_features(evidence.pairs, evidence.approach, rig.horizon_s),
            "wide": wide_features(evidence.windows, rig.horizon_s),
            "rule_probability": rule.probability,
            "rule_hit": rule.is_hit,
        }
        for spec in fields(Pairs):
            columns["geometry." + spec.name] = getattr(evidence.pairs, spec.name)
        for name, column in columns.items():
            parts.setdefault(name, []).append(column)
    if not parts:
        return _nothing()
    return {name: np.concatenate(columns) for name, columns in parts.items()}


def _nothing() -> Dict[str, Array]:
    shapes = {"offset_m": (2,), "mover_vel_m_s": (2,), "target_vel_m_s": (2,), "cov": (4, 4)}
    empty = {
        "geometry." + spec.name: np.zeros((0, *shapes.get(spec.name, ()))) for spec in fields(Pairs)
    }
    empty["features"] = np.zeros((0, len(FEATURE_NAMES)))
    empty["wide"] = np.zeros((0, len(WIDE_NAMES)))
    return dict(empty, rule_probability=np.zeros(0), rule_hit=np.zeros(0, dtype=bool))
