"""Malformed frames, straight into the perception stage: shapes, noise, depth, clocks."""

import math
from dataclasses import replace
from typing import Any, Callable, Dict, List, Optional, Sequence, Set

import numpy as np

from apex_edge.errors import InputError
from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.types import Array, Frame, TrackStatus
from offline_train.benchmarks.perception import damage, judge

REFUSED, NOTHING, LOST, TRUE = "typed error", "nothing seen", "lost", "true object seen"
N_FRAMES = 6
PERIOD_S = 1.0 / 30.0
CONFIG = PerceptionConfig()

Case = Callable[[np.random.RandomState], str]


def watch(frames: Sequence[Frame], may_see: bool = True) -> str:
    """Run frames through a stage of its own and judge every step; say what came of it.

    A frame that is refused must not spoil the next one.

    Raises
    ------
    judge.MadeUp : something was claimed that is not so.
    """
    stage = Perception(CONFIG, ColourTable.builtin())
    n_refused = n_seen = n_lost = 0
    for frame in frames:
        try:
            detections, tracks = stage.step(frame)
        except InputError:
            n_refused += 1
            continue
        n_now = judge.check(frame, detections, tracks, CONFIG)
        if n_now and not may_see:
            raise judge.MadeUp(f"{n_now} objects seen in a picture without any: {tracks.name}")
        n_seen += n_now
        n_lost += int(np.count_nonzero(tracks.status != TrackStatus.SEEN))
    if n_refused:
        return REFUSED
    if n_seen:
        return TRUE
    return LOST if n_lost else NOTHING


def _film(
    pictures: Sequence[Array], has_camera: bool = False, depth: Optional[Sequence[Any]] = None
) -> List[Frame]:
    """Return frames, one period apart."""
    camera = damage.camera() if has_camera else None
    return [
        Frame(i, i * PERIOD_S, picture, None if depth is None else depth[i], camera)
        for i, picture in enumerate(pictures)
    ]


def shapes(rng: np.random.RandomState) -> str:
    """Let one frame have a wrong shape, type or layout."""
    pictures: List[Any] = list(damage.balls(rng, N_FRAMES))
    at = int(rng.randint(0, N_FRAMES))
    good = pictures[at]
    height, width = int(rng.randint(0, 5)), int(rng.randint(0, 400))
    odd = [
        None,
        good[..., 0],
        np.dstack([good, good[..., :1]]),
        good.astype(np.float32) / 255.0,
        good.astype(np.uint16),
        good.astype(np.int8),
        good[:0],
        good[:, :0],
        np.zeros((height, width, 3), np.uint8),
        np.zeros((width, height, 3), np.uint8),
        good[:, ::-1],
        good[::-1],
        good[::2, ::3],
        np.asfortranarray(good),
        good.tolist(),
        good.tobytes(),
        good[None],
        good.astype(object),
        np.broadcast_to(good[:1, :1], good.shape),
    ]
    pictures[at] = odd[int(rng.randint(0, len(odd)))]
    return watch(_film(pictures, has_camera=bool(rng.randint(0, 2))))


def sizes(rng: np.random.RandomState) -> str:
    """Let the picture's size change in mid stream, the camera model staying what it was."""
    at = int(rng.randint(1, N_FRAMES))
    size = int(rng.randint(3, 400)), int(rng.randint(3, 300))
    pictures = damage.balls(rng, at) + damage.balls(rng, N_FRAMES - at, size)
    return watch(_film(pictures, has_camera=bool(rng.randint(0, 2))))


def blank(rng: np.random.RandomState) -> str:
    """Show black, white or grey, from the start or after the balls."""
    n_before = int(rng.randint(0, 2)) * 3
    before = damage.balls(rng, n_before)
    has_camera = bool(rng.randint(0, 2))
    frames = _film([*before, *(damage.blank(rng) for _ in range(12))], has_camera)
    if not n_before:
        return watch(frames, may_see=False)
    return watch(frames)


def noise(rng: np.random.RandomState) -> str:
    """Show pictures that hold nothing but noise."""
    pictures = [damage.noise(rng) for _ in range(N_FRAMES)]
    return watch(_film(pictures, has_camera=bool(rng.randint(0, 2))), may_see=False)


