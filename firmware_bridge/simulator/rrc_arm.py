"""A whole arm of PWM servos on an RRC board: the arm moves because of decoded frames alone."""

from typing import Optional

import numpy as np

from apex_edge.types import Array
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.simulator.rrc_board import PULSES_US, RrcBoard
from firmware_bridge.simulator.servo import SimServo


class RrcFirmware(RrcBoard):
    """The board of one arm; ``at_rad`` is where it stands at power-on (home by default)."""

    def __init__(
        self, arm: ArmModel, at_rad: Optional[Array] = None, battery_mv: int = 7400
    ) -> None:
        pose = arm.home_rad if at_rad is None else np.asarray(at_rad, dtype=np.float64)
        gain = np.abs(arm.ticks_per_rad)
        rates = list(gain * arm.rate_rad_s)
        places = list(arm.ticks(pose))
        if arm.gripper is not None:
            rates.append(gain.max() * arm.rate_rad_s.max())
            places.append(arm.gripper.closed_ticks)
        super().__init__(
            [
                SimServo(servo_id, float(at), PULSES_US, float(rate), arm.servo_time_constant_s)
                for servo_id, at, rate in zip(arm.all_ids, places, rates)
            ]
        )
        self._arm = arm
        self.battery_mv = battery_mv

    @property
    def joints_rad(self) -> Array:
        """True simulated joint angles (k,)."""
        actual_us = [servo.actual for servo in self.servos[: self._arm.n_joints]]
        return self._arm.angles_rad(np.array(actual_us))

    @property
    def set_points_us(self) -> Array:
        """Where the board's interpolation is now, joints and gripper (k + 1,)."""
        return np.array([servo.set_point for servo in self.servos])

    @property
    def points_m(self) -> Array:
        """True shoulder, elbow, wrist and tip (4, 3) in metres."""
        points: Array = self._arm.forward(self.joints_rad)[0]
        return points

    @property
    def gripper_us(self) -> float:
        """True simulated gripper, as a pulse; the last joint where there is no gripper."""
        return self.servos[-1].actual
