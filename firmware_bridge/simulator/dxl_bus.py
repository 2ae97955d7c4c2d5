"""Dynamixel X servos on one line, simulated from the bytes up.

What nobody here measured is taken the harsh way: torque that is switched on lets the servo go to
the goal it holds, however old. Source: vendor protocol manual and X series control table.
"""

from typing import Callable, Dict, List, Sequence, Tuple

from firmware_bridge.codec import dxl2
from firmware_bridge.codec import register_messages as words
from firmware_bridge.codec.dxl2_frame import BROADCAST, MAX_ID, STATUS, frame_bytes, servo_parser
from firmware_bridge.codec.dxl2_table import (
    BAUDS,
    EEPROM_END,
    N_REGISTERS,
    REGISTERS,
    TICKS_S_PER_VELOCITY,
)
from firmware_bridge.codec.protocol import ServoFlag
from firmware_bridge.simulator.register_bus import RegisterBus, RegisterServo
from firmware_bridge.simulator.servo import SimServo

FAILED, DATA_RANGE, DATA_LIMIT, ACCESS = 1, 4, 6, 7  # error numbers of a status
_BITS = (
    (int(ServoFlag.VOLTAGE), 1),
    (int(ServoFlag.OVERHEAT), 4),
    (int(ServoFlag.OVERCURRENT), 16),
    (int(ServoFlag.STALL), 32),
)
_TIME_BASED = 4  # bit of the drive mode


class DxlServo(RegisterServo):
    """One X servo in position mode. Its hardware errors stay until it is rebooted."""

    def __init__(self, servo: SimServo) -> None:
        self._errors = 0
        super().__init__(servo, REGISTERS, N_REGISTERS, EEPROM_END)

    @property
    def state(self) -> int:
        """The alert bit of its status frames."""
        return dxl2.ALERT if self._watch() else 0

    @property
    def baud(self) -> int:
        """Baud rate it is set to."""
        value = self.get("baud")
        return BAUDS[value] if value < len(BAUDS) else 0

    def answers(self, is_read: bool) -> bool:
        """Say whether it answers a frame to it alone."""
        return self.get("status_level") >= (1 if is_read else 2)

    def ramp_s(self, distance_ticks: float) -> float:
        """Return how long its profile takes for a way; 0: as fast as it can."""
        velocity = self.get("profile_velocity")
        if self.get("drive_mode") & _TIME_BASED:
            return velocity / 1000.0
        return distance_ticks / (velocity * TICKS_S_PER_VELOCITY) if velocity else 0.0

    def obey(self, address: int, data: bytes) -> int:
        """Carry out a write, or refuse all of it with an error number."""
        error = self._refusal(address, data)
        if error:
            return error
        names = self.store(address, data, is_kept=True)
        if "torque_enable" in names:
            self.switch_torque(bool(self.get("torque_enable")))
        if "goal_position" in names:
            self.go()
        return 0

    def look_after_itself(self) -> None:
        """Note what is wrong, and switch the torque off for it, as soon as it is."""
        self._watch()

    def live(self) -> Dict[str, Callable[[], float]]:
        """Return which registers tell its state, and what they tell now."""
        own: Dict[str, Callable[[], float]] = {
            "present_velocity": lambda: self.servo.speed_ticks_s / TICKS_S_PER_VELOCITY,
            "hardware_error": self._watch,
        }
        return {**super().live(), **own}

    def reboot(self) -> None:
        """Start again and forget the hardware errors."""
        self.servo.reset()
        self._errors = 0

    def measured(self) -> int:
        """What its sensor says, with the offset that it adds."""
        return self.servo.measured + self.get("homing_offset")

    def _offset_ticks(self) -> int:
        return -self.get("homing_offset")

    def _watch(self) -> int:
        """Keep and return what is wrong; some of it switches the torque off until a reboot."""
        flags = int(self.servo.flags)
        self._errors |= sum(bit for flag, bit in _BITS if flags & flag)
        if self._is_shut_down and self.servo.is_torque_on:
            self.servo.is_torque_on = False
        return self._errors

    @property
    def _is_shut_down(self) -> bool:
        return bool(self._errors & self.get("shutdown"))

    def _refusal(self, address: int, data: bytes) -> int:
        end = address + len(data)
        if address < EEPROM_END and self.servo.is_torque_on:
            return ACCESS
        for name, value in self._written(address, data):
            if not REGISTERS[name].is_writable:
                return ACCESS
            if name == "torque_enable" and value and self._is_shut_down:
                return FAILED
            if name in ("torque_enable", "led") and value > 1:
                return DATA_RANGE
            if (name == "id" and value > MAX_ID) or (name == "baud" and value >= len(BAUDS)):
                return DATA_RANGE
            if name == "goal_position" and self._within_limits(value) != value:
                return DATA_LIMIT
        return 0 if end <= N_REGISTERS else ACCESS

    def _written(self, address: int, data: bytes) -> List[Tuple[str, int]]:
        """Return the registers that a write fills as a whole, with their new values."""
        found = []
        for name, register in REGISTERS.items():
            at = register.address - address
            if at >= 0 and at + register.n_bytes <= len(data):
                found.append((name, register.unpack(data[at : at + register.n_bytes])))
        return found


