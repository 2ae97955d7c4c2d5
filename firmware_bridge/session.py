"""The arm as a state machine: connect, arm, move within limits, stop; faults latch.

Most servos have no watchdog, so a path is never handed over whole: ``tick`` streams set-points a
tenth of a second ahead, and the arm of a dead host stops within that time (``deadman`` stops it
sooner). Poses are measured where servos can be asked; others are commanded ones, and say so.
"""

import contextlib
import logging
import math
from typing import Callable, Optional, Union

import numpy as np

from apex_edge.types import Array
from firmware_bridge import arming
from firmware_bridge.bus import Bus, Verdict
from firmware_bridge.core import SessionCore
from firmware_bridge.deadman import Deadman
from firmware_bridge.errors import LinkLost, MotionRefused, NotArmed
from firmware_bridge.guard import CheckedPath, Limits, check_path
from firmware_bridge.handshake import Findings, calibrated, shake_hands, wanted_limits
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.base import Link
from firmware_bridge.motion import HORIZON_S, Motion
from firmware_bridge.policy import HOLD, Policy
from firmware_bridge.states import LATCHED, UP, JointState, MoveReport, SessionState, refusal
from firmware_bridge.watch import Kind, Trouble

_LOG = logging.getLogger(__name__)
_N_MEASURED = 3  # times at most, before arming is given up

__all__ = ["HORIZON_S", "ArmSession", "JointState", "MoveReport", "SessionState"]


