"""HiWonder/LewanSoul bus servos (LX-16A, LX-15D, HTS, HTD, HX): ``55 55 ID LEN CMD .. CK``.

Half duplex at 115200 baud. Writes are not acknowledged; a read is answered with the same command
number. All commands stand in one table. Positions: 0..1000 are 240 degrees.
Source: vendor protocol text, checked against two independent libraries; the text prints the offset
read once as command 9, its table and all code say 19.
"""

import struct
from typing import ClassVar, Dict, FrozenSet, NamedTuple, Sequence, Tuple

from firmware_bridge.codec.parser import IMPOSSIBLE, NEEDS_MORE, Measure, Parser
from firmware_bridge.codec.protocol import Quantity, Query, Reply, ServoProtocol, ServoTarget
from firmware_bridge.codec.ranges import require
from firmware_bridge.errors import ProtocolError

HEADER = b"\x55\x55"
BROADCAST = 254
MAX_ID = 253
MAX_FRAME = 10
BAUD = 115200

MOVE_TIME_WRITE, MOVE_TIME_READ = 1, 2
MOVE_TIME_WAIT_WRITE, MOVE_TIME_WAIT_READ = 7, 8
MOVE_START, MOVE_STOP = 11, 12
ID_WRITE, ID_READ = 13, 14
OFFSET_ADJUST, OFFSET_WRITE, OFFSET_READ = 17, 18, 19
ANGLE_LIMIT_WRITE, ANGLE_LIMIT_READ = 20, 21
VIN_LIMIT_WRITE, VIN_LIMIT_READ = 22, 23
TEMP_MAX_WRITE, TEMP_MAX_READ = 24, 25
TEMP_READ, VIN_READ, POS_READ = 26, 27, 28
MODE_WRITE, MODE_READ = 29, 30
TORQUE_WRITE, TORQUE_READ = 31, 32
LED_WRITE, LED_READ = 33, 34
LED_ERROR_WRITE, LED_ERROR_READ = 35, 36


class Message(NamedTuple):
    """One frame's meaning: who, which command, and its values in wire order."""

    servo_id: int
    command: int
    values: Tuple[int, ...] = ()


class _Field(NamedTuple):
    name: str
    code: str  # of struct
    low: int
    high: int


class Layout:
    """The parameters of one command in one direction; ``length`` is what its LEN byte says."""

    def __init__(self, *fields: _Field) -> None:
        self.fields = fields
        self.struct = struct.Struct("<" + "".join(field.code for field in fields))
        self.length = 3 + self.struct.size

    def require(self, values: Sequence[int]) -> None:
        """Refuse values that are not these.

        Raises
        ------
        ProtocolError : too many, too few, or one out of its range.
        """
        if len(values) != len(self.fields):
            names = ", ".join(field.name for field in self.fields) or "none"
            raise ProtocolError(f"found {len(values)} values, expected {names}")
        for field, value in zip(self.fields, values):
            require(field.name, value, field.low, field.high)


_POSITION = _Field("position", "H", 0, 1000)
_TIME = _Field("time_ms", "H", 0, 30000)
_ID = _Field("servo_id", "B", 0, MAX_ID)
_OFFSET = _Field("offset", "b", -125, 125)
_MOVE = Layout(_POSITION, _TIME)
_LIMITS = Layout(_Field("low", "H", 0, 1000), _Field("high", "H", 0, 1000))
_VIN_LIMITS = Layout(_Field("low_mv", "H", 4500, 12000), _Field("high_mv", "H", 4500, 12000))
_TEMP_MAX = Layout(_Field("temperature_c", "B", 50, 100))
_MODE = Layout(
    _Field("mode", "B", 0, 1), _Field("reserved", "B", 0, 0), _Field("speed", "h", -1000, 1000)
)
_SWITCH = Layout(_Field("switch", "B", 0, 1))
_ERRORS = Layout(_Field("errors", "B", 0, 7))
_NOTHING = Layout()

COMMANDS: Dict[int, Layout] = {
    MOVE_TIME_WRITE: _MOVE,
    MOVE_TIME_WAIT_WRITE: _MOVE,
    MOVE_START: _NOTHING,
    MOVE_STOP: _NOTHING,
    ID_WRITE: Layout(_ID),
    OFFSET_ADJUST: Layout(_OFFSET),
    OFFSET_WRITE: _NOTHING,
    ANGLE_LIMIT_WRITE: _LIMITS,
    VIN_LIMIT_WRITE: _VIN_LIMITS,
    TEMP_MAX_WRITE: _TEMP_MAX,
    MODE_WRITE: _MODE,
    TORQUE_WRITE: _SWITCH,
    LED_WRITE: _SWITCH,
    LED_ERROR_WRITE: _ERRORS,
}
"""Command number -> what a host sends along; the requests join below."""

