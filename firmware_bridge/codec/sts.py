"""Feetech STS bus servos: ``FF FF ID LEN INST P.. CK``, status frames with ERR in place of INST.

Pure: values <-> bytes. Source: vendor protocol manual and memory table, byte-exact with
feetech-servo-sdk and ftservo-python-sdk. The speed register is taken as steps/s, as the vendor
tools show it; no real servo was measured.
"""

from typing import ClassVar, Dict, List, Sequence, Tuple, Union

from firmware_bridge.codec.parser import IMPOSSIBLE, NEEDS_MORE, Parser
from firmware_bridge.codec.protocol import Quantity, ServoFlag, ServoTarget
from firmware_bridge.codec.ranges import require
from firmware_bridge.codec.register_messages import (
    BROADCAST,
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
from firmware_bridge.codec.sts_table import N_REGISTERS, REGISTERS
from firmware_bridge.errors import ProtocolError

HEADER = b"\xff\xff"
MAX_ID = 0xFD
PING, READ, WRITE, REG_WRITE, ACTION, SYNC_READ, SYNC_WRITE = 1, 2, 3, 4, 5, 0x82, 0x83
MAX_FRAME = 250
MAX_REPLY = 16
"""Bytes of the longest status frame that is believed: ten of data, and no question asks more."""

_ALL = MAX_FRAME - 4
_LENGTHS: Dict[int, Tuple[int, int]] = {
    PING: (2, 2), READ: (4, 4), WRITE: (4, N_REGISTERS + 3), REG_WRITE: (4, N_REGISTERS + 3),
    ACTION: (2, 2), SYNC_READ: (5, _ALL), SYNC_WRITE: (6, _ALL),
}  # fmt: skip


ToServo = Union[Ping, Read, Write, RegWrite, Action, SyncRead, SyncWrite]


def checksum(body: bytes) -> int:
    """Return the inverted 8-bit sum of everything between header and checksum."""
    return ~sum(body) & 0xFF


def frame_bytes(servo_id: int, code: int, data: bytes) -> bytes:
    """Wrap instruction (or error) and parameters into one frame.

    Raises
    ------
    ProtocolError : longer than 250 bytes, or id or code out of range.
    """
    require("servo id", servo_id, 0, BROADCAST)
    require("instruction or error", code, 0, 255)
    require("frame length", len(data) + 6, 6, MAX_FRAME)
    body = bytes((servo_id, len(data) + 2, code)) + data
    return HEADER + body + bytes((checksum(body),))


def encode(message: Union[ToServo, Status]) -> bytes:
    """Return the frame of one message, in either direction.

    Raises
    ------
    ProtocolError : a value that no well-formed frame can carry.
    """
    if isinstance(message, Ping):
        return frame_bytes(message.servo_id, PING, b"")
    if isinstance(message, Action):
        return frame_bytes(message.servo_id, ACTION, b"")
    if isinstance(message, Status):
        require("servo id", message.servo_id, 0, MAX_ID)
        require("error bits", message.error, 0, 0x7F)
        require("bytes of data", len(message.data), 0, MAX_REPLY - 6)
        return frame_bytes(message.servo_id, message.error, message.data)
    if isinstance(message, SyncRead):
        _registers(message.address, message.n_bytes)
        check_ids(message.servo_ids, MAX_ID)
        data = bytes((message.address, message.n_bytes, *message.servo_ids))
        return frame_bytes(BROADCAST, SYNC_READ, data)
    if isinstance(message, SyncWrite):
        return frame_bytes(BROADCAST, SYNC_WRITE, _sync_data(message))
    if isinstance(message, Read):
        require("servo id", message.servo_id, 0, MAX_ID)
        _registers(message.address, message.n_bytes)
        return frame_bytes(message.servo_id, READ, bytes((message.address, message.n_bytes)))
    _registers(message.address, len(message.data))
    code = WRITE if isinstance(message, Write) else REG_WRITE
    return frame_bytes(message.servo_id, code, bytes((message.address,)) + message.data)


def decode_to_servo(frame: bytes) -> ToServo:
    """Read a checked frame as a servo does.

    Raises
    ------
    ProtocolError : unknown instruction, or parameters that do not fit it.
    """
    servo_id, code, data = frame[2], frame[4], frame[5:-1]
    low, high = _LENGTHS.get(code, (0, -1))
    if not low <= frame[3] <= high:
        raise ProtocolError(f"instruction {code} does not take {len(data)} bytes")
    if code == PING:
        return Ping(servo_id)
    if code == ACTION:
        return Action(servo_id)
    if code == READ:
        return Read(servo_id, _registers(data[0], data[1]), data[1])
    if code == SYNC_READ:
        check_ids(data[2:], MAX_ID)
        return SyncRead(_registers(data[0], data[1]), data[1], tuple(data[2:]))
    if code == SYNC_WRITE:
        return _sync_write(data)
    address = _registers(data[0], len(data) - 1)
    if code == WRITE:
        return Write(servo_id, address, data[1:])
    return RegWrite(servo_id, address, data[1:])


def decode_from_servo(frame: bytes) -> Status:
    """Read a checked frame as the host does."""
    return Status(frame[2], frame[4], frame[5:-1])


def _sync_data(message: SyncWrite) -> bytes:
    check_ids([servo_id for servo_id, _ in message.items], MAX_ID)
    n_bytes = len(message.items[0][1])
    _registers(message.address, n_bytes)
    data = bytearray((message.address, n_bytes))
    for servo_id, content in message.items:
        require(f"bytes for servo {servo_id}", len(content), n_bytes, n_bytes)
        data.append(servo_id)
        data += content
    return bytes(data)


def _sync_write(data: bytes) -> SyncWrite:
    address, n_bytes, rest = data[0], data[1], data[2:]
    _registers(address, n_bytes)
    if len(rest) % (n_bytes + 1):
        raise ProtocolError(f"{len(rest)} bytes are no items of an id and {n_bytes} bytes")
    starts = range(0, len(rest), n_bytes + 1)
    items = tuple((rest[at], rest[at + 1 : at + 1 + n_bytes]) for at in starts)
    check_ids([servo_id for servo_id, _ in items], MAX_ID)
    return SyncWrite(address, items)


def _registers(address: int, n_bytes: int) -> int:
    require("address", address, 0, N_REGISTERS - 1)
    require("number of registers", n_bytes, 1, N_REGISTERS - address)
    return address


def _measure_status(buffer: bytearray, start: int) -> int:
    n_there = len(buffer) - start
    if n_there > 2 and buffer[start + 2] > MAX_ID:
        return IMPOSSIBLE
    if n_there < 4:
        return NEEDS_MORE
    length = buffer[start + 3]
    if not 2 <= length <= MAX_REPLY - 4 or (n_there > 4 and buffer[start + 4] > 0x7F):
        return IMPOSSIBLE
    return length + 4


def _measure_instruction(buffer: bytearray, start: int) -> int:
    n_there = len(buffer) - start
    if n_there > 2 and buffer[start + 2] > BROADCAST:
        return IMPOSSIBLE
    if n_there < 5:
        return NEEDS_MORE
    low, high = _LENGTHS.get(buffer[start + 4], (0, -1))
    return buffer[start + 3] + 4 if low <= buffer[start + 3] <= high else IMPOSSIBLE


def _is_right(frame: bytes) -> bool:
    return checksum(frame[2:-1]) == frame[-1]


def servo_parser() -> Parser:
    """Return a parser of what the host sends, as a servo hears it."""
    return Parser(HEADER, _measure_instruction, _is_right)


def host_parser() -> Parser:
    """Return a parser of what servos send; frames longer than ``MAX_REPLY`` are not believed."""
    return Parser(HEADER, _measure_status, _is_right)


_R = REGISTERS
_ASKS: Dict[Quantity, Ask] = {
    Quantity.MODEL: Ask((_R["model"],)),
    Quantity.POSITION: Ask((_R["present_position"],)),
    Quantity.TARGET: Ask((_R["goal_position"],)),
    Quantity.SPEED: Ask((_R["present_speed"],)),
    Quantity.LOAD: Ask((_R["present_load"],)),
    Quantity.CURRENT: Ask((_R["present_current"],), 6.5),
    Quantity.TEMPERATURE: Ask((_R["present_temperature"],)),
    Quantity.VOLTAGE: Ask((_R["present_voltage"],), 100.0),
    Quantity.FLAGS: Ask((_R["status"],)),
    Quantity.TORQUE: Ask((_R["torque_enable"],)),
    Quantity.LIMITS: Ask((_R["min_position"], _R["max_position"])),
    Quantity.OFFSET: Ask((_R["homing_offset"],)),
}


class Sts(RegisterProtocol):
    """STS servos in position mode, 4096 steps a turn.

    A move is one sync-write of acceleration (none set, so that the speed alone tells the arrival),
    goal position, goal time (of no effect in position mode: 0) and goal speed. Servos have no stop
    command: a stop commands where they stand.
    """

    name: ClassVar[str] = "sts"
    baud: ClassVar[int] = 1_000_000
    ticks: ClassVar[Tuple[int, int]] = (0, 4095)
    asks = _ASKS
    quantities = quantities(_ASKS)
    flag_bits = {
        1: ServoFlag.VOLTAGE, 2: ServoFlag.ANGLE, 4: ServoFlag.OVERHEAT,
        8: ServoFlag.OVERCURRENT, 32: ServoFlag.STALL,
    }  # fmt: skip
    torque_register = REGISTERS["torque_enable"]
    max_id = MAX_ID
    n_status = 6

    def parser(self) -> Parser:
        """Return a new parser of status frames."""
        return host_parser()

    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return the sync-write of all goals and speeds; the speeds hold the duration.

        Raises
        ------
        ProtocolError : an id, position, speed or duration out of range.
        """
        require("duration_ms", duration_ms, 0, self.max_duration_ms)
        items: List[Tuple[int, bytes]] = []
        for target in targets:
            require("servo target", target.ticks, *self.ticks)
            require("ticks_s", target.ticks_s, 0, 0x7FFF)
            goal = _R["goal_position"].pack(target.ticks)
            speed = _R["goal_speed"].pack(target.ticks_s)
            items.append((target.servo_id, b"\x00" + goal + b"\x00\x00" + speed))
        return self.write_frames(_R["acceleration"].address, items)

    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return three writes: unlock the EEPROM, both limits, lock it.

        Raises
        ------
        ProtocolError : id or positions out of range, or not in order.
        """
        require("lower limit", low, self.ticks[0], self.ticks[1] - 1)
        require("upper limit", high, low + 1, self.ticks[1])
        limits = _R["min_position"].pack(low) + _R["max_position"].pack(high)
        lock = _R["lock"].address
        return (
            *self.write_frames(lock, [(servo_id, b"\x00")]),
            *self.write_frames(_R["min_position"].address, [(servo_id, limits)]),
            *self.write_frames(lock, [(servo_id, b"\x01")]),
        )

    def read_frame(self, servo_ids: Sequence[int], address: int, n_bytes: int) -> bytes:
        """Return a read of one servo, a sync-read of several."""
        if len(servo_ids) == 1:
            return encode(Read(servo_ids[0], address, n_bytes))
        return encode(SyncRead(address, n_bytes, tuple(servo_ids)))

    def write_frame(self, address: int, items: Sequence[Tuple[int, bytes]]) -> bytes:
        """Return the sync-write of (id, bytes) items."""
        return encode(SyncWrite(address, tuple(items)))

    def answer(self, frame: bytes) -> Answer:
        """Read a status frame; STS servos say what is wrong with them, but refuse nothing."""
        status = decode_from_servo(frame)
        return Answer(status.servo_id, status.data, self.flags_of(status.error), True)
