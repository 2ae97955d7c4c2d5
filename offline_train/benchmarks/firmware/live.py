"""A live arm for the proofs: a served board with faults, a session on it, a swing to and fro."""

import contextlib
import logging
import time
from contextlib import ExitStack
from typing import Any, Callable, Iterator, Mapping, Optional, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.make import Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving

ARMS: Mapping[str, str] = {"sts": "so-101", "lx16a": "lx16a-arm", "rrc": "armpi-mini"}
SWING_RAD = 0.4
SWING_S = 0.6


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Keep the session's warnings off the terminal: here faults and refusals are the purpose."""
    logger = logging.getLogger("firmware_bridge")
    before = logger.level
    logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        logger.setLevel(before)


def has_simulator(protocol: str) -> bool:
    """Say whether this protocol's board can be simulated by name."""
    try:
        Setup(protocol, ARMS[protocol]).firmware()
    except ImportError:
        return False
    return True


def swing(arm: ArmModel, n: int) -> Tuple[Array, Array]:
    """Return the way-point (1, k) and duration (1,) of the n-th swing of yaw about home."""
    goal = arm.home_rad.copy()
    goal[0] += SWING_RAD if n % 2 else -SWING_RAD
    return goal[None], np.array([SWING_S])


class Swinger:
    """Keep an armed session swinging; ``turn`` is one tick in real time."""

    def __init__(self, session: ArmSession) -> None:
        self.session = session
        self.n_swings = 0

    def turn(self) -> None:
        """Start the next swing when the last is over, tick, and wait for the next tick."""
        began_s = time.monotonic()
        session = self.session
        if session.state is SessionState.ARMED:
            self.n_swings += session.move(*swing(session.model, self.n_swings)).is_accepted
        session.tick()
        time.sleep(max(session.rhythm.tick_s - (time.monotonic() - began_s), 0.0))

    def until(self, is_done: Callable[[], bool], timeout_s: float) -> bool:
        """Go on until something is so; returns whether it came to that."""
        end_s = time.monotonic() + timeout_s
        while not is_done():
            if time.monotonic() > end_s:
                return False
            self.turn()
        return True


class LiveArm:
    """A board in a thread and a session on its pty; a context manager."""

    def __init__(
        self, protocol: str, faults: Optional[Mapping[str, Any]] = None, seed: int = 0
    ) -> None:
        setup = Setup(protocol, ARMS[protocol], seed=seed, faults=faults)
        self.arm = ArmModel.load(ARMS[protocol])
        self.firmware: Firmware = setup.firmware()
        self.board = PtyBoard(self.firmware, options=setup.wire())
        self.link = SerialLink(self.board.port, self.firmware.baud)
        self.session = ArmSession(self.arm, self.link, time.monotonic)
        self._stack = ExitStack()

    def __enter__(self) -> "LiveArm":
        self._stack.enter_context(serving(self.board))
        self._stack.callback(self.session.close)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def arm_up(self) -> None:
        """Open and arm at home, where the servos stand."""
        self.session.open()
        self.session.arm(None if self.session.servos.has_feedback else self.arm.home_rad)
