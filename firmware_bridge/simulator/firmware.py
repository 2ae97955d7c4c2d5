"""An RRC board with PWM servos, simulated from the bytes up.

The arm moves because of decoded frames and for no other reason. Each servo follows the board's
linear interpolation with a rate limit and a first-order lag. Pure: no clock, no I/O.
"""

import math
from typing import Optional

import numpy as np

from apex_edge.types import Array
from firmware_bridge.codec import rrc, rrc_frames
from firmware_bridge.errors import ProtocolError
from firmware_bridge.kinematics import PULSE_MAX_US, PULSE_MIN_US, ArmModel
from firmware_bridge.simulator.base import Firmware

_SUB_STEP_S = 0.005
_BATTERY_EVERY_S = 1.0


class RrcFirmware(Firmware):
    """The board of one arm: bytes in, bytes out, simulated servo angles.

    It does what stock firmware does: drops frames whose CRC is wrong, ignores servos it does not
    have, keeps pulses within 500..2500 us, answers a position request with the last command (PWM
    servos cannot be measured) and has no watchdog. ``at_rad`` is where the servos stand at power-on
    (home by default). Counts: ``n_frames``, ``n_bad_crc``, ``n_rejected``, ``n_clamped``.
    """

    def __init__(
        self, arm: ArmModel, at_rad: Optional[Array] = None, battery_mv: int = 7400
    ) -> None:
        self._arm = arm
        self._ids = arm.all_ids
        self._parser = rrc_frames.device_parser()
        self._replies = bytearray()
        self.battery_mv = battery_mv
        self.n_rejected = 0
        self.n_clamped = 0
        self.t_s = 0.0
        self.baud = 1_000_000
        pose = arm.home_rad if at_rad is None else np.asarray(at_rad, dtype=np.float64)
        closed = [] if arm.gripper is None else [arm.gripper.closed_ticks]
        self._actual_us = np.append(arm.ticks(pose), closed).astype(np.float64)
        self._start_us = self._actual_us.copy()
        self._target_us = self._actual_us.copy()
        self._duration_s = np.zeros(len(self._ids))
        self._elapsed_s = np.zeros(len(self._ids))
        rate = np.abs(arm.ticks_per_rad) * arm.rate_rad_s
        fastest = np.abs(arm.ticks_per_rad).max() * arm.rate_rad_s.max()
        self._rate_us_s = np.append(rate, [fastest] * len(closed))

    @property
    def n_frames(self) -> int:
        """Well-formed frames taken so far."""
        return self._parser.n_frames

    @property
    def n_bad_crc(self) -> int:
        """Frames dropped for their CRC."""
        return self._parser.n_bad

    @property
    def joints_rad(self) -> Array:
        """True simulated joint angles (k,)."""
        return self._arm.angles_rad(self._actual_us[: self._arm.n_joints])

    @property
    def set_points_rad(self) -> Array:
        """Where the board's interpolation is for each joint now (k,)."""
        return self._arm.angles_rad(self._commanded_us()[: self._arm.n_joints])

    @property
    def points_m(self) -> Array:
        """True shoulder, elbow, wrist and tip (4, 3) in metres."""
        points: Array = self._arm.forward(self.joints_rad)[0]
        return points

    @property
    def gripper_us(self) -> float:
        """True simulated gripper, as a pulse."""
        return float(self._actual_us[-1])

    def feed(self, data: bytes) -> None:
        """Take bytes from the wire, in any chunks."""
        for frame in self._parser.feed(data):
            try:
                self._obey(rrc.decode_to_board(frame))
            except ProtocolError:
                self.n_rejected += 1

    def replies(self) -> bytes:
        """Return and forget the bytes the board has sent."""
        data = bytes(self._replies)
        self._replies.clear()
        return data

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass: interpolate, move the servos, push the battery voltage."""
        n_steps = max(1, math.ceil(dt_s / _SUB_STEP_S - 1e-9))
        sub_s = dt_s / n_steps
        follow = 1.0 - math.exp(-sub_s / self._arm.servo_time_constant_s)
        most_us = self._rate_us_s * sub_s
        for _ in range(n_steps):
            self._elapsed_s += sub_s
            error = self._commanded_us() - self._actual_us
            self._actual_us += np.clip(error * follow, -most_us, most_us)
        before = math.floor(self.t_s / _BATTERY_EVERY_S)
        self.t_s += dt_s
        if math.floor(self.t_s / _BATTERY_EVERY_S) > before:
            self._replies += rrc.encode(rrc.Battery(self.battery_mv))

    def _commanded_us(self) -> Array:
        """Return where the board's interpolation is now, (k + 1,) in microseconds."""
        left = self._duration_s - self._elapsed_s
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(left > 0.0, self._elapsed_s / self._duration_s, 1.0)
        result: Array = self._start_us + (self._target_us - self._start_us) * share
        return result

    def _obey(self, message: rrc.ToBoard) -> None:
        if isinstance(message, rrc.PwmMove):
            for servo_id, pulse_us in message.targets:
                self._set_target(servo_id, pulse_us, message.duration_ms)
        elif isinstance(message, rrc.PwmMoveOne):
            self._set_target(message.servo_id, message.pulse_us, message.duration_ms)
        elif isinstance(message, rrc.PwmPositionRequest) and message.servo_id in self._ids:
            cached = int(self._target_us[self._ids.index(message.servo_id)])
            self._replies += rrc.encode(rrc.PwmPosition(message.servo_id, cached))

    def _set_target(self, servo_id: int, pulse_us: int, duration_ms: int) -> None:
        if servo_id not in self._ids:
            self.n_rejected += 1
            return
        at = self._ids.index(servo_id)
        kept = min(max(pulse_us, PULSE_MIN_US), PULSE_MAX_US)
        self.n_clamped += kept != pulse_us
        self._start_us[at] = self._commanded_us()[at]
        self._target_us[at] = kept
        self._duration_s[at] = duration_ms / 1000.0
        self._elapsed_s[at] = 0.0