class ArmSession(SessionCore):
    """One arm on one link. ``clock`` returns seconds, monotonic or simulated.

    Safe to call from several threads; ``estop`` and ``read`` wait for nobody. A lost link is a
    FAULT: it is raised once, by the call that met it (``move`` reports it instead). After ``reset``
    and ``open``, or ``reopen``, the session is CONNECTED and nothing moves before ``arm``.

    Parameters
    ----------
    link : of the arm, or the bus on it.
    limits : the arm's own when None.
    policy : what counts as a fault of a servo, and what is done about it; the arm's own when None.
    deadman : supervises the host while the arm is armed; None: nobody does.
    """

    def __init__(
        self,
        arm: ArmModel,
        link: Union[Link, Bus],
        clock: Callable[[], float],
        limits: Optional[Limits] = None,
        policy: Optional[Policy] = None,
        deadman: Optional[Deadman] = None,
    ) -> None:
        super().__init__(arm, link, clock, policy, deadman)
        self.findings: Optional[Findings] = None
        self._limits = limits if limits is not None else arm.workspace

    @property
    def can_move(self) -> bool:
        """Say whether ``move`` would look at a path: armed, and not still on the way home."""
        return self._state in UP and self._arming_until_s is None

    def open(self) -> None:
        """Open the link; a latched FAULT or ESTOP stays until ``reset``.

        Raises
        ------
        PortError : the port cannot be opened, and why.
        """
        with self._lock:
            self.bus.open()
            self._watching.forget()
            if self._state not in LATCHED:
                self._enter(SessionState.CONNECTED)

    def reopen(self) -> None:
        """Open the link of a lost board again: CONNECTED, and nothing moves. An ESTOP stays.

        Raises
        ------
        PortError : the port cannot be opened (yet), and why; try again.
        """
        with self._lock:
            self._supervision.end()
            self.bus.close()
            self.open()
            if self._state is SessionState.FAULT:
                self.reset()

    def close(self) -> None:
        """Hold the arm where it is and let go of the link; a board lost just then is a FAULT."""
        with self._lock:
            with contextlib.suppress(LinkLost):  # kept in state and reason; gone is closed as well
                self.stop()
            self._supervision.end()
            self.bus.close()
            if self._state not in LATCHED:
                self._enter(SessionState.CLOSED)

    def handshake(self) -> Findings:
        """Ask every servo who it is; moves nothing. Not while the arm moves.

        Raises
        ------
        NotArmed : the link is closed, or the arm moves. LinkLost : the board is gone.
        """
        with self._lock:
            self._require_still("handshake")
            with self._losing():
                self.findings = shake_hands(self.servos, self._clock)
            return self.findings

    def write_limits(self) -> Findings:
        """Write the arm file's joint limits into the servos that keep some, and look at them again.

        Raises
        ------
        NotArmed : the link is closed, or the arm moves. LinkLost : the board is gone.
        """
        with self._lock:
            self._require_still("write_limits")
            with self._losing():
                for servo_id in self.model.all_ids:
                    low, high = wanted_limits(self.model, servo_id)
                    self.servos.write_limits(servo_id, low, high)
            return self.handshake()

    def arm(self, at_rad: Optional[Array] = None) -> None:
        """Get ready to move.

        Servos that can be measured must answer the handshake; they then hold where they stand, and
        the session is ARMED at once. PWM servos cannot tell where they stand. With ``at_rad`` (k,)
        the caller vouches for the pose, and the session is ARMED at once. Without it the board is
        asked for its last command and the arm goes home from there, slowly, its gripper closed;
        keep calling ``tick`` until the state is ARMED. A board that does not answer gets one slow
        move home, which is the only command ever longer than the streaming horizon.

        Raises
        ------
        NotArmed : the state is not CONNECTED. MotionRefused : the pose cannot be held.
        HandshakeFailed : servos or calibration are not the arm's. LinkLost : the board is gone.
        """
        with self._lock:
            if self._state is not SessionState.CONNECTED:
                raise NotArmed(f"arm() needs state connected, found {self._state.value}")
            self._watching.forget()
            if not self.servos.has_feedback:
                calibrated(self.model).require(self.bus.link.port)
            with self._losing():
                if self.servos.has_feedback:
                    self._arm_measured()
                elif at_rad is not None:
                    pose = arming.vouched(self.model, at_rad, self._limits)
                    self._supervision.begin()
                    self.servos.send(pose, HORIZON_S)
                    self._put(self._standing(pose))
                    self._enter(SessionState.ARMED)
                else:
                    self._go_home()
            self._supervision.beat(self._motion, self._state, self._clock())

    def move(
        self, joints_rad: Array, duration_s: Array, deadline_s: Optional[float] = None
    ) -> MoveReport:
        """Replace the current motion by way-points (w, k), each after its own duration (w,).

        The path starts at the pose commanded now; the first short segment is sent at once. A
        refused path changes nothing: what was under way goes on. One that comes after
        ``deadline_s`` (on the session's clock) is refused.
        """
        with self._lock:
            if not self.can_move:
                is_up = self._arming_until_s is not None
                why = "still on the way home" if is_up else f"state is {self._state.value}"
                return self._refuse(f"not ready to move: {why}")
            now_s = self._clock()
            start = self._motion.at(now_s)
            try:
                path = check_path(
                    self.model, start, joints_rad, duration_s, self._limits, now_s, deadline_s
                )
            except MotionRefused as error:
                _LOG.warning("motion refused: %s", error)
                return self._refuse(str(error))
            if not self._is_supervised():
                return self._refuse(self.reason)
            try:
                self._begin(path, now_s)
            except (LinkLost, MotionRefused) as error:
                return self._refuse(str(error))
            self._count("moves")
            told = ["slowed down to the arm's rates"] if path.is_stretched else []
            return MoveReport(
                True,
                path.knots_rad[1:],
                np.diff(path.knots_s),
                self._clock(),
                "; ".join([*told, *path.clamped]),
            )

    @property
    def is_gripping(self) -> bool:
        """Say whether the gripper is still on its way."""
        is_there = self.servos.grip_goal in (None, self.servos.grip_ticks)
        return self._state in UP and not is_there

    def grip(self, share: float) -> None:
        """Let the gripper go to a share of its opening, 0 closed, 1 open; ``tick`` moves it.

        Raises
        ------
        NotArmed : the state is neither ARMED nor MOVING. MotionRefused : not within 0..1, or the
            arm has no gripper.
        """
        with self._lock:
            if not self.can_move:
                raise NotArmed(f"grip() needs state armed, found {self._state.value}")
            gripper = self.model.gripper
            if gripper is None or not 0.0 <= share <= 1.0:
                raise MotionRefused(f"grip({share!r}): no gripper, or not within 0..1")
            way = gripper.open_ticks - gripper.closed_ticks
            self.servos.grip_goal = gripper.closed_ticks + int(round(share * way))

    def tick(self) -> None:
        """Send the next set-point, measure, and look after the servos; see ``rhythm``.

        In FAULT and ESTOP it goes on measuring, and moves nothing.

        Raises
        ------
        LinkLost : the board is gone; the session is in FAULT.
        """
        if not self.bus.is_open:
            return
        with self._losing():
            with self._lock:
                self.bus.drain()
                if self._state in UP and self._is_supervised():
                    self._advance(self._clock())
                self._supervision.beat(self._motion, self._state, self._clock())
            self._look()
        with self._lock:  # on a slow line looking takes most of what the host may be silent
            self._supervision.beat(self._motion, self._state, self._clock())

    def stop(self) -> None:
        """Hold where the arm is. Does nothing when nothing moves.

        While the arm goes home blindly (see ``arm``) its pose is unknown and holding would make it
        jump: the slow move ends by itself, and the session is CONNECTED, not armed.

        Raises
        ------
        LinkLost : the board is gone; the session is in FAULT.
        """
        with self._lock:
            if self._state is not SessionState.MOVING:
                return
            is_arming = self._arming_until_s is not None
            motion = self._standing(self._here(self._clock()))
            self._arming_until_s = None
            with self._losing():
                self.servos.hold(motion.pose)
            self._put(motion)
            self._enter(SessionState.CONNECTED if is_arming else SessionState.ARMED)
            self._supervision.beat(motion, self._state, self._clock())

    def torque(self, is_on: bool) -> bool:
        """Switch the torque of a standing arm; say whether its protocol can.

        Off makes the arm limp: it sinks, and the session is CONNECTED. On is part of ``arm``.

        Raises
        ------
        NotArmed : the link is closed, the arm moves, or on is asked for without ``arm``.
        LinkLost : the board is gone.
        """
        with self._lock:
            self._require_still("torque")
            if is_on and self._state is not SessionState.ARMED:
                raise NotArmed("torque comes on by arm(), which first takes hold of the pose")
            with self._losing():
                is_done = self.servos.switch(is_on)
            if is_done and not is_on:
                self._put(self._standing(np.full(self.model.n_joints, np.nan)))
                if self._state is SessionState.ARMED:
                    self._enter(SessionState.CONNECTED)
                self._supervision.beat(self._motion, self._state, self._clock())
            return is_done

    def _arm_measured(self) -> None:
        self.findings = shake_hands(self.servos, self._clock)
        self.findings.require(self.bus.link.port)
        for note in self.findings.notes:
            _LOG.info("%s", note)
        seen = self.servos.measure()
        for _ in range(_N_MEASURED):
            if seen.is_valid.all():
                break
            seen = self.servos.measure()
        self._supervision.begin()
        pose = arming.take_hold(self.servos, seen)
        self._watching.start_from(seen)
        self._put(self._standing(pose))
        self._enter(SessionState.ARMED)

    def _go_home(self) -> None:
        told = self.servos.commanded_by_board()
        try:
            path = None if told is None else arming.way_home(self.model, told, self._limits)
        except MotionRefused as error:
            self.reason = str(error)
            raise
        self._supervision.begin()
        now_s, home = self._clock(), self.model.home_rad
        if path is not None:
            self._arming_until_s = math.inf
            self._begin(path, now_s)
        elif told is not None:
            self._finish_arming()
        else:
            _LOG.warning("the board does not tell its last command; going home slowly, blindly")
            self._arming_until_s = now_s + arming.BLIND_HOME_S
            self._put(self._standing(np.full(self.model.n_joints, np.nan)))
            self._enter(SessionState.MOVING)
            self.servos.send(home, arming.BLIND_HOME_S)

    def _finish_arming(self) -> None:
        self._arming_until_s = None
        self.servos.send(self.model.home_rad, HORIZON_S)
        self._put(self._standing(self.model.home_rad))
        self._enter(SessionState.ARMED)

    def _begin(self, path: CheckedPath, now_s: float) -> None:
        pose = path.knots_rad[0]
        rate = self.model.rate_rad_s
        self._put(Motion(pose, path, 0.0, now_s, self.rhythm.horizon_s, rate))
        self._enter(SessionState.MOVING)
        with self._losing():
            self._send_set_point(now_s)
        self._supervision.beat(self._motion, self._state, self._clock())

    def _advance(self, now_s: float) -> None:
        """Go on along the path; a late tick delays it rather than making the arm hurry."""
        due_s = self._arming_until_s
        motion, path = self._motion, self._motion.path
        with contextlib.suppress(MotionRefused):  # an e-stop came between: nothing more to send
            if due_s is not None and math.isfinite(due_s):
                if now_s >= due_s:
                    self._finish_arming()
            elif self._state is SessionState.MOVING and path is not None:
                self.n_late_ticks += now_s - motion.t_s > motion.horizon_s + 1e-6
                motion = motion.onward(now_s)
                self._put(motion)
                if motion.is_over:
                    self._arrive(path.knots_rad[-1].copy())
                else:
                    self._send_set_point(now_s)
            elif self._state is SessionState.ARMED and self.servos.step_grip(self.rhythm):
                self._count("grip steps")

    def _arrive(self, goal: Array) -> None:
        """End a path: the goal is commanded once more and read back, where that is possible."""
        self._arming_until_s = None
        self._put(self._standing(goal))
        self._enter(SessionState.ARMED)
        if not self.servos.can_verify:
            return
        verdicts = self.servos.send(goal, self.rhythm.horizon_s)
        for servo_id, verdict in verdicts.items():
            if verdict is Verdict.MISMATCH:
                who = f"{self.servos.name_of(servo_id)} (id {servo_id})"
                text = f"{Kind.READ_BACK.value}: {who} was told another goal than was sent"
                self._handle([Trouble(Kind.READ_BACK, servo_id, text, HOLD)])

    def _send_set_point(self, now_s: float) -> None:
        motion = self._motion
        goal, ahead_s = motion.set_point()
        self.servos.step_grip(self.rhythm, is_alone=False)
        self.servos.send(goal, ahead_s, start=motion.at(now_s))

    def _require_still(self, what: str) -> None:
        if not self.bus.is_open or self._state is SessionState.MOVING:
            raise NotArmed(f"{what}() needs an open link and a standing arm: {self._state.value}")

    def _refuse(self, reason: str) -> MoveReport:
        self._count("refused moves")
        return refusal(reason, self.model.n_joints)
