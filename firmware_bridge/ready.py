"""An arm that is open, at home and ready, from a port to the last stop; and slow moves with it."""

import time
from dataclasses import dataclass
from typing import Callable

import numpy as np

from apex_edge.config import setting
from apex_edge.errors import ArmError
from apex_edge.types import Array
from firmware_bridge.errors import MotionRefused
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.session import ArmSession, SessionState

ARMING_S = 6.0
TICK_S = 0.02
_SETTLE_S = 0.3  # on top of the arm's lag: a light arm swings on after a stop
_OVERTIME_S = 5.0


@dataclass(frozen=True)
class ArmConfig:
    """Section ``[arm]``: which arm, on which port."""

    type: str = setting("armpi-mini", "arm data file shipped with the bridge, or a path to one")
    port: str = setting("", "serial port or URL, empty: watch only; a twin brings its own arm")


class ReadyArm:
    """Open an arm and bring it home; leave it stopped. A context manager.

    ``sleep`` lets time pass between two ticks of the session.

    Raises
    ------
    ArmError : the port cannot be opened, or the arm does not get ready.
    """

    def __init__(
        self,
        arm: ArmModel,
        port: str,
        clock: Callable[[], float],
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._clock, self._sleep = clock, sleep
        self.session = ArmSession(arm, SerialLink(port), clock)

    def __enter__(self) -> "ReadyArm":
        """Open, arm, and wait until the arm is home."""
        self.session.open()
        try:
            self.session.arm()
            self._wait(ARMING_S, "get ready")
        except BaseException:
            self.session.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the arm and let go of the port."""
        self.session.close()

    def go(self, goal_rad: Array, rate_share: float) -> None:
        """Move straight to joints (k,) at a share of the arm's rates, and wait until it stands.

        Raises
        ------
        MotionRefused : the guard refuses the way; nothing moved. ArmError : it did not arrive.
        """
        model = self.session.model
        start = self.session.read().joints_rad
        goal = np.asarray(goal_rad, dtype=np.float64)
        duration_s = np.maximum(model.travel_time_s(start, goal[None]) / rate_share, 0.2)
        report = self.session.move(goal[None], duration_s)
        if not report.is_accepted:
            raise MotionRefused(report.reason)
        self._wait(float(report.duration_s.sum()) + _OVERTIME_S, "arrive")
        self._rest(model.lag_s + _SETTLE_S)

    def _rest(self, seconds: float) -> None:
        end_s = self._clock() + seconds
        while self._clock() < end_s:
            self._sleep(TICK_S)
            self.session.tick()

    def _wait(self, seconds: float, what: str) -> None:
        give_up_s = self._clock() + seconds
        while self.session.state is not SessionState.ARMED:
            self._sleep(TICK_S)
            self.session.tick()
            is_stuck = self.session.state not in (SessionState.MOVING, SessionState.ARMED)
            if is_stuck or self._clock() > give_up_s:
                raise ArmError(
                    f"the arm did not {what} in {seconds:.1f} s: {self.session.state.value} "
                    f"{self.session.reason}"
                )