class DxlBus(RegisterBus):
    """X servos on one line at 57600 baud, which they leave the factory with.

    Frames to one servo are answered as its status level says; a ping to all, and a sync-read, by
    each servo in turn; other broadcasts by none.
    """

    def __init__(self, servos: Sequence[SimServo]) -> None:
        self._dxl = [DxlServo(servo) for servo in servos]
        super().__init__(self._dxl, servo_parser(), dxl2.Dxl2.baud)

    def obey(self, frame: bytes) -> None:
        """Carry out a checked frame.

        Raises
        ------
        ProtocolError : parameters that do not fit the instruction, or missing stuffing.
        """
        message = dxl2.decode_to_servo(frame)
        if isinstance(message, words.SyncWrite):
            for servo_id, data in message.items:
                for member in self.hearing(servo_id, BROADCAST):
                    self.n_rejected += bool(member.obey(message.address, data))
        elif isinstance(message, words.SyncRead):
            self._sync_read(message)
        elif isinstance(message, words.Ping) and message.servo_id == BROADCAST:
            heard = sorted(self.hearing(BROADCAST, BROADCAST), key=lambda one: one.get("id"))
            self.answer_in_turn([(one, _status(one, 0, _identity(one))) for one in heard])
        else:
            for member in self.hearing(message.servo_id, BROADCAST):
                self._obey_one(member, message)

    def _obey_one(self, member: RegisterServo, message: dxl2.ToServo) -> None:
        error, data = 0, b""
        is_ping = isinstance(message, words.Ping)
        is_read = isinstance(message, words.Read)
        is_alone = getattr(message, "servo_id", BROADCAST) != BROADCAST
        is_answered = is_alone and (is_ping or member.answers(is_read))
        answer_id = member.servo.servo_id  # before a write may change it
        if is_ping:
            data = _identity(member)
        elif isinstance(message, words.Read):
            data = member.read(message.address, message.n_bytes)
        elif isinstance(message, words.Write):
            error = member.obey(message.address, message.data)
        elif isinstance(message, words.RegWrite):
            member.pending = (message.address, message.data)
        elif isinstance(message, words.Action):
            member.act()
        if is_answered and (data or not is_read):
            self.answer(member, _status(member, error, data, answer_id))
        self.n_rejected += bool(error)
        if isinstance(message, dxl2.Reboot) and isinstance(member, DxlServo):
            member.reboot()

    def _sync_read(self, message: words.SyncRead) -> None:
        frames = []
        for servo_id in message.servo_ids:
            for member in self.hearing(servo_id, BROADCAST):
                if member.answers(is_read=True):
                    data = member.read(message.address, message.n_bytes)
                    frames.append((member, _status(member, 0, data)))
        self.answer_in_turn(frames)


def _identity(member: RegisterServo) -> bytes:
    return member.read(0, 2) + member.read(REGISTERS["firmware"].address, 1)


def _status(member: RegisterServo, error: int, data: bytes, servo_id: int = -1) -> bytes:
    number = member.servo.servo_id if servo_id < 0 else servo_id
    return frame_bytes(number, STATUS, bytes((error | member.state,)) + data)
