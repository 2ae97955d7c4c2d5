"""The I2C board of the Raspberry Pi 4 ArmPi mini: PWM servos and the battery, and no answer else.

A frame is one write transaction, register number first. There is no checksum, no acknowledge and
no position to read: what a line does to a frame goes unseen, so moves count as unverifiable.
Source: vendor library of the ArmPi mini image and public byte tests of it.
"""

import struct
from typing import ClassVar, NamedTuple, Sequence, Tuple, Union

from firmware_bridge.codec.parser import IMPOSSIBLE, NEEDS_MORE, Parser
from firmware_bridge.codec.protocol import Quantity, Query, Reply, ServoProtocol, ServoTarget
from firmware_bridge.codec.ranges import require
from firmware_bridge.codec.registers import check_ids
from firmware_bridge.errors import ProtocolError

ADDRESS = 0x7A
BATTERY, ANGLE, MOTOR, MOVE = 0, 21, 31, 40  # registers
MAX_ID, N_MOTORS = 6, 4
PLAUSIBLE_MV = (4000, 18000)
"""What a supply can be: one lithium cell and up to four. Garbled readings were 231 and 65470."""


class Move(NamedTuple):
    """Move PWM servos: ``targets`` of (id, pulse in us), all reached after ``duration_ms``."""

    duration_ms: int
    targets: Tuple[Tuple[int, int], ...]


class Angle(NamedTuple):
    """Move one servo at once to 0..180 degrees."""

    servo_id: int
    angle_deg: int


class Motor(NamedTuple):
    """Turn a motor (1..4), -100..100 per cent."""

    motor_id: int
    percent: int


class BatteryRequest(NamedTuple):
    """Choose the battery's register, so that the next read tells its voltage."""


class Battery(NamedTuple):
    """Reply: supply voltage."""

    millivolt: int


ToBoard = Union[Move, Angle, Motor, BatteryRequest]


def encode(message: Union[ToBoard, Battery]) -> bytes:
    """Return the bytes of one transaction, in either direction.

    Raises
    ------
    ProtocolError : a value that the board or the field cannot take.
    """
    if isinstance(message, Move):
        return _move_bytes(message)
    if isinstance(message, Angle):
        require("servo id", message.servo_id, 1, MAX_ID)
        require("angle_deg", message.angle_deg, 0, 180)
        return bytes((ANGLE + message.servo_id - 1, message.angle_deg))
    if isinstance(message, Motor):
        require("motor id", message.motor_id, 1, N_MOTORS)
        require("percent", message.percent, -100, 100)
        return bytes((MOTOR + message.motor_id - 1, message.percent & 0xFF))
    if isinstance(message, Battery):
        require("millivolt", message.millivolt, 0, 0xFFFF)
        return struct.pack("<H", message.millivolt)
    return bytes((BATTERY,))


def decode_to_board(frame: bytes) -> ToBoard:
    """Read one write transaction as the board does.

    Raises
    ------
    ProtocolError : no such register, or a length that does not fit it.
    """
    if frame == bytes((BATTERY,)):
        return BatteryRequest()
    if len(frame) == 2 and ANGLE <= frame[0] < ANGLE + MAX_ID:
        return Angle(frame[0] - ANGLE + 1, frame[1])
    if len(frame) == 2 and MOTOR <= frame[0] < MOTOR + N_MOTORS:
        return Motor(frame[0] - MOTOR + 1, struct.unpack("<b", frame[1:])[0])
    if len(frame) < 4 or frame[0] != MOVE or len(frame) != 4 + 3 * frame[1]:
        raise ProtocolError(f"{frame.hex()} is no command of the I2C board")
    targets = tuple((servo_id, pulse) for servo_id, pulse in struct.iter_unpack("<BH", frame[4:]))
    return Move(frame[2] | frame[3] << 8, targets)


def decode_from_board(frame: bytes) -> Battery:
    """Read what the board answers.

    Raises
    ------
    ProtocolError : not two bytes.
    """
    if len(frame) != 2:
        raise ProtocolError(f"{frame.hex()} is no voltage, which has two bytes")
    return Battery(*struct.unpack("<H", frame))


