"""Feetech STS servos on one line, simulated from the bytes up.

What the vendor does not say and nobody here measured is taken the harsh way: torque that is
switched on lets the servo go to the goal it holds, however old.
Source: vendor manual and memory table.
"""

from typing import Callable, Dict, Sequence

from firmware_bridge.codec import register_messages as words
from firmware_bridge.codec import sts
from firmware_bridge.codec.protocol import ServoFlag
from firmware_bridge.codec.sts_table import BAUDS, EEPROM_END, N_REGISTERS, REGISTERS
from firmware_bridge.simulator.register_bus import RegisterBus, RegisterServo
from firmware_bridge.simulator.servo import SimServo

_BITS = (
    (int(ServoFlag.VOLTAGE), 1),
    (int(ServoFlag.OVERHEAT), 4),
    (int(ServoFlag.OVERCURRENT), 8),
    (int(ServoFlag.STALL), 32),
)
_MA_PER_UNIT = 6.5
_ACCELERATION_UNIT = 100.0
_CENTRE_HERE, _CENTRE_TICKS = 128, 2048


class StsServo(RegisterServo):
    """One STS servo in position mode."""

    def __init__(self, servo: SimServo) -> None:
        super().__init__(servo, REGISTERS, N_REGISTERS, EEPROM_END)

    @property
    def state(self) -> int:
        """Error bits of its status frames."""
        flags = int(self.servo.flags)
        limit = 10.0 * self.get("overload_torque")
        if abs(self.servo.load_permille) > limit > 0.0:
            flags |= int(ServoFlag.STALL)
        if self.servo.current_ma > _MA_PER_UNIT * self.get("protection_current") > 0.0:
            flags |= int(ServoFlag.OVERCURRENT)
        return sum(bit for flag, bit in _BITS if flags & flag)

    @property
    def baud(self) -> int:
        """Baud rate it is set to."""
        value = self.get("baud")
        return BAUDS[value] if value < len(BAUDS) else 0

    def answers(self, is_read: bool) -> bool:
        """Say whether it answers a frame to it alone."""
        return is_read or self.get("status_level") == 1

    def ramp_s(self, distance_ticks: float) -> float:
        """Return how long speed and acceleration let the way take; 0: as fast as it can."""
        speed = abs(self.get("goal_speed"))
        acceleration = self.get("acceleration") * _ACCELERATION_UNIT
        if not speed:
            return 0.0
        return distance_ticks / speed + (speed / acceleration if acceleration else 0.0)

    def obey(self, address: int, data: bytes) -> int:
        """Carry out a write; what lies in the EEPROM outlives a reset if it is unlocked."""
        before = self.get("id")
        names = self.store(address, data, is_kept=not self.get("lock"))
        if self.servo.servo_id > sts.MAX_ID:
            self.servo.servo_id = before
            self.set("id", before)
        if "torque_enable" in names:
            wanted = self.get("torque_enable")
            if wanted == _CENTRE_HERE:
                self._centre_here()
            else:
                self.switch_torque(bool(wanted))
        if "goal_position" in names:
            self.go()
        return 0

    def live(self) -> Dict[str, Callable[[], float]]:
        """Return which registers tell its state, and what they tell now."""
        servo = self.servo
        own: Dict[str, Callable[[], float]] = {
            "present_speed": lambda: servo.speed_ticks_s,
            "present_current": lambda: servo.current_ma / _MA_PER_UNIT,
            "status": lambda: self.state,
        }
        return {**super().live(), **own}

    def _centre_here(self) -> None:
        """Choose the offset so that the shaft stands at the middle from now on."""
        low, high = REGISTERS["homing_offset"].range
        offset = self.servo.measured - _CENTRE_TICKS
        self.set("homing_offset", min(max(offset, low), high))
        self.save()


class StsBus(RegisterBus):
    """STS servos on one line at 1 Mbaud.

    Frames to one servo are answered by it (writes too, unless its status level is 0), sync-reads by
    each servo in turn, and broadcast writes and sync-writes by none.
    """

    def __init__(self, servos: Sequence[SimServo]) -> None:
        members = [StsServo(servo) for servo in servos]
        super().__init__(members, sts.servo_parser(), sts.Sts.baud)

    def obey(self, frame: bytes) -> None:
        """Carry out a checked frame.

        Raises
        ------
        ProtocolError : parameters that do not fit the instruction.
        """
        message = sts.decode_to_servo(frame)
        if isinstance(message, words.SyncWrite):
            for servo_id, data in message.items:
                for member in self.hearing(servo_id, words.BROADCAST):
                    member.obey(message.address, data)
        elif isinstance(message, words.SyncRead):
            self._sync_read(message)
        else:
            for member in self.hearing(message.servo_id, words.BROADCAST):
                self._obey_one(member, message)

    def _obey_one(self, member: RegisterServo, message: sts.ToServo) -> None:
        data = b""
        is_read = isinstance(message, (words.Ping, words.Read))
        is_alone = getattr(message, "servo_id", words.BROADCAST) != words.BROADCAST
        is_answered = member.answers(is_read) and (is_alone or isinstance(message, words.Ping))
        servo_id = member.servo.servo_id  # before a write may change it
        if isinstance(message, words.Read):
            data = member.read(message.address, message.n_bytes)
        elif isinstance(message, words.Write):
            member.obey(message.address, message.data)
        elif isinstance(message, words.RegWrite):
            member.pending = (message.address, message.data)
        elif isinstance(message, words.Action):
            member.act()
        if is_answered and (data or not isinstance(message, words.Read)):
            self.answer(member, sts.frame_bytes(servo_id, member.state, data))

    def _sync_read(self, message: words.SyncRead) -> None:
        frames = []
        for servo_id in message.servo_ids:
            for member in self.hearing(servo_id, words.BROADCAST):
                data = member.read(message.address, message.n_bytes)
                frames.append((member, sts.frame_bytes(servo_id, member.state, data)))
        self.answer_in_turn(frames)
