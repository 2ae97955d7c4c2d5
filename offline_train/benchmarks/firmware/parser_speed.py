"""Frames per second of the parser, beside a byte machine like the vendors'."""

import random
import time
from typing import Callable, List

from offline_train.benchmarks.firmware.byte_machine import FRAMINGS, ByteMachine
from offline_train.benchmarks.firmware.kit import framed_kits
from offline_train.benchmarks.lines import Line, at_least, note

SUITE = "firmware parser speed"
GOAL_FRAMES_S = 200_000.0
_N_FRAMES = 20_000
_N_RUNS = 5


def measure(scale: float, seed: int) -> List[Line]:
    """Time parsers on undamaged streams in CPU time, the best of five runs.

    Parameters
    ----------
    scale : share of 20,000 frames, at least a tenth.
    seed : of all chance.
    """
    n_frames = int(_N_FRAMES * min(max(scale, 0.1), 1.0))
    lines: List[Line] = []
    for kit in framed_kits():
        rng = random.Random(f"{seed} {kit.name}")
        stream = b"".join(kit.random_reply(rng) for _ in range(n_frames))
        parser = kit.host_parser()
        ours = _frames_s(parser.feed, stream)
        machine = ByteMachine(parser.header, FRAMINGS[kit.name], parser.check)
        theirs = _frames_s(machine.feed, stream)
        what = f"{kit.name}: answers parsed per second"
        lines.append(at_least(SUITE, what, ours, GOAL_FRAMES_S, "{:.0f}"))
        lines.append(note(SUITE, f"{kit.name}: by a byte machine", theirs, "{:.0f}"))
    return lines


def _frames_s(feed: Callable[[bytes], List[bytes]], stream: bytes) -> float:
    best = 0.0
    for _ in range(_N_RUNS):
        begin_s = time.process_time()
        n_got = len(feed(stream))
        best = max(best, n_got / (time.process_time() - begin_s))
    return best
