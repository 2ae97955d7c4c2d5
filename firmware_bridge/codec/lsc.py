"""LSC / xArm servo controller boards: ``55 55 LEN CMD ..``, no checksum.

9600 baud on the TTL pins; over USB HID the same frames stand in 64-byte reports. The board drives
bus servos (positions 0..1000 = 240 degrees) or PWM servos (500..2500 us). It sends frames 6, 7 and
8 by itself when a pad or an app starts or stops an action group: never answers.

Since there is no checksum, a frame only counts when its counts and values are ones that boards and
hosts really send. Source: vendor protocol text and examples, checked against the xarm package,
which reads 0..1000 as 250 degrees where the vendor says 240.
"""

import struct
from typing import Any, ClassVar, Dict, FrozenSet, NamedTuple, Sequence, Tuple, Type, Union

from firmware_bridge.codec.parser import IMPOSSIBLE, NEEDS_MORE, Measure, Parser
from firmware_bridge.codec.protocol import Quantity, Query, Reply, ServoProtocol, ServoTarget
from firmware_bridge.codec.ranges import require
from firmware_bridge.errors import ProtocolError

HEADER = b"\x55\x55"
BAUD = 9600
MAX_SERVOS = 20  # a 64-byte HID report carries no more
MAX_FRAME = 3 * MAX_SERVOS + 7
ALL_GROUPS = 255
MOVE, GROUP_RUN, GROUP_STOP, GROUP_COMPLETE = 3, 6, 7, 8
GROUP_SPEED, BATTERY, UNLOAD, POSITIONS = 11, 15, 20, 21

Targets = Tuple[Tuple[int, int], ...]


class Move(NamedTuple):
    """Move servos: ``targets`` of (id, position), all reached after ``duration_ms``."""

    duration_ms: int
    targets: Targets


class GroupRun(NamedTuple):
    """Run an action group ``n_times`` (0: for ever); also the board's word that one was started."""

    group: int
    n_times: int


class GroupStop(NamedTuple):
    """Stop the running action group; also the board's word that one was stopped."""


class GroupComplete(NamedTuple):
    """The board's word that an action group has run to its end."""

    group: int
    n_times: int


class GroupSpeed(NamedTuple):
    """Set the speed of an action group (255: of all) in per cent."""

    group: int
    percent: int


class BatteryRequest(NamedTuple):
    """Ask for the supply voltage."""


class Unload(NamedTuple):
    """Switch the torque of servos off; the next move switches it on again."""

    servo_ids: Tuple[int, ...]


class PositionRequest(NamedTuple):
    """Ask where bus servos stand."""

    servo_ids: Tuple[int, ...]


class Battery(NamedTuple):
    """Answer: supply voltage."""

    millivolt: int


class Positions(NamedTuple):
    """Answer: (id, position) of bus servos."""

    positions: Targets


ToBoard = Union[
    Move, GroupRun, GroupStop, GroupSpeed, BatteryRequest, Unload, PositionRequest
]  # fmt: skip
FromBoard = Union[Battery, Positions, GroupRun, GroupStop, GroupComplete]

_FIXED: Dict[type, Tuple[int, str]] = {
    GroupRun: (GROUP_RUN, "<BH"),
    GroupStop: (GROUP_STOP, "<"),
    GroupComplete: (GROUP_COMPLETE, "<BH"),
    GroupSpeed: (GROUP_SPEED, "<BH"),
    BatteryRequest: (BATTERY, "<"),
    Battery: (BATTERY, "<H"),
}
_RANGES: Dict[str, Tuple[int, int]] = {
    "duration_ms": (0, 30000),
    "group": (0, ALL_GROUPS),
    "percent": (1, 1000),
    "millivolt": (0, 20000),
}
_TO_BOARD: Tuple[type, ...] = (GroupRun, GroupStop, GroupSpeed, BatteryRequest)
_FROM_BOARD: Tuple[type, ...] = (GroupRun, GroupStop, GroupComplete, Battery)
_COMMAND_TICKS = (0, 2500)
_MEASURED_TICKS = (-500, 2500)  # the shaft can be turned beyond what can be commanded


def encode(message: Union[ToBoard, FromBoard]) -> bytes:
    """Return the frame of one message, in either direction.

    Raises
    ------
    ProtocolError : a value outside what the servo or the field can take.
    """
    _validate(message)
    if isinstance(message, Move):
        head = struct.pack("<BH", len(message.targets), message.duration_ms)
        return _frame(MOVE, head + b"".join(struct.pack("<BH", *t) for t in message.targets))
    if isinstance(message, Positions):
        pairs = b"".join(struct.pack("<Bh", *p) for p in message.positions)
        return _frame(POSITIONS, bytes((len(message.positions),)) + pairs)
    if isinstance(message, (Unload, PositionRequest)):
        command = UNLOAD if isinstance(message, Unload) else POSITIONS
        return _frame(command, bytes((len(message.servo_ids), *message.servo_ids)))
    command, code = _FIXED[type(message)]
    return _frame(command, struct.pack(code, *message))


