"""An RRC board with PWM servos and bus servos, simulated from the bytes up.

It does what stock firmware does: drops frames whose CRC is wrong, ignores PWM servos it does not
have, keeps pulses within 500..2500 us, answers a PWM position request with the last command (PWM
servos cannot be measured), says so when a bus servo does not answer, and has no watchdog.
"""

import math
from typing import Dict, List, Optional, Sequence, Tuple

from firmware_bridge.codec import lx, rrc, rrc_frames
from firmware_bridge.errors import ProtocolError
from firmware_bridge.simulator.board import Board
from firmware_bridge.simulator.lx_servo import LxServo
from firmware_bridge.simulator.servo import SimServo

PULSES_US = (500, 2500)
_BATTERY_EVERY_S = 1.0
_READS: Dict[int, int] = {
    rrc.BUS_POSITION: lx.POS_READ,
    rrc.BUS_VIN: lx.VIN_READ,
    rrc.BUS_TEMPERATURE: lx.TEMP_READ,
    rrc.BUS_TORQUE: lx.TORQUE_READ,
    rrc.BUS_ID: lx.ID_READ,
    rrc.BUS_OFFSET: lx.OFFSET_READ,
    rrc.BUS_LIMITS: lx.ANGLE_LIMIT_READ,
    rrc.BUS_VIN_LIMITS: lx.VIN_LIMIT_READ,
    rrc.BUS_TEMP_LIMIT: lx.TEMP_MAX_READ,
}
BusWrite = (
    rrc.BusTorque, rrc.BusSetId, rrc.BusOffset, rrc.BusSaveOffset, rrc.BusLimits,
    rrc.BusVinLimits, rrc.BusTempLimit,
)  # fmt: skip


