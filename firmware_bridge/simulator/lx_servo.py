"""One LX servo as its host knows it: registers in EEPROM and RAM around the simulated mechanics.

What nobody here measured is taken the harsh way: a move switches the torque on again, and a
prepared move stays, so that a stray start command runs it once more. Motor mode is kept as a
register and blocks moves, but the shaft does not turn. Source: vendor protocol text.
"""

from typing import Dict, Optional, Tuple

from firmware_bridge.codec import lx
from firmware_bridge.codec.protocol import ServoFlag
from firmware_bridge.simulator.physics import PLAIN
from firmware_bridge.simulator.servo import SimServo

TICKS = (0, 1000)
MAX_MS = 30000
_BITS = {ServoFlag.OVERHEAT: 1, ServoFlag.VOLTAGE: 2, ServoFlag.STALL: 4}


class LxServo:
    """One servo. ``commanded`` is the target it last set out for, as its limits left it.

    EEPROM: id, ``limits``, ``vin_limits_mv``, ``temp_max_c``, the saved offset, ``led_errors``.
    RAM: ``offset``, ``last_move``, ``prepared``, ``mode``, ``is_led_off``.
    """

    def __init__(self, servo: SimServo) -> None:
        self.servo = servo
        self.commanded: Optional[int] = None
        self.limits = TICKS
        self.vin_limits_mv: Tuple[int, int] = (4500, 12000)
        self.temp_max_c = 85
        self.led_errors = 7
        self.offset = 0
        self.last_move: Tuple[int, int] = (0, 0)
        self.prepared: Optional[Tuple[int, int]] = None
        self.mode: Tuple[int, int, int] = (0, 0, 0)
        self.is_led_off = False
        self._saved_offset = 0
        servo.on_reset = self._restore
        if servo.physics is not PLAIN:
            self._tell_mechanics()

    @property
    def errors(self) -> int:
        """What is wrong, as LED error bits: 1 temperature, 2 supply, 4 stall."""
        flags = self.servo.flags
        return sum(bit for flag, bit in _BITS.items() if flags & flag)

    @property
    def is_alarm_on(self) -> bool:
        """Say whether its LED blinks."""
        return bool(self.errors & self.led_errors)

    @property
    def measured(self) -> int:
        """What its sensor says, less the offset."""
        return self.servo.measured - self.offset

    def move(self, position: int, duration_ms: int) -> bool:
        """Set out for a position as far as range and limits let it; say whether they did."""
        if self.mode[0]:
            return True
        low, high = self.limits
        kept = min(max(position, low), high)
        duration_ms = min(duration_ms, MAX_MS)
        self.last_move = (kept, duration_ms)
        self.commanded = kept
        self.servo.is_torque_on = True
        self.servo.command(kept + self.offset, duration_ms / 1000.0)
        return kept == position

    def prepare(self, position: int, duration_ms: int) -> None:
        """Keep a move for the start command."""
        self.prepared = (min(max(position, TICKS[0]), TICKS[1]), min(duration_ms, MAX_MS))

    def start(self) -> None:
        """Run the prepared move, if there is one."""
        if self.prepared is not None:
            self.move(*self.prepared)

    def set_torque(self, is_on: bool) -> None:
        """Switch the torque; when it comes on, the shaft stays where it is."""
        if is_on and not self.servo.is_torque_on:
            self.servo.stop()
        self.servo.is_torque_on = is_on

    def set_limits(self, low: int, high: int) -> bool:
        """Store position limits; nothing when they are none."""
        return self._store("limits", low, high, TICKS)

    def set_vin_limits(self, low_mv: int, high_mv: int) -> bool:
        """Store supply limits; nothing when they are none."""
        return self._store("vin_limits_mv", low_mv, high_mv, (4500, 12000))

    def set_temp_max(self, temperature_c: int) -> bool:
        """Store the temperature at which it drops its torque; nothing when it is none."""
        is_right = 50 <= temperature_c <= 100
        if is_right:
            self.temp_max_c = temperature_c
            self._tell_mechanics()
        return is_right

    def set_offset(self, offset: int) -> bool:
        """Shift its zero until the next reset; the shaft follows."""
        if not -125 <= offset <= 125:
            return False
        shift, self.offset = offset - self.offset, offset
        if self.servo.is_torque_on and shift:
            self.servo.command(self.servo.target + shift, 0.0)
        return True

    def save_offset(self) -> None:
        """Keep the shift for good."""
        self._saved_offset = self.offset

    def read(self, command: int) -> Tuple[int, ...]:
        """Return the values that answer a read command."""
        servo = self.servo
        values: Dict[int, Tuple[int, ...]] = {
            lx.MOVE_TIME_READ: self.last_move,
            lx.MOVE_TIME_WAIT_READ: self.prepared or (0, 0),
            lx.ID_READ: (servo.servo_id,),
            lx.OFFSET_READ: (self.offset,),
            lx.ANGLE_LIMIT_READ: self.limits,
            lx.VIN_LIMIT_READ: self.vin_limits_mv,
            lx.TEMP_MAX_READ: (self.temp_max_c,),
            lx.TEMP_READ: (int(round(servo.temperature_c)),),
            lx.VIN_READ: (int(round(servo.supply_mv)),),
            lx.POS_READ: (self.measured,),
            lx.MODE_READ: self.mode,
            lx.TORQUE_READ: (int(servo.is_torque_on),),
            lx.LED_READ: (int(self.is_led_off),),
            lx.LED_ERROR_READ: (self.led_errors,),
        }
        fields = lx.REPLIES[command].fields
        return tuple(min(max(v, f.low), f.high) for v, f in zip(values[command], fields))

    def _store(self, name: str, low: int, high: int, bounds: Tuple[int, int]) -> bool:
        is_right = bounds[0] <= low < high <= bounds[1]
        if is_right:
            setattr(self, name, (low, high))
            self._tell_mechanics()
        return is_right

    def _tell_mechanics(self) -> None:
        low_mv, high_mv = self.vin_limits_mv
        self.servo.limits_mv = (float(low_mv), float(high_mv))
        self.servo.max_temperature_c = float(self.temp_max_c)

    def _restore(self) -> None:
        """Start again: EEPROM stays, RAM is lost."""
        self.offset = self._saved_offset
        self.last_move = (0, 0)
        self.prepared = None
        self.mode = (0, 0, 0)
        self.is_led_off = False