def _frame(command: int, data: bytes) -> bytes:
    return HEADER + bytes((len(data) + 2, command)) + data


def decode_to_board(frame: bytes) -> ToBoard:
    """Read a whole frame as the board does.

    Raises
    ------
    ProtocolError : unknown command, a length that does not fit, or values no host sends.
    """
    command, data = _open(frame)
    if command == MOVE and len(data) >= 3 and len(data) == 3 * data[0] + 3:
        targets = tuple(struct.iter_unpack("<BH", data[3:]))
        message: ToBoard = Move(data[1] | data[2] << 8, targets)  # type: ignore[arg-type]
    elif command in (UNLOAD, POSITIONS) and data and len(data) == data[0] + 1:
        kind: Type[Union[Unload, PositionRequest]] = (
            Unload if command == UNLOAD else PositionRequest
        )
        message = kind(tuple(data[1:]))
    else:
        message = _fixed(command, data, _TO_BOARD)
    _validate(message)
    return message


def decode_from_board(frame: bytes) -> FromBoard:
    """Read a whole frame as the host does.

    Raises
    ------
    ProtocolError : no known answer or report, or values no board sends.
    """
    command, data = _open(frame)
    if command == POSITIONS and data and len(data) == 3 * data[0] + 1:
        pairs = tuple(struct.iter_unpack("<Bh", data[1:]))
        message: FromBoard = Positions(pairs)  # type: ignore[arg-type]
    else:
        message = _fixed(command, data, _FROM_BOARD)
    _validate(message)
    return message


def _open(frame: bytes) -> Tuple[int, bytes]:
    if len(frame) < 4 or len(frame) != frame[2] + 2:
        raise ProtocolError(f"{frame.hex()} is no whole frame")
    return frame[3], frame[4:]


def _fixed(command: int, data: bytes, kinds: Tuple[type, ...]) -> Any:
    for kind in kinds:
        number, code = _FIXED[kind]
        if command == number and len(data) == struct.calcsize(code):
            return kind(*struct.unpack(code, data))
    raise ProtocolError(f"command {command} does not take {data.hex() or 'nothing'}")


def _validate(message: Union[ToBoard, FromBoard]) -> None:
    if isinstance(message, (Move, Positions)):
        is_move = isinstance(message, Move)
        low, high = _COMMAND_TICKS if is_move else _MEASURED_TICKS
        pairs = message.targets if isinstance(message, Move) else message.positions
        _require_ids([pair[0] for pair in pairs])
        for _, ticks in pairs:
            if type(ticks) is not int or not low <= ticks <= high:  # a call per value takes longer
                require("servo position", ticks, low, high)
        if isinstance(message, Move):
            require("duration_ms", message.duration_ms, *_RANGES["duration_ms"])
    elif isinstance(message, (Unload, PositionRequest)):
        _require_ids(message.servo_ids)
    else:
        for name, value in zip(message._fields, message):
            require(name, value, *_RANGES.get(name, (0, 0xFFFF)))


def _require_ids(servo_ids: Sequence[int]) -> None:
    require("number of servos", len(servo_ids), 1, MAX_SERVOS)
    for servo_id in servo_ids:
        if type(servo_id) is not int or not 1 <= servo_id <= 253:
            require("servo id", servo_id, 1, 253)
    if len(set(servo_ids)) != len(servo_ids):
        raise ProtocolError(f"a frame names a servo twice: {list(servo_ids)}")


def _lengths(per_servo: Dict[int, Tuple[int, int]], kinds: Tuple[type, ...]) -> Dict[int, bytes]:
    """Return, per command, a table LEN -> count of servos (255: none, as it has no count)."""
    tables: Dict[int, bytearray] = {}
    for kind in kinds:
        command, code = _FIXED[kind]
        tables.setdefault(command, bytearray(256))[struct.calcsize(code) + 2] = 255
    for command, (base, size) in per_servo.items():
        table = tables.setdefault(command, bytearray(256))
        for n in range(1, MAX_SERVOS + 1):
            table[base + size * n] = n
    return {command: bytes(table) for command, table in tables.items()}


