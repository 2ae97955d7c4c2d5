"""The arm as a state machine: connect, arm, move within limits, stop; faults latch.

A PWM board has no watchdog, so a path is never handed over whole: ``tick`` streams set-points a
tenth of a second ahead, and the arm of a dead host stops within that time. PWM servos cannot be
measured either: all poses here are commanded ones, and say so.
"""

import contextlib
import logging
import math
import threading
from dataclasses import dataclass
from enum import Enum
from typing import Callable, Dict, Optional

import numpy as np

from apex_edge.types import Array
from firmware_bridge.codec import rrc
from firmware_bridge.errors import LinkLost, MotionRefused, NotArmed, ProtocolError
from firmware_bridge.guard import CheckedPath, Limits, check_path
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink

_LOG = logging.getLogger(__name__)

HORIZON_S = 0.1
_ANSWER_WAIT_S = 0.3  # a position request is answered within 2 ms on a healthy line
_BLIND_HOME_S = 3.0  # longest turn is pi rad: about 1 rad/s
_ARMING_SHARE = 0.4  # of the arm's rate, on the way home
_HOLD_S = 0.02  # one PWM period


class SessionState(Enum):
    """Where the session stands; FAULT and ESTOP are left by ``reset`` alone."""

    CLOSED = "closed"
    CONNECTED = "connected"
    ARMED = "armed"
    MOVING = "moving"
    FAULT = "fault"
    ESTOP = "estop"


@dataclass(frozen=True)
class JointState:
    """Pose ``joints_rad (k,)`` (NaN while unknown); ``source`` is "commanded" on PWM arms."""

    t_s: float
    joints_rad: Array
    is_moving: bool
    source: str = "commanded"


@dataclass(frozen=True)
class MoveReport:
    """What became of a move: way-points ``(w, k)``, durations ``(w,)`` as accepted, or why not.

    ``t_sent_s`` is when the first segment's last byte had been written (NaN when refused).
    """

    is_accepted: bool
    joints_rad: Array
    duration_s: Array
    t_sent_s: float
    reason: str = ""