def torn(rng: np.random.RandomState) -> str:
    """Tear some of the pictures."""
    pictures = [
        damage.torn(rng, picture) if rng.uniform() < 0.5 else picture
        for picture in damage.balls(rng, N_FRAMES)
    ]
    return watch(_film(pictures, has_camera=bool(rng.randint(0, 2))))


def depth_forms(rng: np.random.RandomState) -> str:
    """Hand in depth of another shape, type or kind, NaN among them."""
    pictures = damage.balls(rng, N_FRAMES)
    good = damage.depth_of(pictures[0])
    odd: List[Any] = [
        np.full(good.shape, np.nan),
        np.full(good.shape, np.nan, dtype=np.float32),
        good.astype(np.float64) / 1000.0,
        good.astype(np.int32),
        good.astype(np.int16),
        good[:-1],
        good[:, :-1],
        good.T,
        good[..., None],
        good[:0],
        np.uint16(650),
        good.tolist(),
        "depth",
        good.astype(">u2"),
        good[:, ::-1],
    ]
    depth = [good if rng.uniform() < 0.3 else odd[int(rng.randint(0, len(odd)))] for _ in pictures]
    return watch(_film(pictures, has_camera=True, depth=depth))


def depth_values(rng: np.random.RandomState) -> str:
    """Hand in depth that is all holes, all saturated, patchy, or random."""
    pictures = damage.balls(rng, N_FRAMES)
    good = damage.depth_of(pictures[0], int(rng.randint(1, 65535)))
    holes = good * (rng.uniform(size=good.shape) < rng.uniform(0.0, 0.5)).astype(np.uint16)
    kinds = [
        np.zeros_like(good),
        np.full_like(good, 65535),
        good,
        holes,
        np.where(holes > 0, np.uint16(65535), np.uint16(0)),
        rng.randint(0, 65536, good.shape).astype(np.uint16),
    ]
    depth = [kinds[int(rng.randint(0, len(kinds)))] for _ in pictures]
    return watch(_film(pictures, has_camera=True, depth=depth))


def clocks(rng: np.random.RandomState) -> str:
    """Let the clock stand, run backwards, leap, or not be a number."""
    n_frames = 10
    frames = _film(damage.balls(rng, n_frames), has_camera=bool(rng.randint(0, 2)))
    times = [frame.t_s for frame in frames]
    for _ in range(int(rng.randint(1, 4))):
        at = int(rng.randint(0, n_frames))
        times[at] = _odd_time(rng, times, at)
    frames = [replace(f, t_s=t, is_repeated=rng.uniform() < 0.1) for f, t in zip(frames, times)]
    _check_clock(frames)
    return watch(frames)


def _odd_time(rng: np.random.RandomState, times: Sequence[float], at: int) -> float:
    odd = (
        math.nan, math.inf, -math.inf, times[at - 1], times[at] - 1.0, times[at] - 1e-12, -1e300,
        1e300, 1e17, times[at] + 3600.0, times[at - 1] + 1e-12, 5e-324, -0.0, 1.7e308,
    )  # fmt: skip
    return odd[int(rng.randint(0, len(odd)))]


def _check_clock(frames: Sequence[Frame]) -> None:
    """Check what a clock that is not a number or runs backwards must lead to."""
    stage = Perception(CONFIG, ColourTable.builtin())
    known: Set[int] = set()
    last_s = -math.inf
    for frame in frames:
        try:
            _, tracks = stage.step(frame)
        except InputError:
            if math.isfinite(frame.t_s):
                raise judge.MadeUp(f"capture time {frame.t_s!r} was refused") from None
            continue
        if not math.isfinite(frame.t_s):
            raise judge.MadeUp(f"capture time {frame.t_s!r} was taken")
        alive = tracks.track_id[tracks.status != TrackStatus.LOST].tolist()
        if frame.t_s < last_s and known & set(alive):
            raise judge.MadeUp("a track outlived a clock that ran backwards")
        known = known | set(alive)
        last_s = frame.t_s


FRAME_CASES: Dict[str, Case] = {
    "frame: shape or type": shapes,
    "frame: size changes": sizes,
    "frame: black, white, grey": blank,
    "frame: noise": noise,
    "frame: torn": torn,
    "depth: shape or type": depth_forms,
    "depth: values": depth_values,
    "clock": clocks,
}
