"""Unplug and replug: seen at once, usable again within a second, and nothing moves by itself."""

import contextlib
import math
import os
import threading
import time
from pathlib import Path
from typing import Dict, List, Tuple

import numpy as np

from apex_edge.verbs.progress import Progress
from firmware_bridge.errors import ArmError
from firmware_bridge.session import SessionState
from firmware_bridge.simulator.faulty import servos_of
from offline_train.benchmarks.firmware.live import LiveArm, Swinger, has_simulator, quiet
from offline_train.benchmarks.lines import Line, at_most

SUITE = "unplug"
_N = 200
_SETTLED_S = 0.4
_STILL_TICKS = 0.5
_RETRY_S = 0.005


def measure(scale: float, seed: int) -> List[Line]:
    """Pull the plug of a swinging arm at random moments; 200 times at scale 1, half a protocol."""
    protocols = [name for name in ("sts", "lx16a") if has_simulator(name)]
    n_cycles = max(1, math.ceil(_N * scale / len(protocols)))
    lines: List[Line] = []
    for protocol in protocols:
        found, leaked = cycles(protocol, n_cycles, seed)
        worst = {key: max(one[key] for one in found) for key in found[0]}
        what = f"{protocol}, worst of {n_cycles}"
        lines += [
            at_most(SUITE, f"{what}: detected after, s", worst["detected_s"], 0.1),
            at_most(SUITE, f"{what}: usable after the replug, s", worst["usable_s"], 1.0),
            at_most(SUITE, f"{what}: ticks moved before arming", worst["moved_ticks"], 0.5),
            at_most(SUITE, f"{what}: commands before arming", worst["n_commands"], 0.0),
            at_most(SUITE, f"{protocol}: descriptors leaked", leaked[0], 0.0),
            at_most(SUITE, f"{protocol}: threads leaked", leaked[1], 0.0),
        ]
    return lines


def cycles(protocol: str, n_cycles: int, seed: int) -> Tuple[List[Dict[str, float]], List[int]]:
    """Return what each cycle showed, and how many descriptors and threads were left over."""
    rng = np.random.RandomState(seed)
    found: List[Dict[str, float]] = []
    with quiet(), LiveArm(protocol, seed=seed) as live, Progress("cycles", n_cycles) as progress:
        live.arm_up()
        swinger = Swinger(live.session)
        before: List[int] = []
        for n in range(n_cycles + 1):
            one = cycle(live, swinger, float(rng.uniform(0.05, 0.4)))
            if n == 0:  # the first one opens what stays open
                before = [n_descriptors(), threading.active_count()]
            else:
                found.append(one)
                progress.advance()
        return found, [n_descriptors() - before[0], threading.active_count() - before[1]]


def cycle(live: LiveArm, swinger: Swinger, after_s: float) -> Dict[str, float]:
    """Swing, pull the plug from another thread, wait, plug in, reopen, wait, arm."""
    pulled: List[float] = []

    def pull() -> None:
        pulled.append(time.monotonic())
        live.board.unplug()

    timer = threading.Timer(after_s, pull)
    timer.start()
    detected_s = float("inf")
    end_s = time.monotonic() + 3.0
    while time.monotonic() < end_s:
        with contextlib.suppress(ArmError):
            swinger.turn()
        if live.session.state is SessionState.FAULT:
            detected_s = time.monotonic() - pulled[0]
            break
    timer.join()
    time.sleep(_SETTLED_S)  # the servos end the last set-point
    live.board.replug()
    live.link.port = live.board.port
    replugged_s = time.monotonic()
    while live.session.state is not SessionState.CONNECTED:
        try:
            live.session.reopen()
        except ArmError:
            time.sleep(_RETRY_S)
    servos = servos_of(live.firmware)
    stood = [servo.actual for servo in servos]
    targets = [servo.target for servo in servos]
    live.session.tick()
    usable_s = time.monotonic() - replugged_s
    for _ in range(3):
        live.session.tick()
        time.sleep(live.session.rhythm.tick_s)
    moved = max(abs(servo.actual - at) for servo, at in zip(servos, stood))
    n_commands = sum(servo.target != at for servo, at in zip(servos, targets))
    is_read = bool(live.session.read().is_valid.all())
    live.session.arm()
    return {
        "detected_s": detected_s,
        "usable_s": usable_s if is_read else float("inf"),
        "moved_ticks": moved if moved > _STILL_TICKS else 0.0,
        "n_commands": float(n_commands),
    }


def n_descriptors() -> int:
    """Return how many descriptors this process has open."""
    return len(list(Path(f"/proc/{os.getpid()}/fd").iterdir()))
