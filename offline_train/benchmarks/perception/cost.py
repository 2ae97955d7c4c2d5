"""What finding two coloured balls costs: against LAB ranges, and against the paper's pipeline.

The pictures are the twin's: two balls that roll over a textured table, with the sensor's grain.
Grain matters, because a table look-up is only as fast as the cache lines it hits: a smooth
drawing touches a few dozen words of the 64 Ki, a grainy picture some thousands, as a real one
does (the number is printed). All forms run on the same picture in turn, each one first equally
often, so that none finds the picture warm in the cache more often than another.

CPU time of one thread, one OpenCV thread, medians; ratios are what to compare. Source: ours.
"""

import itertools
import time
from dataclasses import replace
from statistics import median
from typing import Any, Callable, Dict, List, Mapping, NamedTuple, Sequence, Tuple

import cv2
import numpy as np

from apex_edge import geometry
from apex_edge.cameras.twin import TwinCamera, TwinConfig
from apex_edge.perception import ColourTable, Perception, PerceptionConfig, blobs
from apex_edge.perception.blobs import Box
from apex_edge.perception.lookup import words
from apex_edge.perception.tracking import Tracker
from apex_edge.twin.scene import Scenario, SceneObject
from apex_edge.twin.world import TwinWorld
from apex_edge.types import Array, Frame
from apex_edge.verbs.progress import Progress
from offline_train.benchmarks.lines import Line, at_most, note
from offline_train.benchmarks.perception import peer

FPS = 30.0
N_FRAMES = 24
N_WARM_UP = 8
N_REPEATS = 16
MAX_CLASSIFY_RATIO = 0.35
MAX_UPDATE_RATIO = 0.20
MAX_OFF_PX = 4.0
DISC_PX = 24.0
BALL_RADIUS_M = 0.03
"""Just large enough (about 53 px) for the paper's area limit, so that both do the same work."""

Clock = Callable[[], float]


class Shown(NamedTuple):
    """One frame with what is needed to look into it: windows, and where the balls really are."""

    frame: Frame
    windows: List[Box]
    true_px: Dict[str, Array]


Form = Callable[[Shown], object]


def two_colours() -> ColourTable:
    """Return the twin's red and green."""
    models = ColourTable.builtin().models
    return ColourTable([model for model in models if model.name in ("red", "green")])


def scene() -> Scenario:
    """Return two balls of two colours rolling side by side."""
    balls = (
        SceneObject("red", "red", "ball", BALL_RADIUS_M, (0.30, -0.12), (-0.06, 0.08)),
        SceneObject("green", "green", "ball", BALL_RADIUS_M, (0.22, 0.12), (0.05, -0.06)),
    )
    return Scenario("two-balls", 1, balls, (), 4.0, "", "", False)


def shown_frames(table: ColourTable, config: PerceptionConfig, has_depth: bool) -> List[Shown]:
    """Render the scene and let a tracker predict the windows of each frame."""
    camera = TwinCamera(TwinConfig(delay_s=0.0, drop_rate=0.0, repeat_rate=0.0), TwinWorld(scene()))
    stage, tracker = Perception(config, table), Tracker(config)
    result: List[Shown] = []
    for number in range(N_WARM_UP + N_FRAMES):
        frame = camera.advance()
        assert frame is not None  # the scene is longer than that
        objects = camera.world.objects
        pixels, _ = geometry.project(camera.camera, objects.pos_m)
        if not has_depth:
            frame = replace(frame, depth_mm=None, camera=None)
        windows = tracker.outlook(frame.t_s, frame.camera, frame.colour_bgr.shape).box
        tracker.update(stage.step(frame)[0], frame.camera)
        if number >= N_WARM_UP:
            true_px = dict(zip(objects.colour, pixels))
            result.append(Shown(frame, blobs.union(windows), true_px))
    return result + result[-2:0:-1]  # and back again, so that nothing ever jumps


def interleaved(
    forms: Mapping[str, Form],
    shown: Sequence[Shown],
    n_repeats: int,
    clock: Clock,
    on_round: Callable[[], None],
) -> Dict[str, List[float]]:
    """Return the times (ms) of each form, all taken on the same pictures in turn."""
    names = list(forms)
    taken: Dict[str, List[float]] = {name: [] for name in names}
    for turn in range(n_repeats):
        for number, one in enumerate(shown):
            first = (turn + number) % len(names)
            for name in names[first:] + names[:first]:
                form = forms[name]
                started = clock()
                form(one)
                taken[name].append(1000.0 * (clock() - started))
        on_round()
    return taken


