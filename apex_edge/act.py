"""Decision -> way-points -> arm: the last stage, and the only one that moves anything.

Every move goes up before it goes sideways: lift where the arm stands, hover above the goal, come
down. Limits are not checked here but in ``firmware_bridge.guard``, which each path passes.
"""

from dataclasses import dataclass
from typing import List, Optional, Tuple

import numpy as np

from apex_edge.config import setting
from apex_edge.types import ArmAck, ArmCommand, ArmState, Array, Candidates, Decision
from firmware_bridge.errors import LinkLost
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.session import ArmSession, SessionState

_MIN_DURATION_S = 0.02  # one PWM period
_STILL_RAD = 1e-6


@dataclass(frozen=True)
class ActConfig:
    """How the arm travels."""

    rate_share: float = setting(0.9, "share of the arm's highest joint rate", 0.05, 1.0)
    low_m: float = setting(0.05, "a tip below this is lifted before it travels", 0.0, 0.3)
    hover_m: float = setting(0.06, "height to lift to", 0.01, 0.3)


class Actuator:
    """Turn decisions into motion of one arm over a fixed list of candidates."""

    def __init__(
        self,
        session: ArmSession,
        arm: ArmModel,
        candidates: Candidates,
        config: Optional[ActConfig] = None,
    ) -> None:
        self._session = session
        self._arm = arm
        self._candidates = candidates
        self._config = config if config is not None else ActConfig()

    def execute(
        self, decision: Decision, frame_seq: int, t_s: float
    ) -> Tuple[Optional[ArmCommand], Optional[ArmAck]]:
        """Carry out "intervene", "redirect" and "return"; any other action commands nothing.

        Returns
        -------
        the command and what was really sent of it; (None, None) when nothing was asked for.
        """
        start = self._session.read().joints_rad
        if decision.action in ("intervene", "redirect"):
            goal = self._goal(decision)
        elif decision.action == "return":
            goal = self._arm.home_rad[None]
        else:
            return None, None
        if goal is None or not np.isfinite(start).all():
            why = "the goal is out of reach" if goal is None else "the arm's pose is not known"
            nothing = np.zeros((0, self._arm.n_joints)), np.zeros(0)
            command = ArmCommand(frame_seq, t_s, *nothing)
            return command, ArmAck(frame_seq, t_s, float("nan"), False, *nothing, reason=why)
        joints, duration = self._way_points(start, goal)
        command = ArmCommand(frame_seq, t_s, joints, duration)
        report = self._session.move(joints, duration)
        return command, ArmAck(
            frame_seq,
            t_s,
            report.t_sent_s,
            report.is_accepted,
            report.joints_rad,
            report.duration_s,
            report.reason,
        )

    def state(self) -> ArmState:
        """Return where the arm is commanded to be now; the tip is NaN while that is not known."""
        joint = self._session.read()
        tip_m = self._arm.tip(joint.joints_rad)[0]
        return ArmState(joint.t_s, joint.joints_rad, tip_m, joint.is_moving, joint.source)

    def check(self) -> None:
        """Raise when the arm can no longer be commanded.

        Raises
        ------
        LinkLost : the session is in FAULT or ESTOP; it takes a person to leave that.
        """
        if self._session.state in (SessionState.FAULT, SessionState.ESTOP):
            raise LinkLost(f"the arm is in {self._session.state.value}: {self._session.reason}")

    def stop(self) -> None:
        """Hold the arm where it is.

        Raises
        ------
        LinkLost : the board is gone; an arm that lost its host stops within 0.1 s by itself.
        """
        self._session.stop()

    def travel_s(self, candidates: Candidates, state: ArmState) -> Array:
        """Return when the tip would stand at each candidate (n,), in seconds from now.

        Lift, hover, descent and the servos' lag are all in it; inf when the arm cannot move now.
        """
        n = len(candidates.tip_m)
        start = np.asarray(state.joints_rad, dtype=np.float64)
        if not self._session.can_move or not np.isfinite(start).all():
            return np.full(n, np.inf)
        total = np.zeros(n)
        lift = self._lift(start)
        if lift is not None:
            total += self._duration_s(start, lift[None])
            start = lift
        total += self._duration_s(start, candidates.hover_rad)
        total += self._duration_s(candidates.hover_rad, candidates.joints_rad)
        result: Array = np.where(np.isfinite(total), total, np.inf) + self._arm.lag_s
        return result

    def _goal(self, decision: Decision) -> Optional[Array]:
        """Return hover and target joints (2, k), or None when the target cannot be reached."""
        if 0 <= decision.index < len(self._candidates.tip_m):
            i = decision.index
            return np.stack([self._candidates.hover_rad[i], self._candidates.joints_rad[i]])
        if decision.target_m is None:
            return None
        x_m, y_m, z_m = decision.target_m
        points = np.array([[x_m, y_m, max(z_m, self._config.hover_m)], [x_m, y_m, z_m]])
        joints, is_reachable = self._arm.inverse(points)
        return joints if is_reachable.all() else None

    def _lift(self, start: Array) -> Optional[Array]:
        """Return joints (k,) straight above a low tip (home when out of reach), None when high."""
        tip = self._arm.tip(start)[0]
        if tip[2] >= self._config.low_m:
            return None
        joints, is_reachable = self._arm.inverse(np.array([tip[0], tip[1], self._config.hover_m]))
        above: Array = joints[0] if is_reachable[0] else self._arm.home_rad
        return above

    def _way_points(self, start: Array, goal: Array) -> Tuple[Array, Array]:
        """Return the joints (w, k) of the whole way and the duration (w,) of each segment."""
        lift = self._lift(start)
        rows: List[Array] = [start] + ([] if lift is None else [lift]) + list(goal)
        joints = np.stack(rows)
        is_kept = np.abs(np.diff(joints, axis=0)).max(axis=1) > _STILL_RAD
        is_kept[-1] = True  # a move to where the arm stands is still a move
        duration = self._duration_s(joints[:-1], joints[1:])
        return joints[1:][is_kept], np.maximum(duration[is_kept], _MIN_DURATION_S)

    def _duration_s(self, q_from: Array, q_to: Array) -> Array:
        result: Array = self._arm.travel_time_s(q_from, q_to) / self._config.rate_share
        return result
