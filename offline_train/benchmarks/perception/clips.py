"""Labelled clips: does perception find what was labelled, where, and how fast.

Every clip is played through the same camera, stage and tracker as ``apex replay`` uses, without a
camera calibration, that is in pixels. See docs/labelled-clips.md for the files. Source: ours.
"""

import time
from dataclasses import dataclass
from statistics import median
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

from apex_edge import plugins
from apex_edge.cameras.base import Camera
from apex_edge.cameras.playback import config_for
from apex_edge.errors import ColourError, InputError
from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.types import Array, Frame, Tracks, TrackStatus
from apex_edge.verbs.progress import Progress
from calib import colour
from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.benchmarks.perception.recorder import Note, listening
from offline_train.benchmarks.perception.truth import Centre, ClipTruth, StraightRun

COLOURS_FILE = "colours.json"
N_TEACHERS = 3
DISC_SHARE = 0.7  # of the label's radius: the rim of a moving ball is half background
MIN_WITHIN = 0.95


class Seen(NamedTuple):
    """The tracks SEEN in one frame: ``name``, ``track_id (n,)``, ``centre_px (n, 2)``."""

    t_s: float
    name: Tuple[str, ...]
    track_id: Array
    centre_px: Array


@dataclass(frozen=True)
class ClipRun:
    """What perception made of a clip: per frame what it saw, its notes, the cost of a frame."""

    seen: Tuple[Seen, ...]
    notes: Tuple[Note, ...]
    frame_ms: float


@dataclass(frozen=True)
class ClipScore:
    """How a run compares with the truth; ``gaps_px`` per label, inf where nothing was seen.

    ``n_switches`` counts how often an object changed its track, None where labels of one name do
    not say which object they mean; ``speed_off`` is each straight run's error over its tolerance.
    """

    gaps_px: Tuple[float, ...]
    n_within: int
    n_reports: int
    n_absences: int
    n_switches: Optional[int]
    speed_off: Tuple[float, ...]


def frames_of(truth: ClipTruth) -> Iterator[Frame]:
    """Yield the frames of a clip, without the calibration a folder may carry.

    Raises
    ------
    RecordingError : the video cannot be read.
    InputError : its pictures are of another size than labelled, or too few.
    """
    source = config_for(truth.video)
    kept: Camera = plugins.load("cameras", source.type)(source)
    n_frames = 0
    with kept:
        while True:
            frame = kept.read(0.0)
            if frame is None:
                break
            height, width = frame.colour_bgr.shape[:2]
            if (width, height) != truth.size_px:
                raise InputError(
                    f"{truth.video}: pictures are {width}x{height}, but size_px of its truth is "
                    f"{list(truth.size_px)}"
                )
            yield Frame(frame.seq, frame.t_s, frame.colour_bgr, is_repeated=frame.is_repeated)
            n_frames += 1
    if n_frames <= truth.last_frame:
        raise InputError(
            f"{truth.video}: has {n_frames} frames, but its truth labels frame {truth.last_frame}"
        )


def colours_of(truth: ClipTruth) -> ColourTable:
    """Return the colours of a clip: its own file, or taught from a few of its labels.

    Teachers are the labels in the frames named by ``teach``; without it, of each name the three
    whose area is nearest the median of those that lie wholly in the picture: neither cut off nor
    smeared nor far away.

    Raises
    ------
    ColourError : the file cannot be used, or a colour cannot be told from its surroundings.
    """
    own = truth.folder / COLOURS_FILE
    if own.is_file():
        return ColourTable.load(own)
    chosen = teachers(truth)
    wanted = sorted({centre.frame for centre in chosen})
    pictures = {f.seq: f.colour_bgr for f in frames_of(truth) if f.seq in wanted}
    height = truth.size_px[1]
    samples = [
        colour.Sample(c.name, c.x_px, c.y_px + height * wanted.index(c.frame), _disc_px(c))
        for c in chosen
    ]
    result = colour.solve(np.vstack([pictures[frame] for frame in wanted]), samples)
    if result.verdict.is_refused:
        raise ColourError(
            f"{truth.folder}: colours taught from frames {wanted} are refused: "
            f"{'; '.join(result.verdict.reasons)}; name better frames in teach"
        )
    return ColourTable(result.models)