REPLIES: Dict[int, Layout] = {
    MOVE_TIME_READ: _MOVE,
    MOVE_TIME_WAIT_READ: _MOVE,
    ID_READ: Layout(_ID),
    OFFSET_READ: Layout(_OFFSET),
    ANGLE_LIMIT_READ: _LIMITS,
    VIN_LIMIT_READ: _VIN_LIMITS,
    TEMP_MAX_READ: _TEMP_MAX,
    TEMP_READ: Layout(_Field("temperature_c", "B", 0, 150)),
    VIN_READ: Layout(_Field("supply_mv", "H", 0, 20000)),
    # below 0 and above 1000: the shaft can be turned beyond what can be commanded
    POS_READ: Layout(_Field("position", "h", -500, 1500)),
    MODE_READ: _MODE,
    TORQUE_READ: _SWITCH,
    LED_READ: _SWITCH,
    LED_ERROR_READ: _ERRORS,
}
"""Command number -> what a servo answers."""

COMMANDS.update({command: _NOTHING for command in REPLIES})

_PAIRS = frozenset((ANGLE_LIMIT_WRITE, ANGLE_LIMIT_READ, VIN_LIMIT_WRITE, VIN_LIMIT_READ))


def checksum(body: bytes) -> int:
    """Return the check byte of ID, LEN, CMD and parameters."""
    return ~sum(body) & 0xFF


def encode_command(message: Message) -> bytes:
    """Return the frame a host sends.

    Raises
    ------
    ProtocolError : no such command, or a value that no servo takes.
    """
    require("servo_id", message.servo_id, 0, BROADCAST)
    return _encode(message, COMMANDS)


def encode_reply(message: Message) -> bytes:
    """Return the frame a servo answers with.

    Raises
    ------
    ProtocolError : no such reply, or a value out of range.
    """
    require("servo_id", message.servo_id, 0, MAX_ID)
    return _encode(message, REPLIES)


def _encode(message: Message, table: Dict[int, Layout]) -> bytes:
    layout = table.get(message.command)
    if layout is None:
        raise ProtocolError(f"command {message.command!r} is not one of {sorted(table)}")
    _require_values(layout, message)
    return frame_bytes(message.servo_id, message.command, layout.struct.pack(*message.values))


def frame_bytes(servo_id: int, command: int, parameters: bytes) -> bytes:
    """Wrap parameters into a frame, without asking what they mean."""
    body = bytes((servo_id, len(parameters) + 3, command)) + parameters
    return HEADER + body + bytes((checksum(body),))


def _require_values(layout: Layout, message: Message) -> None:
    layout.require(message.values)
    if message.values and message.command in _PAIRS and message.values[0] >= message.values[1]:
        raise ProtocolError(f"limits {message.values}: the lower one must be below the upper one")


def decode_command(frame: bytes) -> Message:
    """Read a whole frame as a servo does: shape only, ranges are the servo's own business.

    Raises
    ------
    ProtocolError : unknown command, or a length that does not fit it.
    """
    return _decode(frame, COMMANDS)[0]


def decode_reply(frame: bytes) -> Message:
    """Read a whole frame as a host does.

    Raises
    ------
    ProtocolError : unknown reply, a length that does not fit it, or a value out of range.
    """
    message, layout = _decode(frame, REPLIES)
    require("servo_id", message.servo_id, 0, MAX_ID)
    _require_values(layout, message)
    return message


def _decode(frame: bytes, table: Dict[int, Layout]) -> Tuple[Message, Layout]:
    if len(frame) < 6:
        raise ProtocolError(f"{frame.hex()} is shorter than a frame")
    layout = table.get(frame[4])
    if layout is None or frame[3] != layout.length or len(frame) != layout.length + 3:
        raise ProtocolError(f"command {frame[4]} does not have the shape of {frame.hex()}")
    return Message(frame[2], frame[4], layout.struct.unpack(frame[5:-1])), layout


