"""An arm that is open, at home and ready, from a port to the last stop; and slow moves with it."""

import time
from dataclasses import dataclass
from typing import Callable, Optional

import numpy as np

from apex_edge.config import setting
from apex_edge.errors import ArmError
from apex_edge.types import Array
from firmware_bridge.codec import protocol
from firmware_bridge.deadman import Deadman
from firmware_bridge.errors import MotionRefused
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.base import Link
from firmware_bridge.links.opening import open_link
from firmware_bridge.policy import Policy
from firmware_bridge.session import ArmSession, SessionState

ARMING_S = 6.0
HOME_SHARE = 0.15  # of the arm's rates
_SETTLE_S = 0.3  # on top of the arm's lag: a light arm swings on after a stop
_OVERTIME_S = 5.0


@dataclass(frozen=True)
class ArmConfig:
    """Section ``[arm]``: which arm, on which port."""

    type: str = setting("armpi-mini", "arm data file shipped with the bridge, or a path to one")
    port: str = setting("", "serial port or URL, empty: watch only; a twin brings its own arm")


class ReadyArm:
    """Open an arm and bring it home; leave it stopped. A context manager.

    Where the servos can be measured it starts from where they stand and goes home slowly, then
    closes the gripper. On a real clock a supervisor process stops the arm should this one die.

    Parameters
    ----------
    sleep : lets time pass between two ticks of the session.
    policy : what counts as a fault of a servo; the arm's own when None.
    is_supervised : None: when ``clock`` is the system's own.
    is_homing : go home when it is ready; False: stay where the servos stand, if they can tell.
    link : used instead of what ``port`` names.

    Raises
    ------
    ArmError : the port cannot be opened, or the arm does not get ready.
    """

    def __init__(  # noqa: PLR0913 - each has a default that fits
        self,
        arm: ArmModel,
        port: str,
        clock: Callable[[], float],
        sleep: Callable[[float], None] = time.sleep,
        policy: Optional[Policy] = None,
        is_supervised: Optional[bool] = None,
        is_homing: bool = True,
        link: Optional[Link] = None,
    ) -> None:
        self._clock, self._sleep = clock, sleep
        is_real = clock is time.monotonic if is_supervised is None else is_supervised
        self._is_homing = is_homing
        way = link_of(arm, port) if link is None else link
        self.session = ArmSession(arm, way, clock, None, policy, Deadman() if is_real else None)
        self.tick_s = self.session.rhythm.tick_s
        self._next_s = clock()

    def __enter__(self) -> "ReadyArm":
        """Open, arm, and wait until the arm is home."""
        self.session.open()
        try:
            self.session.arm()
            self._wait(ARMING_S, "get ready")
            if self._is_homing and self.session.servos.has_feedback:
                self.home()
        except BaseException:
            self.session.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the arm and let go of the port."""
        self.session.close()

    def home(self, rate_share: float = HOME_SHARE) -> None:
        """Go home slowly and close the gripper.

        Raises
        ------
        MotionRefused : the guard refuses the way; nothing moved. ArmError : it did not arrive.
        """
        self.go(self.session.model.home_rad, rate_share)
        self.grip(0.0)

    def grip(self, share: float) -> None:
        """Open the gripper (1) or close it (0), and wait until it has got there.

        Raises
        ------
        NotArmed : the session is not armed. ArmError : it did not arrive.
        """
        self.session.grip(share)
        give_up_s = self._clock() + _OVERTIME_S
        while self.session.is_gripping and self._clock() < give_up_s:
            self._tick()

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

    def _tick(self) -> None:
        """Wait for the next beat of the session's rhythm; a tick that took long is no reason to."""
        wait_s = self._next_s - self._clock()
        if wait_s > 0.0:
            self._sleep(wait_s)
        self._next_s = self._clock() + self.tick_s
        self.session.tick()

    def _rest(self, seconds: float) -> None:
        end_s = self._clock() + seconds
        while self._clock() < end_s:
            self._tick()

    def _wait(self, seconds: float, what: str) -> None:
        give_up_s = self._clock() + seconds
        while self.session.state is not SessionState.ARMED:
            self._tick()
            is_stuck = self.session.state not in (SessionState.MOVING, SessionState.ARMED)
            if is_stuck or self._clock() > give_up_s:
                raise ArmError(
                    f"the arm did not {what} in {seconds:.1f} s: {self.session.state.value} "
                    f"{self.session.reason}"
                )


def link_of(arm: ArmModel, port: str) -> Link:
    """Return the link to an arm on a port, at the baud rate of the arm's file; not opened yet."""
    spoken = protocol(arm.bus.protocol)
    link = open_link(port, spoken)
    if arm.bus.baud and link.baud:
        link.baud = arm.bus.baud
    return link
