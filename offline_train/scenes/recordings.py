"""Rows for calibration out of recordings: what the device saw, and what came of it.

A recording (MCAP of ``apex record``, ``apex run`` or ``apex demo``) is run through perception,
graph and the device's own trigger path up to the judgement; each pair of a protected object and
another one becomes a pair of ``Observed``, the protected object its centre.

When two objects touched is known in one of two ways.

- A labels file beside the recording, ``NAME.contacts.json`` next to ``NAME.mcap``::

      {"contacts": [{"names": ["green ball", "red"], "t_s": 12.4}]}

  with the names that the colours have and times on the recording's own clock. It is then the whole
  truth: what it does not name did not happen.
- Otherwise from what the tracks did later: the first time at which the distance of the two, means
  over two frames before and after, is at most the sum of their radii and ``MARGIN_M``; or at which
  they are within ``CORNER`` times that and one that lay still is set in motion; or within
  ``GRAZE`` times that and one that moved changes its velocity by half or more. (Seen from above a
  block is the disc of its area; corner to corner, blocks touch farther apart.) Positions that
  perception only predicted do not count.

In recordings of the twin the tracks found 30 of 31 touches, up to 0.25 s early, and none in 12 near
misses; what they miss is gentle (a ball that rolls out against a corner). A labels file is worth
its while.

What is not known is left out. A recording ends where the arm first moves: what would have come of
it without the arm, nobody saw. So calibrate on recordings of ``apex record``, with the arm parked;
a run in which the arm stepped in ends before the contact that it prevented. A frame whose horizon
reaches beyond the end has a label only if contact came before it; otherwise its row is dropped,
never called harmless.
Source: ours.
"""

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Optional, Sequence, Tuple

import numpy as np

from apex_edge import graph
from apex_edge.assemble import ApexConfig, load_colours
from apex_edge.errors import RecordingError
from apex_edge.perception import Perception
from apex_edge.record.mcap_io import RecordingReader
from apex_edge.triggers.base import N_DIMS, Evidence, Trigger, Verdict
from apex_edge.triggers.windows import WINDOWS
from apex_edge.types import Array, Frame, SceneGraph, Tracks, TrackStatus

MARGIN_M = 0.004
CORNER = 1.35
GRAZE = 1.15
_ABOUT_S = 0.3
_FAST_M_S = 0.012
_HALF_WINDOW = 2
# Joints of a simulated or measured arm at rest differ by less from frame to frame.
_STILL_RAD = 0.01
_SUFFIX = ".contacts.json"


@dataclass(frozen=True)
class Contact:
    """Two objects by name, and when they touched on the recording's clock."""

    names: Tuple[str, str]
    t_s: float


@dataclass
class Followed:
    """What perception made of f frames.

    ``t_s`` per frame; by track id: ``name``, ``place`` {frame: (2,) m, seen frames only},
    ``radius_m`` and ``speed_sd`` per frame it was placed in, ``n_samples`` {frame: count};
    ``evidence`` what the device's trigger was given to judge, per frame.
    """

    source: str
    t_s: List[float] = field(default_factory=list)
    name: Dict[int, str] = field(default_factory=dict)
    place: Dict[int, Dict[int, Array]] = field(default_factory=dict)
    radius_m: Dict[int, List[float]] = field(default_factory=dict)
    speed_sd: Dict[int, Dict[int, float]] = field(default_factory=dict)
    n_samples: Dict[int, Dict[int, int]] = field(default_factory=dict)
    evidence: List[Evidence] = field(default_factory=list)
    evidence_frame: List[int] = field(default_factory=list)

    def see(self, tracks: Tracks) -> None:
        """Take in the placed tracks of one frame."""
        frame = len(self.t_s)
        self.t_s.append(tracks.t_s)
        for row, track_id in enumerate(tracks.track_id.tolist()):
            self.name[track_id] = tracks.name[row]
            spread = tracks.cov[row, 3 : 3 + N_DIMS, 3 : 3 + N_DIMS]
            sd = math.sqrt(max(float(np.trace(spread)) / N_DIMS, 0.0))
            self.speed_sd.setdefault(track_id, {})[frame] = sd
            self.n_samples.setdefault(track_id, {})[frame] = int(tracks.n_samples[row])
            if tracks.status[row] == TrackStatus.SEEN:
                self.place.setdefault(track_id, {})[frame] = tracks.pos_m[row, :N_DIMS]
                self.radius_m.setdefault(track_id, []).append(float(tracks.radius_m[row]))


