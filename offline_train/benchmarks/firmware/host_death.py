"""The host dies or hangs while the arm moves: the arm must stand within 200 ms, every time.

Three processes: the simulated board, the host with its session, and this one, which sends the
signals. The host's supervisor is a fourth. When the arm stood still is read from the board's record
of its shafts, on the clock that all share.
"""

import contextlib
import math
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Deque, Dict, Iterator, List, Tuple

import numpy as np

from apex_edge.verbs.progress import Progress
from firmware_bridge.deadman import Deadman
from firmware_bridge.errors import ArmError
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator.faulty import servos_of
from firmware_bridge.simulator.make import Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving
from offline_train.benchmarks.firmware.live import ARMS, Swinger, has_simulator
from offline_train.benchmarks.lines import Line, at_most

SUITE = "host death"
GOAL_S = 0.2
_N = 200
_WATCHED_S = 0.6
_SAMPLE_S = 0.001
_JUST_S = 0.04
_N_TRIES = 8
_STANDS_RAD = 0.005
_START_S = 20.0
Record = Deque[Tuple[float, Tuple[float, ...]]]


def measure(scale: float, seed: int) -> List[Line]:
    """Kill and suspend the host of a swinging arm at random moments.

    200 times each at scale 1, over three protocols in turn.
    """
    protocols = [name for name in ("sts", "lx16a", "rrc") if has_simulator(name)]
    n_times = max(1, math.ceil(_N * scale / len(protocols)))
    lines: List[Line] = []
    for protocol in protocols:
        for kind in (signal.SIGKILL, signal.SIGSTOP):
            rng = np.random.RandomState(seed)
            with served(protocol) as (port, board), Progress("deaths", n_times) as progress:
                found = []
                for _ in range(n_times):
                    found.append(die(protocol, port, board, kind, rng))
                    progress.advance()
            what = f"{protocol} {kind.name}, worst of {n_times}"
            lines += [
                at_most(SUITE, f"{what}: arm stands after, s", _worst(found, "stood_s"), GOAL_S),
                at_most(SUITE, f"{what}: supervisors left over", _worst(found, "n_left"), 0.0),
            ]
    return lines


def die(
    protocol: str, port: str, board: Connection, kind: signal.Signals, rng: np.random.RandomState
) -> Dict[str, float]:
    """Start a host, send it a signal while it moves its arm; returns when the arm stood.

    A moment at which the arm happened to stand counts for nothing: it is done again.
    """
    for _ in range(_N_TRIES):
        found = _die_once(protocol, port, board, kind, rng)
        if found["was_moving"]:
            return found
    return {"stood_s": float("inf"), "n_left": 0.0, "was_moving": 0.0}


def _die_once(
    protocol: str, port: str, board: Connection, kind: signal.Signals, rng: np.random.RandomState
) -> Dict[str, float]:
    context = _context()
    ours, theirs = context.Pipe()
    host = context.Process(target=host_main, args=(protocol, port, theirs), daemon=True)
    host.start()
    theirs.close()
    try:
        if not ours.poll(_START_S):
            return {"stood_s": float("inf"), "n_left": 0.0, "was_moving": 0.0}
        supervisor = int(ours.recv())
        time.sleep(float(rng.uniform(0.1, 0.7)))
        sent_s = time.monotonic()
        os.kill(int(host.pid or 0), kind)
        time.sleep(_WATCHED_S)
        board.send(sent_s)
        stood_at_s, was_moving = board.recv()
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(int(host.pid or 0), signal.SIGKILL)
        host.join()
        ours.close()
    n_left = float(_is_alive(supervisor))
    return {"stood_s": stood_at_s - sent_s, "n_left": n_left, "was_moving": float(was_moving)}


def host_main(protocol: str, port: str, told: Connection) -> None:
    """Swing an arm until this process dies."""
    arm = ArmModel.load(ARMS[protocol])
    deadman = Deadman()
    session = ArmSession(
        arm, SerialLink(port, Setup(protocol).firmware().baud), time.monotonic, deadman=deadman
    )
    session.open()
    session.arm(None if session.servos.has_feedback else arm.home_rad)
    swinger = Swinger(session)
    swinger.until(lambda: swinger.n_swings > 1, 3.0)  # the first may be no way at all
    told.send(deadman.pid)
    with contextlib.suppress(ArmError):
        swinger.until(lambda: session.state is SessionState.FAULT, 60.0)


def board_main(protocol: str, asked: Connection) -> None:
    """Serve a board; answer each question "when did it stand, after this moment" with a time."""
    setup = Setup(protocol, ARMS[protocol])
    firmware = setup.firmware()
    arm = ArmModel.load(ARMS[protocol])
    still_ticks = _STANDS_RAD * float(np.abs(arm.ticks_per_rad).min())
    record: Record = deque(maxlen=3000)
    is_over = threading.Event()

    def sample() -> None:
        while not is_over.is_set():
            place = tuple(servo.actual for servo in servos_of(firmware))
            record.append((time.monotonic(), place))
            time.sleep(_SAMPLE_S)

    with serving(PtyBoard(firmware, options=setup.wire())) as board:
        sampler = threading.Thread(target=sample)
        sampler.start()
        try:
            asked.send(board.port)
            while True:
                after_s = float(asked.recv())
                asked.send(_stood(list(record), after_s, still_ticks))
        except EOFError:
            pass
        finally:
            is_over.set()
            sampler.join()


@contextlib.contextmanager
def served(protocol: str) -> Iterator[Tuple[str, Connection]]:
    """Run a board in a process of its own; yields its port and whom to ask."""
    context = _context()
    ours, theirs = context.Pipe()
    process = context.Process(target=board_main, args=(protocol, theirs), daemon=True)
    process.start()
    theirs.close()
    try:
        yield str(ours.recv()), ours
    finally:
        ours.close()
        process.join(5.0)
        if process.is_alive():
            process.kill()
            process.join()


def _stood(
    record: List[Tuple[float, Tuple[float, ...]]], after_s: float, still: float
) -> Tuple[float, bool]:
    """Return from when on every shaft stayed where it ended up, and whether one moved before."""
    before = [place for t_s, place in record if after_s - _JUST_S <= t_s <= after_s]
    was_moving = bool(before) and bool(np.ptp(np.array(before), axis=0).max() > still)
    end = np.array(record[-1][1])
    stood_s = after_s
    for t_s, place in record:
        if t_s >= after_s and np.abs(np.array(place) - end).max() > still:
            stood_s = t_s
    return stood_s, was_moving


def _worst(found: List[Dict[str, float]], key: str) -> float:
    return max(one[key] for one in found)


def _is_alive(pid: int) -> bool:
    """Say whether a process still runs; it has a moment to end, and init may be slow to reap."""
    end_s = time.monotonic() + 1.0
    while time.monotonic() < end_s:
        try:
            status = Path(f"/proc/{pid}/stat").read_text(encoding="ascii")
        except OSError:
            return False
        if status.rpartition(")")[2].split()[0] == "Z":
            return False
        time.sleep(0.01)
    return True


def _context() -> Any:
    """Return a way to start processes that is quick: they are forked off one with all imports."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    return context
