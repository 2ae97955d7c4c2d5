"""What is wrong with a servo, judged from what it says: heat, supply, a stall, silence.

Pure: values in, troubles out; what is done about them is the session's business. Source: ours.
"""

import enum
from collections import deque
from typing import Deque, Dict, List, NamedTuple, Optional, Set, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.codec.protocol import ServoFlag
from firmware_bridge.policy import HOLD, TORQUE_OFF, WARN, Policy
from firmware_bridge.servos import Measured

_LINE_S = 0.25
_N_SILENT = 3  # position reads in a row, each with the bus's own retries


class Kind(enum.Enum):
    """Kinds of trouble, the one that explains most first."""

    OVERHEAT = "overheat"
    CLASH = "id clash"
    BAUD = "wrong baud"
    BROWN_OUT = "brown-out"
    DEAD = "dead id"
    READ_BACK = "read-back"
    STALL = "stall"


class Trouble(NamedTuple):
    """One trouble of one servo, in words that name kind, joint and id."""

    kind: Kind
    servo_id: int
    text: str
    action: str


class Watch:
    """Follow one arm. ``expect`` and ``measured`` once a tick, the others as values come.

    A joint may lag behind by ``window_s``; beyond the range that it was commanded through within
    that time by more than ``stall_rad``, for ``stall_s``, it is stalled.
    """

    def __init__(
        self,
        policy: Policy,
        names: Dict[int, str],
        joint_ids: Tuple[int, ...],
        window_s: float = 0.2,
    ) -> None:
        self.policy = policy
        self._names = names
        self._joint_ids = joint_ids
        self._window_s = window_s
        self._way: Deque[Tuple[float, Array]] = deque()
        self._off_since: Dict[int, float] = {}
        self._n_silent: Dict[int, int] = {}
        self._told: Set[int] = set()
        self._line_since: Optional[float] = None  # when all servos fell silent at once
        self._warned: Dict[int, bool] = {}

    def forget(self) -> None:
        """Start anew, as after arming."""
        self._way.clear()
        self._off_since.clear()
        self._n_silent.clear()
        self._told.clear()
        self._line_since = None
        self._warned.clear()

    def expect(self, t_s: float, pose: Array) -> None:
        """Note where the arm is commanded to be (k,)."""
        self._way.append((t_s, pose))
        while len(self._way) > 1 and self._way[1][0] <= t_s - self._window_s:
            self._way.popleft()

    def measured(self, now_s: float, seen: Measured) -> List[Trouble]:
        """Judge positions and the flags that came with them."""
        found = self.silent(now_s, seen)
        for servo_id, flags in seen.flags.items():
            found += self.flagged(servo_id, flags)
        return found + self._stalled(now_s, seen)

    def silent(self, now_s: float, seen: Measured) -> List[Trouble]:
        """Judge who has not answered some times in a row; each is told once.

        All of them at once is more likely a busy host or adapter than six broken servos, and is
        given some time to pass.
        """
        is_line = len(seen.missing) >= len(self._names) > 1
        if not is_line:
            self._line_since = None
        elif self._line_since is None:
            self._line_since = now_s
        is_passing = self._line_since is not None and now_s - self._line_since < _LINE_S
        found: List[Trouble] = []
        for servo_id in self._names:
            if servo_id not in seen.missing:
                self._n_silent[servo_id] = 0
                self._told.discard(servo_id)
                continue
            self._n_silent[servo_id] = self._n_silent.get(servo_id, 0) + 1
            is_due = self._n_silent[servo_id] >= _N_SILENT and servo_id not in self._told
            if is_due and not is_passing:
                self._told.add(servo_id)
                found.append(self._trouble(Kind.DEAD, servo_id, "does not answer", HOLD))
        return found

    def suspects(self) -> List[int]:
        """Return joints that have left their way, stalled or not yet."""
        return list(self._off_since)

    def flagged(self, servo_id: int, flags: ServoFlag) -> List[Trouble]:
        """Judge what a servo says of itself."""
        found = []
        if flags & ServoFlag.OVERHEAT:
            action = self.policy.overheat
            found.append(self._trouble(Kind.OVERHEAT, servo_id, "says it is too hot", action))
        if flags & ServoFlag.VOLTAGE:
            action = self.policy.brown_out
            found.append(self._trouble(Kind.BROWN_OUT, servo_id, "says its supply is bad", action))
        if flags & (ServoFlag.STALL | ServoFlag.OVERCURRENT):
            found.append(self._trouble(Kind.STALL, servo_id, "is overloaded", self.policy.stall))
        return found

    def temperature(self, servo_id: int, celsius: float) -> Optional[Trouble]:
        """Judge a temperature."""
        policy = self.policy
        if celsius < policy.warn_c:
            self._warned.pop(servo_id, None)
            return None
        text = f"is at {celsius:.0f} C, {policy.max_c:.0f} C are allowed"
        if celsius >= policy.limp_c and policy.overheat != WARN:
            return self._trouble(Kind.OVERHEAT, servo_id, text, TORQUE_OFF)
        if celsius >= policy.max_c:
            return self._trouble(Kind.OVERHEAT, servo_id, text, policy.overheat)
        if self._warned.get(servo_id):
            return None
        self._warned[servo_id] = True
        return self._trouble(Kind.OVERHEAT, servo_id, f"is warm: {celsius:.0f} C", WARN)

    def voltage(self, servo_id: int, volts: float) -> Optional[Trouble]:
        """Judge a supply voltage."""
        if volts >= self.policy.min_v:
            return None
        text = f"has {volts:.1f} V, at least {self.policy.min_v:.1f} V are needed"
        return self._trouble(Kind.BROWN_OUT, servo_id, text, self.policy.brown_out)

    def torque(self, servo_id: int, is_on: bool) -> Optional[Trouble]:
        """Judge whether a servo of an armed arm has its torque."""
        if is_on:
            return None
        text = "has lost its torque: it was reset, most likely by a dip of its supply"
        return self._trouble(Kind.BROWN_OUT, servo_id, text, self.policy.brown_out)

    def _stalled(self, now_s: float, seen: Measured) -> List[Trouble]:
        if not self._way:
            return []
        poses = np.array([pose for _, pose in self._way])
        beyond = np.maximum(poses.min(axis=0) - seen.q_rad, seen.q_rad - poses.max(axis=0))
        found = []
        for j, servo_id in enumerate(self._joint_ids):
            if not beyond[j] > self.policy.stall_rad:  # NaN: not measured
                self._off_since.pop(servo_id, None)
            elif now_s - self._off_since.setdefault(servo_id, now_s) >= self.policy.stall_s:
                text = f"does not follow: {beyond[j]:.2f} rad beside its way"
                found.append(self._trouble(Kind.STALL, servo_id, text, self.policy.stall))
        return found

    def _trouble(self, kind: Kind, servo_id: int, what: str, action: str) -> Trouble:
        name = self._names.get(servo_id)
        who = "the board" if name is None else f"{name} (id {servo_id})"
        return Trouble(kind, servo_id, f"{kind.value}: {who} {what}", action)