class _Collector(Trigger):
    """The device's trigger up to the judgement, which it only writes down."""

    def __init__(self, config: ApexConfig, followed: Followed) -> None:
        super().__init__(config.trigger, WINDOWS)
        self._followed = followed

    def judge(self, evidence: Evidence) -> Verdict:
        """Keep the evidence and say nothing."""
        self._followed.evidence.append(evidence)
        self._followed.evidence_frame.append(len(self._followed.t_s) - 1)
        n = len(evidence.is_moving)
        nothing = np.zeros(n, dtype=bool)
        return Verdict(np.zeros(n), nothing, nothing)


def follow(
    frames: Iterable[Frame], config: ApexConfig, horizon_s: float, source: str = ""
) -> Followed:
    """Run frames through perception, graph and trigger path, as the agent does."""
    perception = Perception(config.perception, load_colours(config.colours))
    followed = Followed(source)
    trigger = _Collector(config, followed)
    older: Optional[SceneGraph] = None
    for frame in frames:
        _, tracks = perception.step(frame)
        if frame.camera is None or frame.is_repeated:
            continue
        newer = graph.build(tracks)
        if older is not None and newer.t_s <= older.t_s:
            raise RecordingError(f"{source}: the capture times run backwards at {newer.t_s:.3f} s")
        followed.see(newer.tracks)
        if older is not None:
            trigger.score(graph.difference(older, newer), horizon_s)
        older = newer
    if len(followed.t_s) < 2:
        raise RecordingError(
            f"{source}: fewer than two frames with a calibrated camera; nothing can be learnt"
        )
    return followed


def until_arm_moves(path: Path) -> Iterator[Frame]:
    """Yield the frames of a recording up to the first one in which the arm is under way.

    Raises
    ------
    RecordingError : it cannot be read.
    """
    rest: Optional[Array] = None
    for recorded in RecordingReader(path):
        if recorded.arm is not None:
            rest = recorded.arm.joints_rad if rest is None else rest
            way = float(np.max(np.abs(recorded.arm.joints_rad - rest), initial=0.0))
            if recorded.arm.is_moving or way > _STILL_RAD:
                return
        yield recorded.frame


def read_contacts(path: Path) -> Optional[List[Contact]]:
    """Return the contacts of the labels file beside a recording; None when there is no file.

    Raises
    ------
    RecordingError : it is not of the form that the module's text gives.
    """
    labels = path.with_name(path.stem + _SUFFIX)
    if not labels.is_file():
        return None
    try:
        value: Any = json.loads(labels.read_text(encoding="utf-8"))
        return [_contact(entry) for entry in value["contacts"]]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise RecordingError(
            f"{labels}: not a labels file ({error!r}); expected "
            '{"contacts": [{"names": [A, B], "t_s": SECONDS}]}'
        ) from error


def contact_times(followed: Followed, pairs: Sequence[Tuple[int, int]]) -> Array:
    """Return when each pair (p,) of track ids first touches by its tracks, inf when never."""
    paths = {track: _smooth_path(followed, track) for pair in pairs for track in pair}
    times = np.array(followed.t_s)
    found = np.full(len(pairs), np.inf)
    for number, (one, other) in enumerate(pairs):
        gap = np.linalg.norm(paths[one] - paths[other], axis=1)
        reach = np.median(followed.radius_m[one]) + np.median(followed.radius_m[other]) + MARGIN_M
        with np.errstate(invalid="ignore"):
            touches = gap <= reach
            for limit, happens in ((CORNER, _is_struck), (GRAZE, _is_thrown_off)):
                is_near = gap <= limit * reach
                touches |= is_near & (
                    happens(followed, paths[one]) | happens(followed, paths[other])
                )
        if touches.any():
            found[number] = times[int(np.argmax(touches))]
    return found


