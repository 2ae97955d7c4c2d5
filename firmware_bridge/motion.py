"""What the arm is commanded to do at any moment, as one immutable value; and how often to tell it.

A session replaces the value as a whole, so an e-stop from another thread reads it without a lock.
"""

import math
from dataclasses import dataclass, replace
from typing import List, Optional, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.codec.protocol import Quantity, ServoProtocol, ServoTarget
from firmware_bridge.guard import CheckedPath
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.states import COMMANDED, JointState

HORIZON_S = 0.1
MAX_HORIZON_S = 0.15
MIN_TICK_S = 0.02
_SHARE = 0.8  # of a tick that the line may be busy
_SPEED_STEP_S = 0.001
_TURN_ROUND_S = 0.0003  # a servo takes about that long to answer


@dataclass(frozen=True)
class Rhythm:
    """How often a session ticks and how far ahead of a tick it commands the arm."""

    tick_s: float = MIN_TICK_S
    horizon_s: float = HORIZON_S


def rhythm_of(arm: ArmModel, protocol: ServoProtocol, baud: int = 0) -> Rhythm:
    """Return the fastest rhythm that the line has room for, 50 Hz at most.

    A tick moves all servos, measures all joints where that is possible and asks for two more
    values. The horizon is two ticks where a tenth of a second is less, and never above 150 ms.

    Parameters
    ----------
    baud : of the line, 0: the protocol's own.
    """
    low, high = arm.tick_range
    targets = [ServoTarget(i, (low + high) // 2, 1) for i in arm.all_ids]
    n_bytes = sum(len(frame) for frame in protocol.move(targets, 100))
    turns = 0
    if protocol.has_feedback and Quantity.POSITION in protocol.quantities:
        asked = list(protocol.query(Quantity.POSITION, arm.all_ids))
        asked += 2 * list(protocol.query(Quantity.POSITION, arm.all_ids[:1]))
        n_bytes += sum(len(query.frame) + query.n_reply for query in asked)
        turns = len(asked)
    wire_s = n_bytes * 10.0 / (baud or protocol.baud or 1_000_000) + turns * _TURN_ROUND_S
    tick_s = max(MIN_TICK_S, math.ceil(wire_s / _SHARE * 1000.0) / 1000.0)
    return Rhythm(tick_s, min(max(HORIZON_S, 2.0 * tick_s), MAX_HORIZON_S))


@dataclass(frozen=True, eq=False)
class Motion:
    """A path under way, or the ``pose (k,)`` that is held (NaN while unknown) when it is None.

    ``path_s`` of the path were done at ``t_s``; the board goes on by itself for one horizon.
    """

    pose: Array
    path: Optional[CheckedPath] = None
    path_s: float = 0.0
    t_s: float = 0.0
    horizon_s: float = HORIZON_S

    def since(self, now_s: float) -> float:
        """Return for how long the arm has moved since the last set-point."""
        return min(max(now_s - self.t_s, 0.0), self.horizon_s)

    def at(self, now_s: float) -> Array:
        """Return where the arm is commanded to be now (k,)."""
        if self.path is None:
            return self.pose.copy()
        return self.path.at(self.path_s + self.since(now_s))

    def state(self, now_s: float, is_moving: bool) -> JointState:
        """Return where the arm is commanded to be now."""
        q_rad = self.at(now_s)
        speed = (self.at(now_s + _SPEED_STEP_S) - q_rad) / _SPEED_STEP_S
        return JointState(now_s, q_rad, is_moving, COMMANDED, speed, 0.0, np.isfinite(q_rad))

    def onward(self, now_s: float) -> "Motion":
        """Return the same motion as of now; a late tick delays the path."""
        return replace(self, path_s=self.path_s + self.since(now_s), t_s=now_s)

    def set_point(self) -> Tuple[Array, float]:
        """Return where the arm shall be at the end of the horizon (k,), and in how many seconds."""
        if self.path is None:
            return self.pose.copy(), self.horizon_s
        ahead_s = min(self.horizon_s, self.path.total_s - self.path_s)
        return self.path.at(self.path_s + ahead_s), ahead_s

    @property
    def is_over(self) -> bool:
        """Say whether the path has been done."""
        return self.path is None or self.path_s >= self.path.total_s - 1e-9

    def ages_s(self, step_s: float) -> List[float]:
        """Return moments after ``t_s`` at which the arm would have to be stopped elsewhere."""
        if self.path is None:
            return [0.0]
        return [float(age) for age in np.arange(0.0, self.horizon_s + 0.5 * step_s, step_s)]