def teachers(truth: ClipTruth) -> List[Centre]:
    """Return the labels that teach the colours, of every name at least one.

    Raises
    ------
    InputError : ``teach`` names frames in which a name is not labelled.
    """
    chosen: List[Centre] = []
    for name in truth.names:
        labels = [c for c in truth.centres if c.name == name]
        if truth.teach:
            picked = [c for c in labels if c.frame in truth.teach]
        else:
            picked = _typical(labels, truth.size_px)
        if not picked:
            raise InputError(
                f"{truth.folder}: teach names frames {list(truth.teach)}, in none of which "
                f"{name!r} is labelled"
            )
        chosen += picked
    return chosen


def _typical(labels: Sequence[Centre], size_px: Tuple[int, int]) -> List[Centre]:
    def is_whole(c: Centre) -> bool:
        r = _disc_px(c) / DISC_SHARE
        return r <= c.x_px <= size_px[0] - r and r <= c.y_px <= size_px[1] - r

    whole = [c for c in labels if is_whole(c)] or list(labels)
    usual = median(c.area_px2 for c in whole)
    return sorted(whole, key=lambda c: (abs(c.area_px2 - usual), c.frame))[:N_TEACHERS]


def _disc_px(centre: Centre) -> float:
    return DISC_SHARE * float(np.sqrt(centre.area_px2 / np.pi))


def play(truth: ClipTruth, table: ColourTable, config: PerceptionConfig) -> ClipRun:
    """Run perception over a clip."""
    seen: List[Seen] = []
    taken_s: List[float] = []
    with listening() as notes:
        stage = Perception(config, table)
        for frame in frames_of(truth):
            started = time.thread_time()
            _, tracks = stage.step(frame)
            taken_s.append(time.thread_time() - started)
            seen.append(_seen(tracks))
    return ClipRun(tuple(seen), tuple(notes), 1000.0 * median(taken_s))


def _seen(tracks: Tracks) -> Seen:
    rows = np.flatnonzero(tracks.status == TrackStatus.SEEN)
    return Seen(
        tracks.t_s,
        tuple(tracks.name[row] for row in rows),
        tracks.track_id[rows],
        tracks.centre_px[rows],
    )


def score(truth: ClipTruth, run: ClipRun) -> ClipScore:
    """Compare what was seen with what was labelled."""
    gaps: List[float] = []
    n_within, n_switches = 0, 0
    last_id: Dict[Tuple[str, str], int] = {}
    for frame in sorted({centre.frame for centre in truth.centres}):
        labels = [centre for centre in truth.centres if centre.frame == frame]
        for label, (gap, track_id) in zip(labels, _assign(labels, run.seen[frame])):
            gaps.append(gap)
            if gap > label.tolerance_px:
                continue
            n_within += 1
            key = (label.name, label.identity)
            n_switches += last_id.get(key, track_id) != track_id
            last_id[key] = track_id
    absences = [(frame, name) for frame, names in truth.absent for name in names]
    return ClipScore(
        gaps_px=tuple(gaps),
        n_within=n_within,
        n_reports=sum(run.seen[frame].name.count(name) for frame, name in absences),
        n_absences=len(absences),
        n_switches=n_switches if _can_tell_identity(truth) else None,
        speed_off=tuple(_speed_off(straight, truth, run) for straight in truth.straight_runs),
    )