def _move_bytes(message: Move) -> bytes:
    check_ids([servo_id for servo_id, _ in message.targets], MAX_ID)
    require("duration_ms", message.duration_ms, 0, 30000)
    data = bytearray(struct.pack("<BBH", MOVE, len(message.targets), message.duration_ms))
    for servo_id, pulse_us in message.targets:
        require("servo id", servo_id, 1, MAX_ID)
        require("servo target", pulse_us, *I2cPwm.ticks)
        data += struct.pack("<BH", servo_id, pulse_us)
    return bytes(data)


def _measure_reply(buffer: bytearray, start: int) -> int:
    return 2 if start + 2 <= len(buffer) else NEEDS_MORE


def _measure_command(buffer: bytearray, start: int) -> int:
    n_there = len(buffer) - start
    if not n_there:
        return NEEDS_MORE
    register = buffer[start]
    if register == BATTERY:
        return 1
    if ANGLE <= register < ANGLE + MAX_ID or MOTOR <= register < MOTOR + N_MOTORS:
        return 2
    if register != MOVE or (n_there > 1 and not 1 <= buffer[start + 1] <= MAX_ID):
        return IMPOSSIBLE
    return 4 + 3 * buffer[start + 1] if n_there > 1 else NEEDS_MORE


def _is_right(frame: bytes) -> bool:
    return True


def host_parser() -> Parser:
    """Return a parser of what the board answers: two bytes at a time, nothing to check."""
    return Parser(b"", _measure_reply, _is_right)


def board_parser() -> Parser:
    """Return a parser of write transactions that stand one behind the other."""
    return Parser(b"", _measure_command, _is_right)


class I2cPwm(ServoProtocol):
    """PWM servos 1..6 behind the I2C board, pulses in us; a move cannot be verified."""

    name: ClassVar[str] = "i2c"
    baud: ClassVar[int] = 100_000
    ticks: ClassVar[Tuple[int, int]] = (500, 2500)
    is_checked: ClassVar[bool] = False
    has_feedback: ClassVar[bool] = False
    is_half_duplex: ClassVar[bool] = False  # the host clocks every byte
    quantities = frozenset((Quantity.VOLTAGE,))

    def parser(self) -> Parser:
        """Return a new parser of voltages."""
        return host_parser()

    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return the write that moves all servos together; the board keeps the duration itself.

        Raises
        ------
        ProtocolError : an id, pulse or duration out of range.
        """
        pulses = tuple((target.servo_id, target.ticks) for target in targets)
        return (encode(Move(duration_ms, pulses)),)

    def stop(self, at: Sequence[ServoTarget]) -> Tuple[bytes, ...]:
        """Return the write that commands the given pulses at once; there is no stop command."""
        low, high = self.ticks
        held = [ServoTarget(one.servo_id, min(max(one.ticks, low), high)) for one in at]
        return self.move(held, 0)

    def torque(self, servo_ids: Sequence[int], is_on: bool) -> Tuple[bytes, ...]:
        """Return nothing: the board cannot let a servo go."""
        return ()

    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return nothing: the board keeps no limits."""
        return ()

    def query(self, quantity: Quantity, servo_ids: Sequence[int]) -> Tuple[Query, ...]:
        """Return the question for the supply voltage, the only one there is.

        Raises
        ------
        ProtocolError : another quantity.
        """
        if quantity not in self.quantities:
            raise ProtocolError(f"i2c cannot be asked for {quantity.value}, only for its voltage")
        return (Query(encode(BatteryRequest()), quantity, (), 2),)

    def match(self, query: Query, frame: bytes) -> Tuple[Reply, ...]:
        """Return the voltage; () for one that no supply has."""
        if len(frame) != 2:
            return ()
        millivolt = decode_from_board(frame).millivolt
        if not PLAUSIBLE_MV[0] <= millivolt <= PLAUSIBLE_MV[1]:
            return ()
        return (Reply(0, (millivolt,)),)