def _measure_by(lengths: Dict[int, bytes]) -> Measure:
    most = max(max(n for n in range(256) if table[n]) for table in lengths.values())

    def measure(buffer: bytearray, start: int) -> int:
        n_have = len(buffer) - start
        if n_have < 4:
            is_possible = n_have < 3 or 2 <= buffer[start + 2] <= most
            return NEEDS_MORE if is_possible else IMPOSSIBLE
        length = buffer[start + 2]
        table = lengths.get(buffer[start + 3])
        count = table[length] if table is not None else 0
        if count == 0:
            return IMPOSSIBLE
        if count != 255 and n_have > 4 and buffer[start + 4] != count:
            return IMPOSSIBLE
        return length + 2

    return measure


_MEASURE_TO_BOARD = _measure_by(
    _lengths({MOVE: (5, 3), UNLOAD: (3, 1), POSITIONS: (3, 1)}, _TO_BOARD)
)
_MEASURE_FROM_BOARD = _measure_by(_lengths({POSITIONS: (3, 3)}, _FROM_BOARD))


def _is_sent_by_hosts(frame: bytes) -> bool:
    try:
        decode_to_board(frame)
    except ProtocolError:
        return False
    return True


def _is_sent_by_boards(frame: bytes) -> bool:
    try:
        decode_from_board(frame)
    except ProtocolError:
        return False
    return True


def host_parser() -> Parser:
    """Return a parser of what the board sends."""
    return Parser(HEADER, _MEASURE_FROM_BOARD, _is_sent_by_boards)


def device_parser() -> Parser:
    """Return a parser of what a host sends."""
    return Parser(HEADER, _MEASURE_TO_BOARD, _is_sent_by_hosts)


class Lsc(ServoProtocol):
    """The dialect of a board with bus servos, for the bus.

    The board has no stop command: ``stop`` ends an action group and commands the place where the
    servos stand. Torque comes back with the next move alone.
    """

    name = "lsc"
    baud = BAUD
    ticks: ClassVar[Tuple[int, int]] = (0, 1000)
    is_checked = False
    has_feedback: ClassVar[bool] = True
    is_half_duplex: ClassVar[bool] = False  # a line for each way
    quantities: ClassVar[FrozenSet[Quantity]] = frozenset(
        (Quantity.MODEL, Quantity.POSITION, Quantity.VOLTAGE)
    )

    def parser(self) -> Parser:
        """Return a new parser of what the board sends."""
        return host_parser()

    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return the one frame that moves all.

        Raises
        ------
        ProtocolError : an id, position or duration out of range, or more than 20 servos.
        """
        for target in targets:
            require("position", target.ticks, *self.ticks)
        return (encode(Move(duration_ms, tuple((t.servo_id, t.ticks) for t in targets))),)

    def stop(self, at: Sequence[ServoTarget]) -> Tuple[bytes, ...]:
        """Return the frames that end an action group and hold every servo where it stands."""
        low, high = self.ticks
        held = [t._replace(ticks=min(max(t.ticks, low), high)) for t in at]
        return (encode(GroupStop()), *(self.move(held, 0) if held else ()))

    def torque(self, servo_ids: Sequence[int], is_on: bool) -> Tuple[bytes, ...]:
        """Return the frame that unloads; () for torque on, which comes with the next move."""
        return () if is_on else (encode(Unload(tuple(servo_ids))),)

    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return nothing: the board has no limits."""
        return ()

    def query(self, quantity: Quantity, servo_ids: Sequence[int]) -> Tuple[Query, ...]:
        """Return the one question to the board.

        Raises
        ------
        ProtocolError : a quantity that the board does not tell, or an id out of range.
        """
        if quantity not in self.quantities:
            raise ProtocolError(f"{self.name} boards do not tell a {quantity.value}")
        if quantity is Quantity.VOLTAGE:
            return (Query(encode(BatteryRequest()), quantity, (), 6),)
        ids = tuple(servo_ids)
        return (Query(encode(PositionRequest(ids)), quantity, ids, 3 * len(ids) + 5),)

    def match(self, query: Query, frame: bytes) -> Tuple[Reply, ...]:
        """Return the answer: the voltage, or positions of servos that were all asked for."""
        try:
            message = decode_from_board(frame)
        except ProtocolError:
            return ()
        if isinstance(message, Battery) and query.quantity is Quantity.VOLTAGE:
            return (Reply(0, (message.millivolt,)),)
        if not isinstance(message, Positions) or query.quantity is Quantity.VOLTAGE:
            return ()
        if not {pair[0] for pair in message.positions} <= set(query.servo_ids):
            return ()
        is_model = query.quantity is Quantity.MODEL
        return tuple(Reply(i, (0 if is_model else ticks,)) for i, ticks in message.positions)


class LscPwm(Lsc):
    """The dialect of a board with PWM servos: pulses in us, which nobody can measure."""

    name = "lsc-pwm"
    ticks = (500, 2500)
    has_feedback = False
    quantities = frozenset((Quantity.VOLTAGE,))
