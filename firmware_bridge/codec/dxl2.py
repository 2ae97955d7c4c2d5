"""Dynamixel 2.0 messages, and X servos as the bus sees them. Pure: values <-> bytes.

Source: vendor protocol manual and X series control table, byte-exact with dynamixel-sdk where that
library stuffs rightly (see ``dxl2_frame``).
"""

import math
from typing import ClassVar, Dict, List, NamedTuple, Sequence, Tuple, Union

from firmware_bridge.codec.dxl2_frame import (
    ACTION,
    BROADCAST,
    LENGTHS,
    MAX_ID,
    PING,
    READ,
    REBOOT,
    REG_WRITE,
    STATUS,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    body_of,
    frame_bytes,
    host_parser,
    servo_parser,
)  # fmt: skip
from firmware_bridge.codec.dxl2_table import N_REGISTERS, REGISTERS, TICKS_S_PER_VELOCITY
from firmware_bridge.codec.parser import Parser
from firmware_bridge.codec.protocol import Quantity, ServoFlag, ServoTarget
from firmware_bridge.codec.ranges import require
from firmware_bridge.codec.register_messages import (
    Action,
    Ping,
    Read,
    RegWrite,
    Status,
    SyncRead,
    SyncWrite,
    Write,
)
from firmware_bridge.codec.registers import (
    Answer,
    Ask,
    RegisterProtocol,
    check_ids,
    quantities,
)  # fmt: skip
from firmware_bridge.errors import ProtocolError

__all__ = ["Dxl2", "decode_from_servo", "decode_to_servo", "encode", "host_parser", "servo_parser"]

ALERT = 0x80  # bit of Status.error: the hardware error register has something to say
MAX_STATUS = 16  # bytes of data in a status; stuffed ones still fit a believed frame


class Reboot(NamedTuple):
    """Restart a servo; that also clears its hardware error."""

    servo_id: int


ToServo = Union[Ping, Read, Write, RegWrite, Action, Reboot, SyncRead, SyncWrite]
_EMPTY: Dict[type, int] = {Ping: PING, Action: ACTION, Reboot: REBOOT}


def encode(message: Union[ToServo, Status]) -> bytes:
    """Return the frame of one message, in either direction.

    Raises
    ------
    ProtocolError : a value that no well-formed frame can carry.
    """
    if isinstance(message, (Ping, Action, Reboot)):
        _servo_or_all(message.servo_id)
        return frame_bytes(message.servo_id, _EMPTY[type(message)], b"")
    if isinstance(message, Status):
        require("servo id", message.servo_id, 0, MAX_ID)
        require("error", message.error, 0, 255)
        require("bytes of data", len(message.data), 0, MAX_STATUS)
        return frame_bytes(message.servo_id, STATUS, bytes((message.error,)) + message.data)
    if isinstance(message, SyncRead):
        check_ids(message.servo_ids, MAX_ID)
        data = _span(message.address, message.n_bytes) + bytes(message.servo_ids)
        return frame_bytes(BROADCAST, SYNC_READ, data)
    if isinstance(message, SyncWrite):
        return frame_bytes(BROADCAST, SYNC_WRITE, _sync_data(message))
    if isinstance(message, Read):
        require("servo id", message.servo_id, 0, MAX_ID)
        return frame_bytes(message.servo_id, READ, _span(message.address, message.n_bytes))
    _servo_or_all(message.servo_id)
    code = WRITE if isinstance(message, Write) else REG_WRITE
    data = _span(message.address, len(message.data))[:2] + message.data
    return frame_bytes(message.servo_id, code, data)


def decode_to_servo(frame: bytes) -> ToServo:
    """Read a checked frame as a servo does.

    Raises
    ------
    ProtocolError : unknown instruction, parameters that do not fit it, or missing stuffing.
    """
    servo_id, code, data = body_of(frame)
    low, high = LENGTHS.get(code, (0, -1))
    if not low <= len(data) + 3 <= high:
        raise ProtocolError(f"instruction {code} does not take {len(data)} bytes")
    for kind, number in _EMPTY.items():
        if code == number:
            message: ToServo = kind(servo_id)
            return message
    address = int.from_bytes(data[:2], "little")
    if code in (WRITE, REG_WRITE):
        _span(address, len(data) - 2)
        if code == WRITE:
            return Write(servo_id, address, data[2:])
        return RegWrite(servo_id, address, data[2:])
    n_bytes = int.from_bytes(data[2:4], "little")
    _span(address, n_bytes)
    if code == SYNC_WRITE:
        return _sync_write(address, n_bytes, data[4:])
    if code == SYNC_READ:
        check_ids(data[4:], MAX_ID)
        return SyncRead(address, n_bytes, tuple(data[4:]))
    if len(data) != 4:
        raise ProtocolError(f"a read takes 4 bytes, not {len(data)}")
    return Read(servo_id, address, n_bytes)


def decode_from_servo(frame: bytes) -> Status:
    """Read a checked frame as the host does.

    Raises
    ------
    ProtocolError : no status, or missing stuffing.
    """
    servo_id, code, data = body_of(frame)
    if code != STATUS or not data:
        raise ProtocolError(f"instruction {code} with {len(data)} bytes is no status")
    return Status(servo_id, data[0], data[1:])