def measure(
    n_repeats: int = N_REPEATS, clock: Clock = time.thread_time, is_quiet: bool = False
) -> List[Line]:
    """Time all forms side by side and return their lines."""
    config, table = PerceptionConfig(), two_colours()
    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with Progress("rounds", 4 * n_repeats, is_quiet) as progress:
            flat = shown_frames(table, config, has_depth=False)
            deep = shown_frames(table, config, has_depth=True)
            taken: Dict[str, List[float]] = {}
            for forms, shown in _groups(flat, deep, table, config):
                taken.update(interleaved(forms, shown, n_repeats, clock, progress.advance))
    finally:
        cv2.setNumThreads(n_threads)
    return _lines(taken, flat)


def _groups(
    flat: Sequence[Shown], deep: Sequence[Shown], table: ColourTable, config: PerceptionConfig
) -> List[Tuple[Dict[str, Form], Sequence[Shown]]]:
    """Return what is timed side by side, and on which pictures."""
    ranges = _ranges(flat[0])
    classify: Dict[str, Form] = {
        "table": lambda one: table.classify(one.frame.colour_bgr),
        "LAB": lambda one: peer.classify_lab(one.frame.colour_bgr, ranges),
    }
    update: Dict[str, Form] = {
        "paper": lambda one: peer.paper_centres(one.frame.colour_bgr, ranges),
        "windows": lambda one: blobs.find(one.frame.colour_bgr, table, one.windows, config),
    }
    return [
        (classify, flat),
        (update, flat),
        ({"step": _stepper(table, config)}, flat),
        ({"step with depth": _stepper(table, config)}, deep),
    ]


def _stepper(table: ColourTable, config: PerceptionConfig) -> Form:
    """Return a whole perception stage that plays the pictures round and round, time going on."""
    stage = Perception(config, table)
    number = itertools.count()
    return lambda one: stage.step(replace(one.frame, t_s=next(number) / FPS))


def _ranges(one: Shown) -> Dict[str, peer.Range]:
    """Return LAB ranges fitted to the balls' own pixels."""
    bgr = one.frame.colour_bgr
    rows, columns = np.ogrid[: bgr.shape[0], : bgr.shape[1]]
    return {
        name: peer.lab_range(bgr, np.hypot(columns - x, rows - y) <= DISC_PX)
        for name, (x, y) in one.true_px.items()
    }


def _lines(taken: Mapping[str, List[float]], shown: Sequence[Shown]) -> List[Line]:
    ms = {name: median(values) for name, values in taken.items()}
    mean_ms = {name: sum(values) / len(values) for name, values in taken.items()}
    table, config = two_colours(), PerceptionConfig()
    n_words = median([len(np.unique(words(one.frame.colour_bgr))) for one in shown])
    share = median([_share(one) for one in shown])
    ours = [_worst_px(one, _centres(one, table, config)) for one in shown]
    theirs = [
        _worst_px(one, peer.paper_centres(one.frame.colour_bgr, _ranges(shown[0]))) for one in shown
    ]
    return [
        at_most(
            "cost",
            "two colours, full 640x480, x LAB + 2 ranges",
            ms["table"] / ms["LAB"],
            MAX_CLASSIFY_RATIO,
        ),
        note("cost", "  ours, ms", ms["table"]),
        note("cost", "  LAB + 2 ranges, ms", ms["LAB"]),
        note("cost", "  colour words in a picture", n_words, "{:.0f}"),
        at_most(
            "cost",
            "two objects in their windows, x paper's pipeline",
            ms["windows"] / ms["paper"],
            MAX_UPDATE_RATIO,
        ),
        note("cost", "  ours, ms", ms["windows"]),
        note("cost", "  paper's pipeline, ms", ms["paper"]),
        note("cost", "  windows' share of the picture", share),
        at_most("cost", "  ours off the true centres by at most, px", max(ours), MAX_OFF_PX),
        note("cost", "  paper's pipeline off by at most, px", max(theirs)),
        note("cost", "whole step in pixels, ms", ms["step"]),
        note("cost", "  mean, with the full searches", mean_ms["step"]),
        note("cost", "whole step with depth, ms", ms["step with depth"]),
        note("cost", "  mean, with the full searches", mean_ms["step with depth"]),
    ]


def _share(one: Shown) -> float:
    height, width = one.frame.colour_bgr.shape[:2]
    return sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in one.windows) / float(width * height)


def _centres(one: Shown, table: ColourTable, config: PerceptionConfig) -> Dict[str, Any]:
    found = blobs.find(one.frame.colour_bgr, table, one.windows, config)
    return {table.names[blob.label - 1]: blob.centre_px for blob in found}


def _worst_px(one: Shown, centres: Mapping[str, Any]) -> float:
    """Return how far the worse of the two centres is off; inf when one was not found."""
    off = [
        np.inf if centres.get(name) is None else float(np.hypot(*(xy - centres[name])))
        for name, xy in one.true_px.items()
    ]
    return max(off)