def labelled_times(
    followed: Followed, pairs: Sequence[Tuple[int, int]], contacts: Sequence[Contact]
) -> Array:
    """Return when each pair (p,) of track ids first touches by the labels, inf when never.

    Of several tracks of one name those nearest to each other then are meant.

    Raises
    ------
    RecordingError : no two such objects were in view then.
    """
    found = np.full(len(pairs), np.inf)
    paths = {track: _smooth_path(followed, track) for pair in pairs for track in pair}
    times = np.array(followed.t_s)
    for contact in contacts:
        if not times[0] <= contact.t_s <= times[-1]:
            continue
        frame = int(np.searchsorted(times, contact.t_s).clip(0, len(times) - 1))
        gaps = [
            _gap_near(paths, pair, frame)
            if {followed.name[pair[0]], followed.name[pair[1]]} == set(contact.names)
            else np.inf
            for pair in pairs
        ]
        if not np.isfinite(gaps).any():
            raise RecordingError(
                f"{followed.source}: the labels say that {' and '.join(contact.names)} touch at "
                f"{contact.t_s:.2f} s, but no two such objects are tracked then"
            )
        number = int(np.argmin(gaps))
        found[number] = min(found[number], contact.t_s)
    return found


def _contact(entry: Dict[str, Any]) -> Contact:
    first, second = entry["names"]
    t_s = float(entry["t_s"])
    if not (isinstance(first, str) and isinstance(second, str) and math.isfinite(t_s)):
        raise ValueError(f"{entry!r} needs two names and a time")
    return Contact((first, second), t_s)


def _gap_near(paths: Dict[int, Array], pair: Tuple[int, int], frame: int) -> float:
    """Return the smallest distance in the half second about a frame, inf when not in view."""
    about = slice(max(0, frame - 8), frame + 8)
    gap = np.linalg.norm(paths[pair[0]][about] - paths[pair[1]][about], axis=1)
    return float(np.min(gap[np.isfinite(gap)], initial=np.inf))


def _smooth_path(followed: Followed, track: int) -> Array:
    """Return places (f, 2), each the mean of the seen ones two frames about it, else NaN."""
    n = len(followed.t_s)
    seen = np.zeros((n, 3))
    for frame, place in followed.place.get(track, {}).items():
        seen[frame] = (place[0], place[1], 1.0)
    kernel = np.ones(2 * _HALF_WINDOW + 1)
    total = np.column_stack([np.convolve(seen[:, i], kernel)[_HALF_WINDOW:][:n] for i in range(3)])
    is_seen = seen[:, 2] > 0.0
    path = np.full((n, 2), np.nan)
    path[is_seen] = total[is_seen, :2] / total[is_seen, 2:]
    return path


def _is_struck(followed: Followed, path: Array) -> Array:
    """Say in which frames (f,) what lay still moves off."""
    before, after = _steps(followed, path)
    struck: Array = (_length(after) > MARGIN_M) & (_length(before) < 0.25 * MARGIN_M)
    return struck


def _is_thrown_off(followed: Followed, path: Array) -> Array:
    """Say in which frames (f,) what moves changes its velocity by half or more."""
    before, after = _steps(followed, path)
    speed = _length(before)
    thrown: Array = (_length(after - before) > 0.5 * speed) & (speed > _FAST_M_S * _ABOUT_S)
    return thrown


def _steps(followed: Followed, path: Array) -> Tuple[Array, Array]:
    """Return the ways (f, 2) of the 0.3 s before and after each frame, else NaN.

    Where the recording has not the whole of it, a way cut short would pass for a change of speed.
    """
    times = np.array(followed.t_s)
    behind, ahead = (np.searchsorted(times, times + step) for step in (-_ABOUT_S, _ABOUT_S))
    before = path - path[behind]
    after = path[np.minimum(ahead, len(times) - 1)] - path
    before[times - _ABOUT_S < times[0]] = np.nan
    after[ahead == len(times)] = np.nan
    return before, after


def _length(vectors: Array) -> Array:
    length: Array = np.linalg.norm(vectors, axis=1)
    return length
