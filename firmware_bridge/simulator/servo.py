"""One simulated servo, in its protocol's ticks: what the firmware of any protocol drives.

No numpy, no clock: time passes by ``step`` alone.
"""

import math
import random
from typing import Callable, Dict, Optional, Tuple

from firmware_bridge.codec.protocol import ServoFlag
from firmware_bridge.simulator.physics import PLAIN, Physics, Supply

_SUB_STEP_S = 0.005
_FULL_PERMILLE = 1000.0
_NEARLY_FULL_PERMILLE = 950.0

Listener = Callable[["SimServo", str, Dict[str, float]], None]
"""(servo, what it did, with which numbers); see ``SimServo.on_event``."""


class SimServo:
    """A servo that follows a commanded ramp with a rate limit, a first-order lag and ``physics``.

    Faults and protocols set these: ``servo_id``; ``is_stuck`` (the shaft does not turn);
    ``is_dead`` (no power inside: limp and silent); ``is_deaf`` (the line is at another baud than
    its own); ``block_ticks`` (obstacles the shaft cannot pass); ``temperature_c``, ``supply_mv``,
    ``max_temperature_c``, ``limits_mv``. What it does not hear it does not do.

    ``on_reset`` lets a protocol's register file restore RAM from EEPROM. ``on_event`` is told of
    every executed command: ("move", ticks and duration_s), ("stop"), ("torque", is_on), and of
    ("reset"), ("overheat"), ("cool").

    Parameters
    ----------
    servo_id : its id on the bus.
    at_ticks : where it stands at power-on.
    ticks : lowest and highest position it can take.
    rate_ticks_s : highest speed.
    lag_s : time constant of the first-order lag.
    physics, supply : what it is made of, and the battery it shares with others.
    rng : noise of its sensor; without one there is none.
    """

    def __init__(  # noqa: PLR0913 - all but the first four are switches
        self,
        servo_id: int,
        at_ticks: float,
        ticks: Tuple[int, int],
        rate_ticks_s: float,
        lag_s: float = 0.02,
        physics: Physics = PLAIN,
        supply: Optional[Supply] = None,
        rng: Optional[random.Random] = None,
    ) -> None:
        self.servo_id = servo_id
        self.ticks = ticks
        self.rate_ticks_s = rate_ticks_s
        self.lag_s = lag_s
        self.physics = physics
        self.temperature_c = 30.0
        self.supply_mv = 7400.0 if supply is None else supply.nominal_mv
        self.load_permille = 0.0  # positive: it pushes to more ticks
        self.max_temperature_c = physics.max_temperature_c
        self.limits_mv = physics.limits_mv
        self.is_stuck = self.is_dead = self.is_deaf = False
        self.block_ticks: Optional[Tuple[float, float]] = None
        self.on_reset: Optional[Callable[[], None]] = None
        self.on_event: Optional[Listener] = None
        self.n_resets = 0
        self._supply, self._rng = supply, rng
        self._place = 0 if supply is None else supply.attach()
        self._motor = self._shaft = float(at_ticks)
        self._wants_torque = True
        self._is_hot = self._is_blocked = False
        self._boot_left_s = self._stalled_s = 0.0
        self.target = float(at_ticks)
        self._start = float(at_ticks)
        self._duration_s = 0.0
        self._elapsed_s = 0.0
        self._speed = 0.0

    @property
    def actual(self) -> float:
        """Where the shaft is, true ticks; setting it turns the shaft by hand."""
        return self._shaft

    @actual.setter
    def actual(self, ticks: float) -> None:
        self._motor = self._shaft = ticks

    @property
    def measured(self) -> int:
        """What its sensor says, whole ticks; with noise, each look is another."""
        noise_ticks = self.physics.noise_ticks
        if self._rng is None or noise_ticks <= 0.0:
            return int(round(self._shaft))
        return int(round(self._shaft + self._rng.gauss(0.0, noise_ticks)))

    @property
    def speed_ticks_s(self) -> float:
        """Speed of the shaft over the last step."""
        return self._speed

    @property
    def current_ma(self) -> float:
        """Current it draws."""
        physics = self.physics
        share = abs(self.load_permille) / _FULL_PERMILLE
        return physics.idle_ma + (physics.stall_ma - physics.idle_ma) * share

    @property
    def is_answering(self) -> bool:
        """Say whether it hears and answers: alive, booted and at the baud of the line."""
        return not (self.is_dead or self.is_deaf or self._boot_left_s > 0.0)

    @property
    def is_stalled(self) -> bool:
        """Say whether it has been at full torque without getting there for too long."""
        return self.physics.stall_s > 0.0 and self._stalled_s > self.physics.stall_s

    @property
    def flags(self) -> ServoFlag:
        """What is wrong with it, true."""
        low_mv, high_mv = self.limits_mv
        flags = ServoFlag.NONE
        if not low_mv <= self.supply_mv <= high_mv:
            flags |= ServoFlag.VOLTAGE
        if self._is_hot:
            flags |= ServoFlag.OVERHEAT
        if self.is_stalled:
            flags |= ServoFlag.STALL
        return flags

    @property
    def is_torque_on(self) -> bool:
        """Say whether its motor pulls: switched on, powered and not too hot."""
        return self._wants_torque and not (self._is_hot or self.is_dead or self._boot_left_s > 0.0)

    @is_torque_on.setter
    def is_torque_on(self, is_on: bool) -> None:
        if not self.is_answering or (self._is_hot and not self.physics.is_back_when_cool):
            return
        is_new = is_on != self._wants_torque
        self._wants_torque = is_on
        if is_new:
            self._tell("torque", is_on=float(is_on))

    def command(self, ticks: float, duration_s: float) -> None:
        """Ramp from the present set-point to ``ticks`` within ``duration_s``."""
        if self.is_answering:
            self._ramp(ticks, duration_s)
            self._tell("move", ticks=float(ticks), duration_s=duration_s)

    def stop(self) -> None:
        """Hold where the shaft is now."""
        if self.is_answering:
            self._ramp(self._shaft, 0.0)
            self._tell("stop")

    def reset(self, boot_s: Optional[float] = None) -> None:
        """Lose the RAM as at a power failure: no target, no torque, deaf until it has booted.

        Parameters
        ----------
        boot_s : how long that takes; its own boot time by default.
        """
        self.n_resets += 1
        self._ramp(self._shaft, 0.0)
        self._wants_torque = not self.physics.is_limp_at_boot
        self._boot_left_s = self.physics.boot_s if boot_s is None else boot_s
        self._is_hot = False
        self._stalled_s = 0.0
        if self.on_reset is not None:
            self.on_reset()
        self._tell("reset")

    @property
    def set_point(self) -> float:
        """Where the ramp is now."""
        left = self._duration_s - self._elapsed_s
        if left <= 0.0:
            return self.target
        return self._start + (self.target - self._start) * self._elapsed_s / self._duration_s

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass."""
        before = self._shaft
        self._watch_supply()
        self._watch_heat()
        n_steps = max(1, math.ceil(dt_s / _SUB_STEP_S - 1e-9))
        sub_s = dt_s / n_steps
        follow = 1.0 - math.exp(-sub_s / self.lag_s)
        most = self.rate_ticks_s * sub_s
        is_simple = self.physics is PLAIN and not self.is_stuck and self.block_ticks is None
        for _ in range(n_steps):
            self._elapsed_s += sub_s
            if not is_simple:
                self._turn(sub_s, follow, most)
            elif self.is_torque_on:
                error = (self.set_point - self._shaft) * follow
                self._shaft += min(max(error, -most), most)
        if is_simple:
            self._motor, self._stalled_s = self._shaft, 0.0
        self._boot_left_s = max(0.0, self._boot_left_s - dt_s)
        if dt_s > 0.0:
            self._speed = (self._shaft - before) / dt_s

    def _ramp(self, ticks: float, duration_s: float) -> None:
        self._start = self.set_point
        self.target = float(ticks)
        self._duration_s, self._elapsed_s = duration_s, 0.0

    def _turn(self, dt_s: float, follow: float, most: float) -> None:
        """Turn the motor, then the shaft through the play, and work out load and heat."""
        physics = self.physics
        weight = self._weight_permille()
        if self.is_torque_on:
            goal = self.set_point + physics.sag_ticks * weight / _FULL_PERMILLE
            wish = min(max((goal - self._motor) * follow, -most), most)
        else:
            falling = max(0.0, abs(weight) - physics.friction_permille) / _FULL_PERMILLE
            wish = math.copysign(falling * most, weight)
        moved = self._move_motor(wish)
        self._shaft = self._through_play(weight)
        self.load_permille = self._load(weight, moved / most if most > 0.0 else 0.0)
        is_at_end = abs(self.load_permille) >= _NEARLY_FULL_PERMILLE or self.is_stalled
        self._stalled_s = self._stalled_s + dt_s if self._is_blocked and is_at_end else 0.0
        if physics.heat_c_s > 0.0:
            heat = physics.heat_c_s * (self.load_permille / _FULL_PERMILLE) ** 2
            cooling = (self.temperature_c - physics.ambient_c) / physics.cool_s
            self.temperature_c += (heat - cooling) * dt_s

    def _move_motor(self, wish: float) -> float:
        before = self._motor
        after = before if self.is_stuck else before + wish
        if self.block_ticks is not None:
            low, high = self.block_ticks
            after = min(max(after, min(low, before)), max(high, before))
        self._motor = after
        gap = abs(self.set_point - after)
        span = self.ticks[1] - self.ticks[0]
        was_held = after != before + wish
        self._is_blocked = was_held and gap > self.physics.stall_share * span
        return after - before

    def _through_play(self, weight: float) -> float:
        """Return where the shaft is: its weight leans on one side of the play, if it has any."""
        half = 0.5 * self.physics.backlash_ticks
        if weight != 0.0:
            return self._motor + math.copysign(half, weight)
        return min(max(self._shaft, self._motor - half), self._motor + half)

    def _weight_permille(self) -> float:
        physics = self.physics
        if physics.ticks_per_rad == 0.0:
            return physics.gravity_permille
        angle_rad = (self._motor - physics.level_ticks) / physics.ticks_per_rad
        return physics.gravity_permille * math.cos(angle_rad)

    def _load(self, weight: float, speed_share: float) -> float:
        """Return the torque its motor gives, signed, in thousandths of the largest."""
        if not self.is_torque_on:
            return 0.0
        if not self._is_blocked:
            load = self.physics.friction_permille * speed_share - weight
            return min(max(load, -_FULL_PERMILLE), _FULL_PERMILLE)
        most = self.physics.stall_permille if self.is_stalled else _FULL_PERMILLE
        return math.copysign(most, self.set_point - self._motor)

    def _watch_heat(self) -> None:
        if self._is_hot:
            if self.temperature_c < self.max_temperature_c - self.physics.hysteresis_c:
                self._is_hot = False
                self._tell("cool")
        elif self.temperature_c >= self.max_temperature_c:
            self._is_hot = True
            if not self.physics.is_back_when_cool:
                self._wants_torque = False
            self._tell("overheat")

    def _watch_supply(self) -> None:
        if self._supply is not None:
            self.supply_mv = self._supply.report(self._place, self.load_permille)
        if self.supply_mv >= self.physics.brown_out_mv:
            return
        if self._boot_left_s > 0.0:  # it cannot boot until the supply is back
            self._boot_left_s = self.physics.boot_s
        else:
            self.load_permille = 0.0
            self.reset()

    def _tell(self, what: str, **numbers: float) -> None:
        if self.on_event is not None:
            self.on_event(self, what, numbers)
