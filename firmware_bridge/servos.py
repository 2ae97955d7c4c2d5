"""Radians above the bus: poses out, measured poses and the servos' own state in."""

import math
from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.bus import Bus, Priority, Reading, Verdict
from firmware_bridge.codec.protocol import Quantity, ServoFlag, ServoTarget
from firmware_bridge.errors import MotionRefused, NoReply
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.motion import Rhythm
from firmware_bridge.states import MEASURED, JointState

_HOLD_SHARE = 0.3  # of the arm's rate, to come back to a pose that is held
_GRIP_SHARE = 0.5
_MOST_AHEAD_S = 0.04
_CATCH_UP = 1.1  # on top of the speed that arrives in time, for a servo that lags


@dataclass(frozen=True, eq=False)
class Measured:
    """Where the joints stood: ``q_rad (k,)`` and ``speed_rad_s (k,)``, NaN where not ``is_valid``.

    ``t_s`` is the time of the newest answer; ``missing`` are the servos that gave none, ``flags``
    what each servo sent along.
    """

    t_s: float
    q_rad: Array
    speed_rad_s: Array
    is_valid: Array
    missing: Tuple[int, ...]
    flags: Mapping[int, ServoFlag]
    grip_ticks: Optional[int] = None

    def at(self, now_s: float) -> Array:
        """Return where the joints should be a little later (k,), NaN where not measured."""
        ahead_s = min(max(now_s - self.t_s, 0.0), _MOST_AHEAD_S)
        moved = np.where(np.isfinite(self.speed_rad_s), self.speed_rad_s * ahead_s, 0.0)
        result: Array = self.q_rad + moved
        return result

    def state(self, now_s: float, is_moving: bool) -> JointState:
        """Return it as the session tells it."""
        age_s = now_s - self.t_s
        return JointState(
            self.t_s, self.q_rad, is_moving, MEASURED, self.speed_rad_s, age_s, self.is_valid
        )


