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
_SAME_S = 1e-6
_LATE_S = 0.003  # a board may be so far behind, and must not hurry to make up for it
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

    At ``t_s`` the board stood at ``pose`` and ``path_s`` of the path were due. It goes straight to
    the set-point and no further, and no set-point lies beyond a way-point: corners are not cut, for
    only the path itself was checked. What that costs is made up for within the joints' rates
    ``rate_rad_s (k,)``.
    """

    pose: Array
    path: Optional[CheckedPath] = None
    path_s: float = 0.0
    t_s: float = 0.0
    horizon_s: float = HORIZON_S
    rate_rad_s: Optional[Array] = None

    def at(self, now_s: float) -> Array:
        """Return where the arm is commanded to be now (k,)."""
        if self.path is None:
            return self.pose.copy()
        goal, takes_s = self.set_point()
        share = min(max(now_s - self.t_s, 0.0) / takes_s, 1.0)
        pose: Array = self.pose + (goal - self.pose) * share
        return pose

    def state(self, now_s: float, is_moving: bool) -> JointState:
        """Return where the arm is commanded to be now."""
        q_rad = self.at(now_s)
        speed = (self.at(now_s + _SPEED_STEP_S) - q_rad) / _SPEED_STEP_S
        return JointState(now_s, q_rad, is_moving, COMMANDED, speed, 0.0, np.isfinite(q_rad))

    def onward(self, now_s: float) -> "Motion":
        """Return the same motion as of now; a late tick delays the path."""
        if self.path is None:
            return replace(self, t_s=now_s)
        since_s = min(max(now_s - self.t_s, 0.0), self.horizon_s)
        ahead_s = self.path.knots_s[self.path.knots_s > self.path_s + _SAME_S]
        # one way-point may be passed at a time: the board has not been told of the one behind it
        most_s = self.path.total_s if len(ahead_s) < 2 else float(ahead_s[1]) - 2.0 * _SAME_S
        path_s = min(self.path_s + since_s, most_s)
        return replace(self, pose=self.at(now_s), path_s=path_s, t_s=now_s)

    def set_point(self) -> Tuple[Array, float]:
        """Return where the arm shall be at the end of the horizon (k,), and in how many seconds."""
        if self.path is None:
            return self.pose.copy(), self.horizon_s
        ahead_s = self.path.knots_s[self.path.knots_s > self.path_s + _SAME_S]
        end_s = float(ahead_s[0]) if len(ahead_s) else self.path.total_s
        takes_s = max(min(self.horizon_s, end_s - self.path_s), _SAME_S)
        goal = self.path.at(self.path_s + takes_s)
        if self.rate_rad_s is not None:
            needed_s = float((np.abs(goal - self.pose) / self.rate_rad_s).max())
            takes_s = max(takes_s, needed_s + _LATE_S)
        return goal, takes_s

    @property
    def is_over(self) -> bool:
        """Say whether the path has been done."""
        return self.path is None or self.path_s >= self.path.total_s - 1e-9

    def ages_s(self, step_s: float) -> List[float]:
        """Return moments after ``t_s`` at which the arm would have to be stopped elsewhere."""
        if self.path is None:
            return [0.0]
        return [float(age) for age in np.arange(0.0, self.horizon_s + 0.5 * step_s, step_s)]