def _servo_or_all(servo_id: int) -> None:
    if servo_id != BROADCAST:
        require("servo id", servo_id, 0, MAX_ID)


def _span(address: int, n_bytes: int) -> bytes:
    require("address", address, 0, N_REGISTERS - 1)
    require("number of registers", n_bytes, 1, N_REGISTERS - address)
    return address.to_bytes(2, "little") + n_bytes.to_bytes(2, "little")


def _sync_data(message: SyncWrite) -> bytes:
    check_ids([servo_id for servo_id, _ in message.items], MAX_ID)
    n_bytes = len(message.items[0][1])
    data = bytearray(_span(message.address, n_bytes))
    for servo_id, content in message.items:
        require(f"bytes for servo {servo_id}", len(content), n_bytes, n_bytes)
        data.append(servo_id)
        data += content
    return bytes(data)


def _sync_write(address: int, n_bytes: int, rest: bytes) -> SyncWrite:
    if len(rest) % (n_bytes + 1):
        raise ProtocolError(f"{len(rest)} bytes are no items of an id and {n_bytes} bytes")
    starts = range(0, len(rest), n_bytes + 1)
    items = tuple((rest[at], rest[at + 1 : at + 1 + n_bytes]) for at in starts)
    check_ids([servo_id for servo_id, _ in items], MAX_ID)
    return SyncWrite(address, items)


_R = REGISTERS
_ASKS: Dict[Quantity, Ask] = {
    Quantity.MODEL: Ask((_R["model"],)),
    Quantity.POSITION: Ask((_R["present_position"],)),
    Quantity.TARGET: Ask((_R["goal_position"],)),
    Quantity.SPEED: Ask((_R["present_velocity"],), TICKS_S_PER_VELOCITY),
    Quantity.LOAD: Ask((_R["present_load"],)),
    Quantity.TEMPERATURE: Ask((_R["present_temperature"],)),
    Quantity.VOLTAGE: Ask((_R["present_voltage"],), 100.0),
    Quantity.FLAGS: Ask((_R["hardware_error"],)),
    Quantity.TORQUE: Ask((_R["torque_enable"],)),
    Quantity.LIMITS: Ask((_R["min_position"], _R["max_position"])),
    Quantity.OFFSET: Ask((_R["homing_offset"],)),
}


class Dxl2(RegisterProtocol):
    """X servos in position mode (operating mode 3), 4096 steps a turn.

    A move is one sync-write of profile velocity and goal position, which stand side by side. The
    velocity-based profile is what a servo leaves the factory with; it needs no setting in the
    EEPROM as the time-based one does. Velocities are rounded up, so that a servo is not late.
    """

    name: ClassVar[str] = "dxl2"
    baud: ClassVar[int] = 57_600
    ticks: ClassVar[Tuple[int, int]] = (0, 4095)
    asks = _ASKS
    quantities = quantities(_ASKS)
    flag_bits = {1: ServoFlag.VOLTAGE, 4: ServoFlag.OVERHEAT, 8: ServoFlag.ANGLE,
                 16: ServoFlag.OVERCURRENT, 32: ServoFlag.STALL}  # fmt: skip
    torque_register = REGISTERS["torque_enable"]
    max_id = MAX_ID
    n_status = 11

    def parser(self) -> Parser:
        """Return a new parser of status frames."""
        return host_parser()

    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return the sync-write of all velocities and goals; the velocities hold the duration.

        Raises
        ------
        ProtocolError : an id, position, speed or duration out of range.
        """
        require("duration_ms", duration_ms, 0, self.max_duration_ms)
        items: List[Tuple[int, bytes]] = []
        for target in targets:
            require("servo target", target.ticks, *self.ticks)
            require("ticks_s", target.ticks_s, 0, 0x7FFF)
            velocity = math.ceil(target.ticks_s / TICKS_S_PER_VELOCITY)
            data = _R["profile_velocity"].pack(velocity) + _R["goal_position"].pack(target.ticks)
            items.append((target.servo_id, data))
        return self.write_frames(_R["profile_velocity"].address, items)

    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return the write of both limits; servos take it while their torque is off.

        Raises
        ------
        ProtocolError : id or positions out of range, or not in order.
        """
        require("lower limit", low, self.ticks[0], self.ticks[1] - 1)
        require("upper limit", high, low + 1, self.ticks[1])
        limits = _R["max_position"].pack(high) + _R["min_position"].pack(low)
        return self.write_frames(_R["max_position"].address, [(servo_id, limits)])

    def read_frame(self, servo_ids: Sequence[int], address: int, n_bytes: int) -> bytes:
        """Return a read of one servo, a sync-read of several."""
        if len(servo_ids) == 1:
            return encode(Read(servo_ids[0], address, n_bytes))
        return encode(SyncRead(address, n_bytes, tuple(servo_ids)))

    def write_frame(self, address: int, items: Sequence[Tuple[int, bytes]]) -> bytes:
        """Return the sync-write of (id, bytes) items."""
        return encode(SyncWrite(address, tuple(items)))

    def answer(self, frame: bytes) -> Answer:
        """Read a status frame; its error number says whether the servo did as it was told."""
        status = decode_from_servo(frame)
        flags = ServoFlag.HARDWARE if status.error & ALERT else ServoFlag.NONE
        return Answer(status.servo_id, status.data, flags, not status.error & ~ALERT)
