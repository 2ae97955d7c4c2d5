"""A session's state and what latches it: faults, the e-stop, a lost link.

Whatever may happen at any moment and from any thread is here; the state lock is never held over
I/O, so nothing in here waits for a tick under way.
"""

import contextlib
import logging
import math
import threading
from typing import Callable, Dict, Iterator, List, Optional, Union

import numpy as np

from apex_edge.types import Array
from firmware_bridge.bus import Bus
from firmware_bridge.codec import protocol
from firmware_bridge.deadman import Deadman
from firmware_bridge.errors import LinkLost
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.base import Link
from firmware_bridge.motion import Motion, rhythm_of
from firmware_bridge.policy import TORQUE_OFF, WARN, Policy
from firmware_bridge.servos import Servos
from firmware_bridge.states import LATCHED, UP, JointState, SessionState
from firmware_bridge.supervision import Supervision
from firmware_bridge.telemetry import Telemetry
from firmware_bridge.watch import Kind, Trouble
from firmware_bridge.watching import Watching

_LOG = logging.getLogger(__name__)
_OLD_S = 0.06  # an older measurement says less of a moving arm than what it was told


class SessionCore:
    """What ``ArmSession`` stands on; see there for the parameters."""

    def __init__(
        self,
        arm: ArmModel,
        link: Union[Link, Bus],
        clock: Callable[[], float],
        policy: Optional[Policy] = None,
        deadman: Optional[Deadman] = None,
    ) -> None:
        self.model = arm
        self.reason = ""
        self.n_late_ticks = 0
        self.bus = (
            link if isinstance(link, Bus) else Bus(protocol(arm.bus.protocol), link, None, clock)
        )
        self.servos = Servos(arm, self.bus)
        self.rhythm = rhythm_of(arm, self.bus.protocol, self.bus.link.baud)
        self.policy = policy if policy is not None else arm.policy
        self._clock = clock
        self._lock = threading.RLock()
        self._state_lock = threading.RLock()  # never held over I/O: estop takes it
        self._state = SessionState.CLOSED
        self._motion = self._standing(np.full(arm.n_joints, np.nan))
        self._arming_until_s: Optional[float] = None  # inf: on a known way home
        self._watching = Watching(self.servos, self.policy, self.rhythm, clock)
        self._supervision = Supervision(self.servos, deadman)
        self._counts: Dict[str, int] = {}
        self._known: List[Trouble] = []  # what the present fault is made of

    @property
    def state(self) -> SessionState:
        """Where the session stands."""
        return self._state

    def estop(self, reason: str) -> None:
        """Stop at once and latch, from any thread; waits for no lock and no tick; never raises."""
        pose = self._here(self._clock())
        frames = self.servos.stop_frames(pose)
        if self.policy.estop == TORQUE_OFF:
            frames += self.bus.protocol.torque(self.model.all_ids, False)
        self._latch(SessionState.ESTOP, reason, pose)
        try:
            if self.bus.is_open:
                self.bus.urgent(frames)
        except LinkLost as error:
            self.reason = f"{reason}; and {error}"

    def reset(self) -> None:
        """Leave FAULT or ESTOP: CONNECTED when the link is open, else CLOSED; never moves."""
        with self._lock, self._state_lock:
            if self._state in LATCHED:
                self.bus.release()
                self._supervision.clear()
                is_open = self.bus.is_open
                self._state_is(SessionState.CONNECTED if is_open else SessionState.CLOSED, "")

    @property
    def battery_v(self) -> float:
        """The supply's voltage as the board, or the worst servo, last told it; NaN before."""
        told = self._watching.telemetry()
        volts = [float(v) for v in told.voltage_v if math.isfinite(v)]
        return min(volts) if volts else told.board_v

    def read(self) -> JointState:
        """Return where the arm is: measured by the last tick, else as commanded now."""
        now_s, motion = self._clock(), self._motion
        is_moving = self._state is SessionState.MOVING
        seen = self._watching.seen
        if seen is None:
            return motion.state(now_s, is_moving)
        return seen.state(now_s, is_moving)

    def telemetry(self) -> Telemetry:
        """Return what the servos last said of heat, supply, load and torque."""
        return self._watching.telemetry()

    def stats(self) -> Dict[str, int]:
        """Return counters since the session was made: its own, the bus's and the supervisor's."""
        counts = {**self._counts, "late ticks": int(self.n_late_ticks)}
        counts.update({f"bus {k}": int(v) for k, v in vars(self.bus.stats).items()})
        counts.update(self._supervision.counts())
        return counts

    def _look(self) -> None:
        """Measure and judge; the lock is not held while servos are asked."""
        troubles = self._watching.look(self._motion, self._state)
        news = self._watching.came_back()
        if news is not None:
            self._explain([news])
        self._handle(troubles)

    def _handle(self, troubles: List[Trouble]) -> None:
        """Warn, or stop and say everything that is wrong; then find out why servos are silent."""
        for trouble in troubles:
            self._count(trouble.kind.value)
            if trouble.action == WARN:
                _LOG.warning("%s", trouble.text)
        grave = [one for one in troubles if one.action != WARN]
        if grave and self._state in UP:
            self._known = []
            grave.sort(key=lambda one: list(Kind).index(one.kind))
            self._fail("; ".join(one.text for one in grave))
            for trouble in grave:
                if trouble.action == TORQUE_OFF:
                    self.servos.switch(False, (trouble.servo_id,))
            self._known = [one for one in grave if one.kind is not Kind.DEAD]
        silent = [one for one in grave if one.kind is Kind.DEAD]
        if silent:
            self._explain([self._watching.explain(one) for one in silent])

    def _explain(self, found: List[Trouble]) -> None:
        """Name a fault by what was found out about it since."""
        renamed = {one.servo_id for one in found}
        self._known = [one for one in self._known if one.servo_id not in renamed] + found
        self._known.sort(key=lambda one: list(Kind).index(one.kind))
        text = "; ".join(one.text for one in self._known)
        with self._state_lock:
            if self._state is SessionState.FAULT:
                self.reason = text
        _LOG.warning("%s", text)

    def _fail(self, reason: str) -> None:
        """Stop the arm and latch a FAULT."""
        pose = self._here(self._clock())
        self._latch(SessionState.FAULT, reason, pose)
        with self._losing():
            self.bus.urgent(self.servos.stop_frames(pose))
        self._supervision.beat(self._motion, self._state, self._clock())

    def _is_supervised(self) -> bool:
        trouble = self._supervision.trouble()
        if trouble and self._state in UP:
            self._fail(trouble)
        return not trouble

    @contextlib.contextmanager
    def _losing(self) -> Iterator[None]:
        """Turn a lost link into a FAULT, and pass it on."""
        try:
            yield
        except LinkLost as error:
            if self._state not in LATCHED:
                self._latch(SessionState.FAULT, str(error), self._motion.at(self._clock()))
            self._supervision.end()
            raise

    def _latch(self, state: SessionState, reason: str, pose: Array) -> None:
        with self._state_lock:
            if self._state is SessionState.ESTOP and state is SessionState.FAULT:
                return
            self._motion = self._standing(pose)
            self._arming_until_s = None
            self._state_is(state, reason)

    def _here(self, now_s: float) -> Array:
        """Return where the arm is (k,): as measured, where it can be, else as commanded."""
        commanded = self._motion.at(now_s)
        seen = self._watching.seen
        is_old = seen is None or now_s - seen.t_s > _OLD_S
        if seen is None or is_old or self._state is not SessionState.MOVING:
            return commanded
        measured = seen.at(now_s)
        here: Array = np.where(np.isfinite(measured), measured, commanded)
        return here

    def _standing(self, pose: Array) -> Motion:
        return Motion(np.array(pose, dtype=np.float64), horizon_s=self.rhythm.horizon_s)

    def _put(self, motion: Motion) -> None:
        """Take a new motion, unless an e-stop or a fault came first."""
        with self._state_lock:
            if self._state not in LATCHED:
                self._motion = motion

    def _count(self, what: str) -> None:
        self._counts[what] = self._counts.get(what, 0) + 1

    def _enter(self, state: SessionState, reason: str = "") -> None:
        with self._state_lock:
            if self._state not in LATCHED:
                self._state_is(state, reason)

    def _state_is(self, state: SessionState, reason: str) -> None:
        if state is not self._state:
            _LOG.info("arm %s -> %s %s", self._state.value, state.value, reason)
            self._count(f"-> {state.value}")
        self._state, self.reason = state, reason