class Servos:
    """The servos of one arm on a bus; the gripper's holds ``grip_ticks``."""

    def __init__(self, arm: ArmModel, bus: Bus) -> None:
        self.arm = arm
        self.bus = bus
        self.grip_ticks: Optional[int] = None if arm.gripper is None else arm.gripper.closed_ticks
        self.grip_goal: Optional[int] = None  # where the gripper is on its way to
        known = bus.protocol.quantities
        self.has_feedback = bus.protocol.has_feedback and Quantity.POSITION in known
        self.can_verify = self.has_feedback and Quantity.TARGET in known
        self.ignores_place = self._is_stop_blind()  # the protocol's stop needs no positions

    def name_of(self, servo_id: int) -> str:
        """Return the joint of a servo, for messages."""
        if servo_id in self.arm.servo_ids:
            return self.arm.joint_names[self.arm.servo_ids.index(servo_id)]
        return "gripper"

    def send(
        self, pose: Array, duration_s: float, start: Optional[Array] = None
    ) -> Dict[int, Verdict]:
        """Move all joints to a pose (k,) within ``duration_s``, the gripper along.

        From ``start`` (k,) the servos need a certain speed; without it the pose is the end of a
        way, and is read back where a servo can tell at once what it was told.

        Raises
        ------
        LinkLost : the link is gone. MotionRefused : latched, or a tick that no servo takes.
        """
        targets = self._targets(pose, duration_s, start)
        duration_ms = max(1, math.ceil(duration_s * 1000.0 - 1e-6))
        return self.bus.move(targets, duration_ms, start is None and self.can_verify)

    def hold(self, pose: Array) -> None:
        """Stop the servos, at a pose (k,) where the protocol needs to be told.

        Raises
        ------
        LinkLost : the link is gone.
        """
        self.bus.send(self.stop_frames(pose), Priority.STOP)

    def stop_frames(self, pose: Array) -> Tuple[bytes, ...]:
        """Return what stops the servos, () while that would need a pose that is not known."""
        if not np.isfinite(pose).all():
            return self.bus.protocol.stop(()) if self.ignores_place else ()
        ticks = self.arm.ticks(pose)
        at = [ServoTarget(i, int(p)) for i, p in zip(self.arm.servo_ids, ticks)]
        return self.bus.protocol.stop(at)

    def step_grip(self, rhythm: Rhythm, is_alone: bool = True) -> bool:
        """Bring the gripper one tick closer to its goal; say whether it was not there.

        ``is_alone``: send it at once; otherwise it goes along with the next pose.

        Raises
        ------
        LinkLost : the link is gone. MotionRefused : latched.
        """
        gripper, goal, at = self.arm.gripper, self.grip_goal, self.grip_ticks
        if gripper is None or goal is None or at is None or goal == at:
            return False
        rate = float(np.abs(self.arm.ticks_per_rad * self.arm.rate_rad_s).max()) * _GRIP_SHARE
        most = max(1, int(rate * rhythm.tick_s))
        self.grip_ticks = at + min(max(goal - at, -most), most)
        if is_alone:
            target = ServoTarget(gripper.servo_id, self.grip_ticks, max(1, int(rate)))
            is_verified = self.can_verify and self.grip_ticks == goal
            self.bus.move([target], math.ceil(rhythm.horizon_s * 1000.0), is_verified)
        return True

    def write_limits(self, servo_id: int, low: int, high: int) -> None:
        """Store position limits in a servo, where it keeps some.

        Raises
        ------
        LinkLost : the link is gone.
        """
        frames = self.bus.protocol.set_limits(servo_id, low, high)
        if frames:
            self.bus.send(frames, Priority.MOVE)

    def switch(self, is_on: bool, servo_ids: Sequence[int] = ()) -> bool:
        """Switch the torque of all servos, or of some; say whether the protocol can.

        Raises
        ------
        LinkLost : the link is gone.
        """
        frames = self.bus.protocol.torque(tuple(servo_ids) or self.arm.all_ids, is_on)
        if frames:
            self.bus.send(frames, Priority.MOVE if is_on else Priority.STOP)
        return bool(frames)

    def switch_on_here(self, servo_ids: Sequence[int]) -> bool:
        """Switch torque on where each servo stands, so that none jumps to what it was told before.

        Say whether the protocol can.

        Raises
        ------
        NoReply : a servo does not say where it stands; nothing is switched. LinkLost : gone.
        """
        if not self.bus.protocol.torque(tuple(servo_ids), True):
            return False
        found = self.bus.read(Quantity.POSITION, servo_ids)
        silent = [i for i in servo_ids if i not in found]
        if silent:
            raise NoReply(
                f"{self.name_of(silent[0])} (id {silent[0]}) does not say where it stands"
            )
        low, high = self.arm.tick_range
        at = [ServoTarget(i, min(max(found[i].values[0], low), high)) for i in servo_ids]
        self.bus.send(self.bus.protocol.stop(at), Priority.STOP)
        return self.switch(True, servo_ids)

    def measure(self, but: Sequence[int] = (), before: Optional[Measured] = None) -> Measured:
        """Ask all servos for their positions, those in ``but`` left out.

        Raises
        ------
        LinkLost : the link is gone.
        """
        asked = [i for i in self.arm.all_ids if i not in but]
        found = self.bus.read(Quantity.POSITION, asked) if asked else {}
        return self._measured(found, before)

    def commanded_by_board(self) -> Optional[Array]:
        """Return the pose (k,) that the servos or their board were last told, None when unknown.

        Raises
        ------
        LinkLost : the link is gone.
        """
        if Quantity.TARGET not in self.bus.protocol.quantities:
            return None
        found = self.bus.read(Quantity.TARGET, self.arm.servo_ids)
        if any(servo_id not in found for servo_id in self.arm.servo_ids):
            return None
        ticks = np.array([found[i].values[0] for i in self.arm.servo_ids])
        return self.arm.angles_rad(ticks)

    def _measured(self, found: Mapping[int, Reading], before: Optional[Measured]) -> Measured:
        k = self.arm.n_joints
        ticks = np.full(k, np.nan)
        for j, servo_id in enumerate(self.arm.servo_ids):
            if servo_id in found:
                ticks[j] = found[servo_id].values[0]
        q_rad = self.arm.angles_rad(ticks)
        t_s = max((reading.t_s for reading in found.values()), default=math.nan)
        if before is not None and t_s > before.t_s:
            speed = (q_rad - before.q_rad) / (t_s - before.t_s)
        else:
            speed = np.full(k, np.nan)
        missing = tuple(i for i in self.arm.all_ids if i not in found)
        flags = {servo_id: reading.flags for servo_id, reading in found.items()}
        gripper = self.arm.gripper
        grip = found.get(gripper.servo_id) if gripper is not None else None
        grip_ticks = None if grip is None else grip.values[0]
        return Measured(t_s, q_rad, speed, np.isfinite(q_rad), missing, flags, grip_ticks)

    def _targets(self, pose: Array, duration_s: float, start: Optional[Array]) -> List[ServoTarget]:
        ticks = self.arm.ticks(pose)
        exact = self.arm.zero_ticks + self.arm.ticks_per_rad * pose
        if not np.abs(ticks - exact).max() <= 1.0:
            raise MotionRefused(f"servos take {self.arm.tick_range}, the pose needs {exact}")
        gain = np.abs(self.arm.ticks_per_rad)
        rate = gain * self.arm.rate_rad_s
        if start is None:
            speeds = rate * _HOLD_SHARE
        else:
            way = gain * np.abs(pose - start)
            speeds = np.minimum(way / max(duration_s, 1e-3) * _CATCH_UP + 1.0, rate)
        whole = [max(1, math.ceil(speed)) for speed in speeds]
        targets = [ServoTarget(*one) for one in zip(self.arm.servo_ids, ticks.tolist(), whole)]
        if self.arm.gripper is not None and self.grip_ticks is not None:
            grip = ServoTarget(self.arm.gripper.servo_id, self.grip_ticks, int(rate.max()))
            targets.append(grip)
        return targets

    def _is_stop_blind(self) -> bool:
        """Say whether the protocol's stop ignores where the servos stand."""
        low, high = self.arm.tick_range
        ends = [[ServoTarget(i, at) for i in self.arm.servo_ids] for at in (low, high)]
        return self.bus.protocol.stop(ends[0]) == self.bus.protocol.stop(ends[1])
