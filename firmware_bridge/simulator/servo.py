"""One simulated servo, in its protocol's ticks: what the firmware of any protocol drives.

No numpy, no clock: time passes by ``step`` alone.
"""

import math
from typing import Tuple

_SUB_STEP_S = 0.005


class SimServo:
    """A servo that follows a commanded ramp with a rate limit and a first-order lag.

    Parameters
    ----------
    servo_id : its id on the bus; faults may change it.
    at_ticks : where it stands at power-on.
    ticks : lowest and highest position it can take.
    rate_ticks_s : highest speed.
    lag_s : time constant of the first-order lag.
    """

    def __init__(
        self,
        servo_id: int,
        at_ticks: float,
        ticks: Tuple[int, int],
        rate_ticks_s: float,
        lag_s: float = 0.02,
    ) -> None:
        self.servo_id = servo_id
        self.ticks = ticks
        self.rate_ticks_s = rate_ticks_s
        self.lag_s = lag_s
        self.actual = float(at_ticks)  # the shaft, true
        self.target = float(at_ticks)
        self.is_torque_on = True
        self.temperature_c = 30.0
        self.supply_mv = 7400.0
        self.load_permille = 0.0
        self._start = float(at_ticks)
        self._duration_s = 0.0
        self._elapsed_s = 0.0
        self._speed = 0.0

    @property
    def measured(self) -> int:
        """What its sensor says, whole ticks."""
        return int(round(self.actual))

    @property
    def speed_ticks_s(self) -> float:
        """Speed of the shaft over the last step."""
        return self._speed

    def command(self, ticks: float, duration_s: float) -> None:
        """Ramp from the present set-point to ``ticks`` within ``duration_s``."""
        self._start = self.set_point
        self.target = float(ticks)
        self._duration_s, self._elapsed_s = duration_s, 0.0

    def stop(self) -> None:
        """Hold where the shaft is now."""
        self.command(self.actual, 0.0)

    @property
    def set_point(self) -> float:
        """Where the ramp is now."""
        left = self._duration_s - self._elapsed_s
        if left <= 0.0:
            return self.target
        return self._start + (self.target - self._start) * self._elapsed_s / self._duration_s

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass."""
        before = self.actual
        n_steps = max(1, math.ceil(dt_s / _SUB_STEP_S - 1e-9))
        sub_s = dt_s / n_steps
        follow = 1.0 - math.exp(-sub_s / self.lag_s)
        most = self.rate_ticks_s * sub_s
        for _ in range(n_steps):
            self._elapsed_s += sub_s
            if self.is_torque_on:
                error = (self.set_point - self.actual) * follow
                self.actual += min(max(error, -most), most)
        if dt_s > 0.0:
            self._speed = (self.actual - before) / dt_s
