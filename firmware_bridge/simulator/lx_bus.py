"""LX servos on one half-duplex line, simulated from the bytes up.

Writes are not acknowledged. Broadcasts are obeyed by all and answered by none, but for the question
after the id: there all answer at once, and several answers spoil each other.
"""

from typing import Dict, List, Sequence

from firmware_bridge.codec import lx
from firmware_bridge.errors import ProtocolError
from firmware_bridge.simulator.board import Board
from firmware_bridge.simulator.lx_servo import LxServo
from firmware_bridge.simulator.servo import SimServo


class LxBus(Board):
    """Servos on one line at 115200 baud; see ``Board`` for the counts."""

    def __init__(self, servos: Sequence[SimServo]) -> None:
        super().__init__(servos, lx.device_parser(), lx.BAUD)
        self.members: List[LxServo] = [LxServo(servo) for servo in self.servos]

    @property
    def commanded(self) -> Dict[int, int]:
        """Id -> the target it last set out for, of those that were sent somewhere."""
        return {m.servo.servo_id: m.commanded for m in self.members if m.commanded is not None}

    def obey(self, frame: bytes) -> None:
        """Carry out a checked frame.

        Raises
        ------
        ProtocolError : an unknown command, or values it does not take.
        """
        message = lx.decode_command(frame)
        is_to_all = message.servo_id == lx.BROADCAST
        heard = [m for m in self.members if self._hears(m, message.servo_id)]
        if message.command not in lx.REPLIES:
            for member in heard:
                self._write(member, message)
        elif not is_to_all:
            for member in heard:
                self.answer(_reply(member, message.command))
        elif message.command == lx.ID_READ and heard:
            answers = [_reply(member, lx.ID_READ) for member in heard]
            self.answer(bytes(_low(values) for values in zip(*answers)))

    def _hears(self, member: LxServo, servo_id: int) -> bool:
        servo = member.servo
        return servo.is_answering and servo_id in (servo.servo_id, lx.BROADCAST)

    def _write(self, member: LxServo, message: lx.Message) -> None:
        command, values = message.command, message.values
        if command == lx.MOVE_TIME_WRITE:
            self.n_clamped += not member.move(*values)
        elif command == lx.MOVE_TIME_WAIT_WRITE:
            member.prepare(*values)
        elif command == lx.MOVE_START:
            member.start()
        elif command == lx.MOVE_STOP:
            member.servo.stop()
        elif command == lx.OFFSET_WRITE:
            member.save_offset()
        elif command == lx.TORQUE_WRITE:
            member.set_torque(bool(values[0]))
        elif command == lx.LED_WRITE:
            member.is_led_off = bool(values[0])
        elif not self._configure(member, message):
            raise ProtocolError(f"command {command} does not take {values}")

    def _configure(self, member: LxServo, message: lx.Message) -> bool:
        """Store a setting; say whether the servo takes it."""
        command, values = message.command, message.values
        if command == lx.ANGLE_LIMIT_WRITE:
            return member.set_limits(*values)
        if command == lx.VIN_LIMIT_WRITE:
            return member.set_vin_limits(*values)
        if command == lx.TEMP_MAX_WRITE:
            return member.set_temp_max(*values)
        if command == lx.OFFSET_ADJUST:
            return member.set_offset(*values)
        try:
            lx.encode_command(message)  # the rest has no limits but those of the command itself
        except ProtocolError:
            return False
        if command == lx.ID_WRITE:
            member.servo.servo_id = values[0]
        elif command == lx.LED_ERROR_WRITE:
            member.led_errors = values[0]
        elif command == lx.MODE_WRITE:
            member.mode = (values[0], values[1], values[2])
        return True


def _reply(member: LxServo, command: int) -> bytes:
    return lx.encode_reply(lx.Message(member.servo.servo_id, command, member.read(command)))


def _low(values: Sequence[int]) -> int:
    """Return what is on an open-collector line when several drive it: a 0 wins."""
    low = 0xFF
    for value in values:
        low &= value
    return low