class ArmSession:
    """One arm on one link. ``clock`` returns seconds, monotonic or simulated.

    Safe to call from several threads. A lost link is a FAULT: it is raised once, by the call that
    met it (``move`` reports it instead); after ``reset`` and ``open`` the session is CONNECTED and
    nothing moves before ``arm``.
    """

    def __init__(
        self,
        arm: ArmModel,
        link: SerialLink,
        clock: Callable[[], float],
        limits: Optional[Limits] = None,
    ) -> None:
        self.model = arm
        self.reason = ""
        self.battery_v = math.nan
        self.n_late_ticks = 0
        self._link = link
        self._clock = clock
        self._limits = limits if limits is not None else arm.workspace
        self._lock = threading.RLock()
        self._state = SessionState.CLOSED
        self._parser = rrc.RrcParser()
        self._pose = np.full(arm.n_joints, np.nan)
        self._path: Optional[CheckedPath] = None
        self._path_s = 0.0
        self._path_t_s = 0.0
        self._board_us: Dict[int, int] = {}
        self._arming_until_s: Optional[float] = None
        self._is_blind = False

    @property
    def state(self) -> SessionState:
        """Where the session stands."""
        return self._state

    @property
    def can_move(self) -> bool:
        """Say whether ``move`` would look at a path: armed, and not still on the way home."""
        is_up = self._state in (SessionState.ARMED, SessionState.MOVING)
        return is_up and self._arming_until_s is None

    def open(self) -> None:
        """Open the link; a latched FAULT or ESTOP stays until ``reset``.

        Raises
        ------
        PortError : the port cannot be opened, and why.
        """
        with self._lock:
            self._link.open()
            self._parser = rrc.RrcParser()
            if self._state not in (SessionState.FAULT, SessionState.ESTOP):
                self._enter(SessionState.CONNECTED)

    def close(self) -> None:
        """Hold the arm where it is and let go of the link; a board lost just then is a FAULT."""
        with self._lock:
            with contextlib.suppress(LinkLost):  # kept in state and reason; gone is closed as well
                self.stop()
            self._link.close()
            if self._state not in (SessionState.FAULT, SessionState.ESTOP):
                self._enter(SessionState.CLOSED)

    def arm(self, at_rad: Optional[Array] = None) -> None:
        """Close the gripper and get ready to move.

        PWM servos cannot tell where they stand. With ``at_rad`` (k,) the caller vouches for the
        pose, and the session is ARMED at once. Without it the board is asked for its last command
        and the arm goes home from there, slowly; keep calling ``tick`` until the state is ARMED.
        A board that does not answer gets one slow move home, which is the only command ever longer
        than the streaming horizon.

        Raises
        ------
        NotArmed : the state is not CONNECTED. MotionRefused : ``at_rad`` is outside the limits.
        LinkLost : the board is gone.
        """
        with self._lock:
            if self._state is not SessionState.CONNECTED:
                raise NotArmed(f"arm() needs state connected, found {self._state.value}")
            if at_rad is not None:
                pose = np.asarray(at_rad, dtype=np.float64)
                check_path(self.model, pose, pose[None], np.array([HORIZON_S]), self._limits)
                self._send_pose(pose, HORIZON_S)
                self._enter(SessionState.ARMED)
                return
            self._board_us = {}
            self._pose = np.full(self.model.n_joints, np.nan)
            for servo_id in self.model.servo_ids:
                self._send(rrc.PwmPositionRequest(servo_id))
            self._arming_until_s = self._clock() + _ANSWER_WAIT_S
            self._is_blind = False
            self._enter(SessionState.MOVING)

    def move(self, joints_rad: Array, duration_s: Array) -> MoveReport:
        """Replace the current motion by way-points (w, k), each after its own duration (w,).

        The path starts at the pose commanded now; the first short segment is sent at once. A
        refused path changes nothing: what was under way goes on.
        """
        with self._lock:
            if not self.can_move:
                is_up = self._arming_until_s is not None
                why = "still on the way home" if is_up else f"state is {self._state.value}"
                return self._refusal(f"not ready to move: {why}")
            now_s = self._clock()
            start = self._commanded(now_s)
            try:
                path = check_path(self.model, start, joints_rad, duration_s, self._limits)
            except MotionRefused as error:
                _LOG.warning("motion refused: %s", error)
                return self._refusal(str(error))
            try:
                self._begin(path, now_s)
            except LinkLost as error:
                return self._refusal(str(error))
            return MoveReport(
                True,
                path.knots_rad[1:],
                np.diff(path.knots_s),
                self._clock(),
                "slowed down to the arm's rates" if path.is_stretched else "",
            )

    def tick(self) -> None:
        """Send the next set-point and read what the board said; call it at 10 Hz or more.

        Raises
        ------
        LinkLost : the board is gone; the session is in FAULT.
        """
        with self._lock:
            if not self._link.is_open:
                return
            self._receive()
            now_s = self._clock()
            if self._arming_until_s is not None:
                self._go_home(now_s)
            elif self._path is not None and self._state is SessionState.MOVING:
                self._stream(now_s)

    def stop(self) -> None:
        """Hold at the pose commanded now. Does nothing when nothing moves.

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
            self._hold()
            self._enter(SessionState.CONNECTED if is_arming else SessionState.ARMED)

    def estop(self, reason: str) -> None:
        """Stop at once and latch; never raises, for there is nobody to catch it."""
        with self._lock:
            try:
                self._hold()
            except LinkLost as error:
                reason = f"{reason}; and {error}"
            self._enter(SessionState.ESTOP, reason)

    def reset(self) -> None:
        """Leave FAULT or ESTOP: CONNECTED when the link is open, else CLOSED; never moves."""
        with self._lock:
            if self._state in (SessionState.FAULT, SessionState.ESTOP):
                is_open = self._link.is_open
                self._enter(SessionState.CONNECTED if is_open else SessionState.CLOSED)

    def read(self) -> JointState:
        """Return the pose commanded now."""
        with self._lock:
            now_s = self._clock()
            is_moving = self._state is SessionState.MOVING
            return JointState(now_s, self._commanded(now_s), is_moving)

    def _commanded(self, now_s: float) -> Array:
        """Where the board's interpolation is now: it goes on for one horizon and no further."""
        if self._path is None:
            return self._pose.copy()
        return self._path.at(self._path_s + self._since(now_s))

    def _since(self, now_s: float) -> float:
        return min(max(now_s - self._path_t_s, 0.0), HORIZON_S)

    def _begin(self, path: CheckedPath, now_s: float) -> None:
        self._path, self._path_s, self._path_t_s = path, 0.0, now_s
        self._enter(SessionState.MOVING)
        self._send_set_point(path)

    def _stream(self, now_s: float) -> None:
        """Go on along the path; a late tick delays the path rather than making the arm hurry."""
        path = self._path
        if path is None:
            return
        self.n_late_ticks += now_s - self._path_t_s > HORIZON_S + 1e-6
        self._path_s += self._since(now_s)
        self._path_t_s = now_s
        if self._path_s >= path.total_s - 1e-9:
            self._pose, self._path = path.knots_rad[-1].copy(), None
            self._enter(SessionState.ARMED)
            return
        self._send_set_point(path)

    def _send_set_point(self, path: CheckedPath) -> None:
        ahead_s = min(HORIZON_S, path.total_s - self._path_s)
        self._send_pose(path.at(self._path_s + ahead_s), ahead_s, is_goal=False)

    def _go_home(self, now_s: float) -> None:
        """Arm without knowing the pose: by the board's last command, else one slow blind move."""
        home = self.model.home_rad
        due_s = self._arming_until_s if self._arming_until_s is not None else now_s
        if self._is_blind:
            if now_s >= due_s:
                self._finish_arming(home)
        elif all(servo_id in self._board_us for servo_id in self.model.servo_ids):
            self._go_home_from(np.array([self._board_us[i] for i in self.model.servo_ids]), now_s)
        elif now_s >= due_s:
            _LOG.warning("the board does not tell its last command; going home slowly and blindly")
            self._is_blind = True
            self._arming_until_s = now_s + _BLIND_HOME_S
            self._send_pose(home, _BLIND_HOME_S)
            self._pose = np.full(self.model.n_joints, np.nan)

    def _go_home_from(self, board_us: Array, now_s: float) -> None:
        if self._path is not None:
            self._stream(now_s)
            if self._state is SessionState.ARMED:
                self._arming_until_s = None
            return
        home = self.model.home_rad
        if np.abs(self.model.ticks(home) - board_us).max() <= 1:
            self._finish_arming(home)
            return
        low, high = self.model.limits_rad[:, 0], self.model.limits_rad[:, 1]
        start = np.clip(self.model.angles_rad(board_us), low, high)
        duration_s = self.model.travel_time_s(start, home[None]) / _ARMING_SHARE
        try:
            path = check_path(self.model, start, home[None], duration_s, self._limits)
        except MotionRefused as error:
            self._arming_until_s = None
            self._enter(SessionState.CONNECTED, f"no safe way home from the board's pose: {error}")
            return
        self._begin(path, now_s)

    def _finish_arming(self, pose: Array) -> None:
        self._arming_until_s = None
        self._send_pose(pose, HORIZON_S)
        self._enter(SessionState.ARMED)

    def _hold(self) -> None:
        """Command the pose of this moment, when it is known; forget the path."""
        pose = self._commanded(self._clock())
        is_moving = self._path is not None
        self._path, self._arming_until_s = None, None
        self._pose = pose
        if is_moving and self._link.is_open:
            self._send_pose(pose, _HOLD_S)

    def _send_pose(self, pose: Array, duration_s: float, is_goal: bool = True) -> None:
        """Send one set-point for all joints and the closed gripper; ``is_goal``: it stays there."""
        pulses = self.model.ticks(pose)
        targets = [(i, int(p)) for i, p in zip(self.model.servo_ids, pulses)]
        gripper = self.model.gripper
        if gripper is not None:
            targets.append((gripper.servo_id, gripper.closed_ticks))
        self._send(rrc.PwmMove(max(1, math.ceil(duration_s * 1000.0 - 1e-6)), tuple(targets)))
        if is_goal:
            self._pose = np.array(pose, dtype=np.float64)

    def _send(self, message: rrc.ToBoard) -> None:
        try:
            self._link.write(rrc.encode(message))
        except LinkLost as error:
            self._lose(error)
            raise

    def _receive(self) -> None:
        try:
            data = self._link.read_available()
        except LinkLost as error:
            self._lose(error)
            raise
        for frame in self._parser.feed(data):
            try:
                message = rrc.decode_from_board(frame)
            except ProtocolError:
                continue  # boards push IMU, key and gamepad reports that mean nothing here
            if isinstance(message, rrc.Battery):
                self.battery_v = message.millivolt / 1000.0
            elif isinstance(message, rrc.PwmPosition):
                self._board_us[message.servo_id] = message.pulse_us

    def _lose(self, error: LinkLost) -> None:
        self._pose = self._commanded(self._clock())
        self._path, self._arming_until_s = None, None
        if self._state is not SessionState.ESTOP:
            self._enter(SessionState.FAULT, str(error))

    def _refusal(self, reason: str) -> MoveReport:
        nothing = np.zeros((0, self.model.n_joints))
        return MoveReport(False, nothing, np.zeros(0), math.nan, reason)

    def _enter(self, state: SessionState, reason: str = "") -> None:
        if state is not self._state:
            _LOG.info("arm %s -> %s %s", self._state.value, state.value, reason)
        self._state, self.reason = state, reason
