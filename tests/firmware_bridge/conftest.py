"""Fixtures: the arm, and a complete simulated one in simulated time over a real pty."""

import time
from typing import Callable, Optional

import pytest

from apex_edge.types import Array
from firmware_bridge.errors import LinkLost
from firmware_bridge.guard import Limits
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator.pty_board import PtyBoard
from firmware_bridge.simulator.rrc_arm import RrcFirmware

_STEP_S = 0.01
_PATIENCE_S = 2.0  # wall time for bytes to cross the pty; it takes about 0.1 ms


class PumpedLink(SerialLink):
    """A serial link on which simulated time passes while the host waits for an answer."""

    def __init__(self, board: PtyBoard, let_pass: Callable[[float], None]) -> None:
        super().__init__(board.port)
        self._let_pass = let_pass

    def wait_readable(self, timeout_s: float) -> None:
        self._let_pass(timeout_s)
        super().wait_readable(0.0)


class Bench:
    """Wire an ``ArmSession`` to a ``PtyBoard`` over real bytes, on one simulated clock.

    ``t_s`` moves by ``advance`` alone, so a run gives the same result every time. ``tick_s`` is how
    often the session is ticked meanwhile.
    """

    def __init__(
        self,
        arm: ArmModel,
        at_rad: Optional[Array] = None,
        limits: Optional[Limits] = None,
        tick_s: float = 0.03,
    ) -> None:
        self.t_s = 0.0
        self.tick_s = tick_s
        self.firmware = RrcFirmware(arm, at_rad)
        self.board = PtyBoard(self.firmware)
        self.link = PumpedLink(self.board, self.let_pass)
        self.session = ArmSession(arm, self.link, lambda: self.t_s, limits)
        self._next_tick_s = 0.0

    def start(self) -> None:
        """Open and arm the session; returns when it is ARMED.

        Raises
        ------
        LinkLost : the session did not get there in ten simulated seconds.
        """
        self.session.open()
        self.session.arm()
        while self.session.state is not SessionState.ARMED:
            self.advance(self.tick_s)
            if self.t_s > 10.0:
                raise LinkLost(f"{self.link.port}: the simulated arm did not get ready")

    def advance(self, dt_s: float, is_host_alive: bool = True) -> None:
        """Let simulated time pass; a dead host sends nothing while the board goes on."""
        end_s = self.t_s + dt_s
        while self.t_s < end_s - 1e-9:
            if is_host_alive and self.t_s >= self._next_tick_s - 1e-9:
                self._next_tick_s = self.t_s + self.tick_s
                self.session.tick()
            self.exchange()
            step_s = min(_STEP_S, end_s - self.t_s)
            self.firmware.step(step_s)
            self.t_s += step_s

    def let_pass(self, dt_s: float) -> None:
        """Let time pass for the board and on the clock; the host waits."""
        self.exchange()
        self.firmware.step(dt_s)
        self.t_s += dt_s

    def exchange(self) -> None:
        """Bring every byte the host has written to the firmware, and the replies back.

        Raises
        ------
        LinkLost : bytes written to an open board do not arrive.
        """
        give_up_s = time.monotonic() + _PATIENCE_S
        self.board.pump()
        while self.board.is_open and self.board.n_bytes_in < self.link.n_bytes_out:
            self.board.pump()
            if time.monotonic() > give_up_s:
                raise LinkLost(f"{self.link.port}: bytes are stuck in the pseudo-terminal")

    def close(self) -> None:
        """Close the session and unplug the board."""
        try:
            self.session.close()
        finally:
            self.board.close()

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@pytest.fixture(scope="session")
def arm():
    return ArmModel.load("armpi-mini")


@pytest.fixture
def bench(arm):
    with Bench(arm) as made:
        yield made


@pytest.fixture
def make_bench(arm):
    made = []

    def make(**options):
        made.append(Bench(arm, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()