def _assign(labels: Sequence[Centre], seen: Seen) -> List[Tuple[float, int]]:
    """Give every label a track of its name, nearest pairs first, none twice."""
    pairs = sorted(
        (float(np.hypot(x - label.x_px, y - label.y_px)), i, j)
        for i, label in enumerate(labels)
        for j, (x, y) in enumerate(seen.centre_px)
        if seen.name[j] == label.name
    )
    found: Dict[int, Tuple[float, int]] = {}
    taken = set()
    for gap, i, j in pairs:
        if i not in found and j not in taken:
            found[i] = (gap, int(seen.track_id[j]))
            taken.add(j)
    return [found.get(i, (float("inf"), -1)) for i in range(len(labels))]


def _can_tell_identity(truth: ClipTruth) -> bool:
    """Say whether no two labels of one frame share both name and object."""
    keys = [(c.frame, c.name, c.identity) for c in truth.centres]
    return len(set(keys)) == len(keys)


def _speed_off(straight: StraightRun, truth: ClipTruth, run: ClipRun) -> float:
    """Return how far the tracker's velocity at the end of a run is off, over its tolerance."""
    at_end = run.seen[straight.last]
    track_id = _whose(straight, truth, run)
    for row in np.flatnonzero(at_end.track_id == track_id):
        for taken in run.notes:
            if taken.t_s == at_end.t_s and np.array_equal(taken.x, at_end.centre_px[row]):
                off = taken.after.v - [straight.vx_px_s, straight.vy_px_s]
                return float(np.hypot(off[0], off[1])) / max(straight.tolerance_px_s, 1e-9)
    return float("inf")


def _whose(straight: StraightRun, truth: ClipTruth, run: ClipRun) -> int:
    """Return the track that follows the object of a straight run; -1 when none does.

    By the run's own labels where there are some; else the only track of that name that is there.
    """
    votes: List[int] = []
    for label in truth.centres:
        is_its = label.name == straight.name and label.identity == straight.identity
        if is_its and straight.first <= label.frame <= straight.last:
            gap, track_id = _assign([label], run.seen[label.frame])[0]
            if gap <= label.tolerance_px:
                votes.append(track_id)
    if not votes:
        at_end = run.seen[straight.last]
        votes = [int(i) for n, i in zip(at_end.name, at_end.track_id) if n == straight.name]
    return max(sorted(set(votes)), key=votes.count) if votes else -1


def lines_of(name: str, truth: ClipTruth, run: ClipRun) -> List[Line]:
    """Return the lines of one clip."""
    found = score(truth, run)
    n_labels = len(found.gaps_px)
    within = Line(
        "clips",
        f"{name}: labelled centres within tolerance",
        f"{found.n_within} of {n_labels} (worst {max(found.gaps_px):.1f} px)",
        f">= {MIN_WITHIN:.0%}",
        found.n_within >= MIN_WITHIN * n_labels,
        {"n_within": found.n_within, "n_labels": n_labels, "worst_px": max(found.gaps_px)},
    )
    lines = [within]
    if found.n_absences:
        what = f"{name}: reports in {found.n_absences} labelled absences"
        lines.append(at_most("clips", what, found.n_reports, 0.0, "{:.0f}"))
    if found.speed_off:
        share = float(np.mean(np.array(found.speed_off) <= 1.0))
        what = f"{name}: share of {len(found.speed_off)} velocities within tolerance"
        lines.append(at_least("clips", what, share, 1.0, "{:.2f}"))
    if found.n_switches is not None:
        lines.append(note("clips", f"{name}: identity switches", found.n_switches, "{:.0f}"))
    lines.append(note("clips", f"{name}: ms a frame (median)", run.frame_ms, "{:.2f}"))
    return lines


def measure(
    clips: Sequence[Tuple[str, ClipTruth]], config: PerceptionConfig, is_quiet: bool = False
) -> List[Line]:
    """Play and judge clips; one whose colours are refused is a line that fails."""
    lines: List[Line] = []
    with Progress("clips", len(clips), is_quiet) as progress:
        for name, truth in clips:
            try:
                lines += lines_of(name, truth, play(truth, colours_of(truth), config))
            except ColourError as error:
                lines.append(Line("clips", f"{name}: colours", str(error), "usable", False))
            progress.advance()
    return lines