def _measure_by(table: Dict[int, Layout], max_id: int) -> Measure:
    """Return a measure that takes only the length that the command has."""
    lengths = bytes(table[c].length if c in table else 0 for c in range(256))

    def measure(buffer: bytearray, start: int) -> int:
        n_have = len(buffer) - start
        if n_have < 5:
            is_possible = n_have < 3 or buffer[start + 2] <= max_id
            is_possible = is_possible and (n_have < 4 or 3 <= buffer[start + 3] <= 7)
            return NEEDS_MORE if is_possible else IMPOSSIBLE
        length = buffer[start + 3]
        if lengths[buffer[start + 4]] != length or buffer[start + 2] > max_id:
            return IMPOSSIBLE
        return length + 3

    return measure


def _is_intact(frame: bytes) -> bool:
    return sum(frame[2:]) & 0xFF == 0xFF


_MEASURE_COMMAND = _measure_by(COMMANDS, BROADCAST)
_MEASURE_REPLY = _measure_by(REPLIES, MAX_ID)


def host_parser() -> Parser:
    """Return a parser of what servos send; an echo of the host's own frames passes by unseen."""
    return Parser(HEADER, _MEASURE_REPLY, _is_intact)


def device_parser() -> Parser:
    """Return a parser of what a host sends."""
    return Parser(HEADER, _MEASURE_COMMAND, _is_intact)


_READS: Dict[Quantity, int] = {
    Quantity.MODEL: ID_READ,
    Quantity.POSITION: POS_READ,
    Quantity.TARGET: MOVE_TIME_READ,
    Quantity.TEMPERATURE: TEMP_READ,
    Quantity.VOLTAGE: VIN_READ,
    Quantity.TORQUE: TORQUE_READ,
    Quantity.LIMITS: ANGLE_LIMIT_READ,
    Quantity.OFFSET: OFFSET_READ,
}


class Lx16a(ServoProtocol):
    """The dialect of LX servos for the bus.

    ``FLAGS`` is not there: LED_ERROR_READ tells which faults would light the LED, not which there
    are. Servos have no model number, ``MODEL`` answers 0.
    """

    name = "lx16a"
    baud = BAUD
    ticks = (0, 1000)
    is_checked = True
    has_feedback = True
    quantities: ClassVar[FrozenSet[Quantity]] = frozenset(_READS)

    def parser(self) -> Parser:
        """Return a new parser of replies."""
        return host_parser()

    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return one frame per servo, 0.9 ms apart.

        Prepare-and-start would be simultaneous, but a lost prepare frame makes the servo run an old
        target that it still holds.

        Raises
        ------
        ProtocolError : an id, position or duration out of range.
        """
        for target in targets:
            require("servo_id", target.servo_id, 0, MAX_ID)
        return tuple(
            encode_command(Message(t.servo_id, MOVE_TIME_WRITE, (t.ticks, duration_ms)))
            for t in targets
        )

    def stop(self, at: Sequence[ServoTarget]) -> Tuple[bytes, ...]:
        """Return the broadcast stop; where the servos stand does not matter."""
        return (encode_command(Message(BROADCAST, MOVE_STOP)),)

    def torque(self, servo_ids: Sequence[int], is_on: bool) -> Tuple[bytes, ...]:
        """Return one frame per servo, or one for all when no id is given."""
        ids = tuple(servo_ids) or (BROADCAST,)
        return tuple(encode_command(Message(i, TORQUE_WRITE, (int(is_on),))) for i in ids)

    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return the frame that stores position limits in a servo."""
        return (encode_command(Message(servo_id, ANGLE_LIMIT_WRITE, (low, high))),)

    def query(self, quantity: Quantity, servo_ids: Sequence[int]) -> Tuple[Query, ...]:
        """Return one question per servo.

        Raises
        ------
        ProtocolError : a quantity that servos do not tell, or an id out of range.
        """
        command = _READS.get(quantity)
        if command is None:
            raise ProtocolError(f"{self.name} servos do not tell their {quantity.value}")
        for servo_id in servo_ids:
            require("servo_id", servo_id, 0, MAX_ID)
        n_reply = REPLIES[command].length + 3
        return tuple(
            Query(encode_command(Message(i, command)), quantity, (i,), n_reply) for i in servo_ids
        )

    def match(self, query: Query, frame: bytes) -> Tuple[Reply, ...]:
        """Return the answer when id, command, length and range all fit."""
        try:
            message = decode_reply(frame)
        except ProtocolError:
            return ()
        if (message.servo_id,) != query.servo_ids or message.command != _READS[query.quantity]:
            return ()
        if query.quantity is Quantity.MODEL:
            is_own = message.values == query.servo_ids
            return (Reply(message.servo_id, (0,)),) if is_own else ()
        is_target = query.quantity is Quantity.TARGET
        return (Reply(message.servo_id, message.values[:1] if is_target else message.values),)