class RrcBoard(Board):
    """A board at 1 Mbaud; see ``Board`` for the counts.

    ``n_signals`` counts orders to LED and buzzer. ``battery_mv``, pushed once a second, is the
    supply of the first servo unless it is set.

    Parameters
    ----------
    pwm, bus : its PWM servos (ticks are us) and its bus servos.
    """

    def __init__(self, pwm: Sequence[SimServo] = (), bus: Sequence[SimServo] = ()) -> None:
        super().__init__((*pwm, *bus), rrc_frames.device_parser(), rrc_frames.BAUD)
        self.n_signals = 0
        self._pwm = list(pwm)
        self._bus: List[LxServo] = [LxServo(servo) for servo in bus]
        self._commanded: Dict[int, int] = {}
        self._offsets: Dict[int, int] = {}
        self._battery_mv: Optional[int] = None

    @property
    def n_bad_crc(self) -> int:
        """Frames dropped for their CRC."""
        return self.n_bad

    @property
    def commanded(self) -> Dict[int, int]:
        """Id -> the target it last set out for, of those that were sent somewhere."""
        told = {m.servo.servo_id: m.commanded for m in self._bus if m.commanded is not None}
        return {**self._commanded, **told}

    @property
    def members(self) -> List[LxServo]:
        """Its bus servos."""
        return self._bus

    @property
    def battery_mv(self) -> int:
        """Supply voltage."""
        if self._battery_mv is not None:
            return self._battery_mv
        return int(round(self.servos[0].supply_mv)) if self.servos else 0

    @battery_mv.setter
    def battery_mv(self, millivolt: int) -> None:
        self._battery_mv = millivolt

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass and push the battery voltage when it is time."""
        before = math.floor(self.t_s / _BATTERY_EVERY_S)
        super().step(dt_s)
        if math.floor(self.t_s / _BATTERY_EVERY_S) > before:
            self.answer(rrc.encode(rrc.Battery(min(max(self.battery_mv, 0), 0xFFFF))))

    def obey(self, frame: bytes) -> None:
        """Carry out a checked frame.

        Raises
        ------
        ProtocolError : an unknown command, or values a servo does not take.
        """
        message = rrc.decode_to_board(frame)
        if isinstance(message, rrc.PwmMove):
            for servo_id, pulse_us in message.targets:
                self._set_pulse(servo_id, pulse_us, message.duration_ms)
        elif isinstance(message, rrc.PwmMoveOne):
            self._set_pulse(message.servo_id, message.pulse_us, message.duration_ms)
        elif isinstance(message, (rrc.PwmPositionRequest, rrc.PwmOffsetRequest, rrc.PwmOffset)):
            self._obey_pwm(message)
        elif isinstance(message, (rrc.Led, rrc.Buzzer)):
            self.n_signals += 1
        else:
            self._obey_bus(message)

    def _set_pulse(self, servo_id: int, pulse_us: int, duration_ms: int) -> None:
        servo = self._pwm_servo(servo_id)
        if servo is None:
            self.n_rejected += 1
            return
        low, high = PULSES_US
        kept = min(max(pulse_us, low), high)
        self.n_clamped += kept != pulse_us
        self._commanded[servo_id] = kept
        servo.command(kept + self._offsets.get(servo_id, 0), duration_ms / 1000.0)

    def _obey_pwm(self, message: Tuple[int, ...]) -> None:
        servo_id = message[0]
        servo = self._pwm_servo(servo_id)
        if servo is None:
            return
        offset_us = self._offsets.get(servo_id, 0)
        if isinstance(message, rrc.PwmOffset):
            self._offsets[servo_id] = min(max(message.offset_us, -100), 100)
        elif isinstance(message, rrc.PwmOffsetRequest):
            self.answer(rrc.encode(rrc.PwmOffsetReply(servo_id, offset_us)))
        else:
            cached = self._commanded.get(servo_id, int(servo.target))
            self.answer(rrc.encode(rrc.PwmPosition(servo_id, cached)))

    def _obey_bus(self, message: rrc.ToBoard) -> None:
        if isinstance(message, rrc.BusMove):
            for servo_id, position in message.targets:
                members = self._bus_servos(servo_id)
                self.n_rejected += not members
                for member in members:
                    self.n_clamped += not member.move(position, message.duration_ms)
        elif isinstance(message, rrc.BusStop):
            for servo_id in message.servo_ids:
                for member in self._bus_servos(servo_id):
                    member.servo.stop()
        elif isinstance(message, rrc.BusRead):
            self._tell(message)
        elif isinstance(message, BusWrite):
            for member in self._bus_servos(message[0]):
                if not _configure(member, message):
                    raise ProtocolError(f"bus servos do not take {message}")

    def _tell(self, message: rrc.BusRead) -> None:
        """Answer for a bus servo: with its values, or that it did not answer."""
        members = self._bus_servos(message.servo_id)
        n_values = len(lx.REPLIES[_READS[message.what]].fields)
        values = members[0].read(_READS[message.what]) if members else (0,) * n_values
        self.answer(rrc.encode(rrc.BusReply(message.servo_id, message.what, bool(members), values)))

    def _pwm_servo(self, servo_id: int) -> Optional[SimServo]:
        return next((servo for servo in self._pwm if servo.servo_id == servo_id), None)

    def _bus_servos(self, servo_id: int) -> List[LxServo]:
        return [m for m in self._bus if m.servo.servo_id == servo_id and m.servo.is_answering]


class RrcBusBoard(RrcBoard):
    """A board with bus servos alone."""

    def __init__(self, bus: Sequence[SimServo]) -> None:
        super().__init__((), bus)


def _configure(member: LxServo, message: Tuple[int, ...]) -> bool:
    """Pass a setting on to a bus servo; say whether it takes it."""
    if isinstance(message, rrc.BusTorque):
        member.set_torque(message.is_on)
    elif isinstance(message, rrc.BusSaveOffset):
        member.save_offset()
    elif isinstance(message, rrc.BusSetId):
        if not 0 <= message.new_servo_id <= lx.MAX_ID:
            return False
        member.servo.servo_id = message.new_servo_id
    elif isinstance(message, rrc.BusOffset):
        return member.set_offset(message.offset)
    elif isinstance(message, rrc.BusLimits):
        return member.set_limits(message.low, message.high)
    elif isinstance(message, rrc.BusVinLimits):
        return member.set_vin_limits(message.low_mv, message.high_mv)
    elif isinstance(message, rrc.BusTempLimit):
        return member.set_temp_max(message.temperature_c)
    return True
