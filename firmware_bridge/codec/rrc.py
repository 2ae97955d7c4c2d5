"""Messages of the RRC board (newer ArmPi mini, MasterPi, MentorPi): values <-> frames.

Pure functions, no I/O. What the board does not check (ids, counts, ranges) is refused here, since
stock firmware obeys whatever carries a valid CRC.
Source: vendor protocol chapters for the RRC board, checked against the vendor SDK's output. The
document omits the count byte of a PWM move and names bus torque the right way round (0x0B off,
0x0C on); SDK and firmware have the count byte, and the firmware agrees with the document on torque.
"""

import struct
from typing import Any, Dict, NamedTuple, Tuple, Union

from firmware_bridge.codec.ranges import require
from firmware_bridge.codec.rrc_frames import (
    BUS_SERVO,
    BUZZER,
    IMU,
    LED,
    MAX_SERVOS,
    PWM_SERVO,
    SYS,
    frame_bytes,
    open_frame,
)
from firmware_bridge.errors import ProtocolError

BUS_POSITION, BUS_VIN, BUS_TEMPERATURE, BUS_TORQUE = 5, 7, 9, 0x0D
BUS_ID, BUS_OFFSET, BUS_LIMITS, BUS_VIN_LIMITS, BUS_TEMP_LIMIT = 0x12, 0x22, 0x32, 0x36, 0x3A
BUS_READS: Dict[int, str] = {
    BUS_POSITION: "<h",
    BUS_VIN: "<H",
    BUS_TEMPERATURE: "<B",
    BUS_TORQUE: "<B",
    BUS_ID: "<B",
    BUS_OFFSET: "<b",
    BUS_LIMITS: "<HH",
    BUS_VIN_LIMITS: "<HH",
    BUS_TEMP_LIMIT: "<B",
}
"""Sub-command that reads something of a bus servo -> shape of the answer's value."""

Targets = Tuple[Tuple[int, int], ...]


class PwmMove(NamedTuple):
    """Move PWM servos: ``targets`` of (id, pulse in us), all reached after ``duration_ms``."""

    duration_ms: int
    targets: Targets


class PwmMoveOne(NamedTuple):
    """Move one PWM servo by the board's single-servo command."""

    duration_ms: int
    servo_id: int
    pulse_us: int


class PwmPositionRequest(NamedTuple):
    """Ask for the pulse the board last commanded to a PWM servo."""

    servo_id: int


class PwmOffset(NamedTuple):
    """Set the board's deviation of one PWM servo, -100..100 us."""

    servo_id: int
    offset_us: int


class PwmOffsetRequest(NamedTuple):
    """Ask for the board's deviation of one PWM servo."""

    servo_id: int


class Buzzer(NamedTuple):
    """Sound the buzzer."""

    frequency_hz: int
    on_ms: int
    off_ms: int
    n_cycles: int


class Led(NamedTuple):
    """Blink a light."""

    led_id: int
    on_ms: int
    off_ms: int
    n_cycles: int


class BusMove(NamedTuple):
    """Move bus servos: ``targets`` of (id, position 0..1000), reached after ``duration_ms``."""

    duration_ms: int
    targets: Targets


class BusStop(NamedTuple):
    """Stop bus servos where they are."""

    servo_ids: Tuple[int, ...]


class BusTorque(NamedTuple):
    """Switch the torque of one bus servo."""

    servo_id: int
    is_on: bool


class BusRead(NamedTuple):
    """Ask something of a bus servo; ``what`` is one of ``BUS_READS``."""

    servo_id: int
    what: int


class BusSetId(NamedTuple):
    """Give a bus servo another id."""

    servo_id: int
    new_servo_id: int


class BusOffset(NamedTuple):
    """Shift a bus servo's zero, -125..125 steps, until power-off."""

    servo_id: int
    offset: int


class BusSaveOffset(NamedTuple):
    """Keep a bus servo's shift for good."""

    servo_id: int


class BusLimits(NamedTuple):
    """Store the positions a bus servo allows."""

    servo_id: int
    low: int
    high: int


class BusVinLimits(NamedTuple):
    """Store the supply that a bus servo allows."""

    servo_id: int
    low_mv: int
    high_mv: int


class BusTempLimit(NamedTuple):
    """Store the temperature at which a bus servo drops its torque."""

    servo_id: int
    temperature_c: int


class PwmPosition(NamedTuple):
    """Reply: the pulse last commanded to a PWM servo (a cache, not a measurement)."""

    servo_id: int
    pulse_us: int


class PwmOffsetReply(NamedTuple):
    """Reply: the board's deviation of a PWM servo."""

    servo_id: int
    offset_us: int


class BusReply(NamedTuple):
    """Reply: values of a bus servo; ``is_ok`` false when the servo did not answer the board."""

    servo_id: int
    what: int
    is_ok: bool
    values: Tuple[int, ...]


class Battery(NamedTuple):
    """Pushed about once a second: supply voltage."""

    millivolt: int


class Imu(NamedTuple):
    """Pushed: acceleration and turning rate, in the units of the board."""

    ax: float
    ay: float
    az: float
    gx: float
    gy: float
    gz: float


ToBoard = Union[
    PwmMove, PwmMoveOne, PwmPositionRequest, PwmOffset, PwmOffsetRequest, Buzzer, Led,
    BusMove, BusStop, BusTorque, BusRead, BusSetId, BusOffset, BusSaveOffset, BusLimits,
    BusVinLimits, BusTempLimit,
]  # fmt: skip
FromBoard = Union[PwmPosition, PwmOffsetReply, BusReply, Battery, Imu]


class _Shape(NamedTuple):
    function: int
    sub: bytes
    sub_at: int  # where the sub-command stands in the payload
    code: str  # of struct, without the sub-command


_TO_BOARD: Dict[type, _Shape] = {
    Led: _Shape(LED, b"", 0, "<BHHH"),
    Buzzer: _Shape(BUZZER, b"", 0, "<HHHH"),
    PwmMoveOne: _Shape(PWM_SERVO, b"\x03", 0, "<HBH"),
    PwmPositionRequest: _Shape(PWM_SERVO, b"\x05", 0, "<B"),
    PwmOffset: _Shape(PWM_SERVO, b"\x07", 0, "<Bb"),
    PwmOffsetRequest: _Shape(PWM_SERVO, b"\x09", 0, "<B"),
    BusSetId: _Shape(BUS_SERVO, b"\x10", 0, "<BB"),
    BusOffset: _Shape(BUS_SERVO, b"\x20", 0, "<Bb"),
    BusSaveOffset: _Shape(BUS_SERVO, b"\x24", 0, "<B"),
    BusLimits: _Shape(BUS_SERVO, b"\x30", 0, "<BHH"),
    BusVinLimits: _Shape(BUS_SERVO, b"\x34", 0, "<BHH"),
    BusTempLimit: _Shape(BUS_SERVO, b"\x38", 0, "<BB"),
}
_FROM_BOARD: Dict[type, _Shape] = {
    Battery: _Shape(SYS, b"\x04", 0, "<H"),
    Imu: _Shape(IMU, b"", 0, "<ffffff"),
    PwmPosition: _Shape(PWM_SERVO, b"\x05", 1, "<BH"),
    PwmOffsetReply: _Shape(PWM_SERVO, b"\x09", 1, "<Bb"),
}
_SHAPES: Dict[type, _Shape] = {**_TO_BOARD, **_FROM_BOARD}
_MOVE_FUNCTION = {PwmMove: PWM_SERVO, BusMove: BUS_SERVO}


def encode(message: Union[ToBoard, FromBoard]) -> bytes:
    """Return the frame of one message, in either direction.

    Raises
    ------
    ProtocolError : a value outside what the servo or the field can take.
    """
    _validate(message)
    if isinstance(message, (PwmMove, BusMove)):
        data = struct.pack("<BHB", 1, message.duration_ms, len(message.targets))
        data += b"".join(struct.pack("<BH", *target) for target in message.targets)
        return frame_bytes(_MOVE_FUNCTION[type(message)], data)
    if isinstance(message, BusStop):
        return frame_bytes(BUS_SERVO, bytes((3, len(message.servo_ids), *message.servo_ids)))
    if isinstance(message, BusTorque):
        return frame_bytes(BUS_SERVO, bytes((0x0C if message.is_on else 0x0B, message.servo_id)))
    if isinstance(message, BusRead):
        return frame_bytes(BUS_SERVO, bytes((message.what, message.servo_id)))
    if isinstance(message, BusReply):
        status = 0 if message.is_ok else -1
        data = struct.pack("<BBb", message.servo_id, message.what, status)
        return frame_bytes(BUS_SERVO, data + struct.pack(BUS_READS[message.what], *message.values))
    shape = _SHAPES[type(message)]
    data = struct.pack(shape.code, *message)
    data = data[: shape.sub_at] + shape.sub + data[shape.sub_at :]
    return frame_bytes(shape.function, data)


def decode_to_board(frame: bytes) -> ToBoard:
    """Read a whole frame as the board does: shape only, ranges are the board's own business.

    Raises
    ------
    ProtocolError : unknown function or sub-command, or a length that does not fit.
    """
    function, data = open_frame(frame)
    sub = data[0] if data else -1
    if sub == 1 and function == PWM_SERVO:
        return PwmMove(*_targets(data))
    if function == BUS_SERVO:
        if sub == 1:
            return BusMove(*_targets(data))
        if sub == 3 and len(data) >= 2 and len(data) == 2 + data[1]:
            return BusStop(tuple(data[2:]))
        if sub in (0x0B, 0x0C) and len(data) == 2:
            return BusTorque(data[1], sub == 0x0C)
        if sub in BUS_READS and len(data) == 2:
            return BusRead(data[1], sub)
    message: ToBoard = _fixed(function, data, _TO_BOARD)
    return message


def decode_from_board(frame: bytes) -> FromBoard:
    """Read a whole frame as the host does.

    Raises
    ------
    ProtocolError : not a reply or report that is known here, or a length that does not fit.
    """
    function, data = open_frame(frame)
    if function == BUS_SERVO and len(data) > 3 and data[1] in BUS_READS:
        code = BUS_READS[data[1]]
        servo_id, what, status = struct.unpack("<BBb", data[:3])
        if len(data) == 3 + struct.calcsize(code) and status in (0, -1):
            return BusReply(servo_id, what, status == 0, struct.unpack(code, data[3:]))
    message: FromBoard = _fixed(function, data, _FROM_BOARD)
    return message


def _fixed(function: int, data: bytes, shapes: Dict[type, _Shape]) -> Any:
    for kind, shape in shapes.items():
        at, end = shape.sub_at, shape.sub_at + len(shape.sub)
        if shape.function != function or data[at:end] != shape.sub:
            continue
        if len(data) == struct.calcsize(shape.code) + len(shape.sub):
            return kind(*struct.unpack(shape.code, data[:at] + data[end:]))
    raise ProtocolError(f"function {function} does not take {data.hex() or 'nothing'}")


def _targets(data: bytes) -> Tuple[int, Targets]:
    if len(data) < 4 or len(data) != 4 + 3 * data[3]:
        raise ProtocolError(f"a move does not have the length that its count says: {data.hex()}")
    targets = tuple(struct.iter_unpack("<BH", data[4:]))
    return data[1] | data[2] << 8, targets  # type: ignore[return-value]


def _validate(message: Union[ToBoard, FromBoard]) -> None:
    if isinstance(message, (PwmMove, BusMove)):
        low, high = (500, 2500) if isinstance(message, PwmMove) else (0, 1000)
        ids = [target[0] for target in message.targets]
        _require_ids(tuple(ids))
        for _, value in message.targets:
            require("servo target", value, low, high)
        require("duration_ms", message.duration_ms, 0, 30000)
    elif isinstance(message, BusStop):
        _require_ids(message.servo_ids)
    elif isinstance(message, (BusRead, BusReply)):
        require("servo id", message.servo_id, 1, 253)
        if message.what not in BUS_READS:
            raise ProtocolError(f"sub-command {message.what!r} reads nothing")
        if isinstance(message, BusReply):
            _require_values(message)
    elif not isinstance(message, Imu):
        for name, value in zip(message._fields, message):
            low, high = _RANGES.get(name, (0, 0xFFFF))
            require(name, int(value) if name == "is_on" else value, low, high)
        if isinstance(message, (BusLimits, BusVinLimits)) and message[1] >= message[2]:
            raise ProtocolError(f"limits {message[1:]}: the lower must be below the upper one")


def _require_ids(servo_ids: Tuple[int, ...]) -> None:
    require("number of servos", len(servo_ids), 1, MAX_SERVOS)
    for servo_id in servo_ids:
        require("servo id", servo_id, 1, 253)
    if len(set(servo_ids)) != len(servo_ids):
        raise ProtocolError(f"a frame names a servo twice: {list(servo_ids)}")


def _require_values(message: BusReply) -> None:
    try:
        struct.pack(BUS_READS[message.what], *message.values)
    except struct.error as error:
        raise ProtocolError(f"values {message.values} of {message.what}: {error}") from error


_RANGES: Dict[str, Tuple[int, int]] = {
    "servo_id": (1, 253),
    "new_servo_id": (1, 253),
    "led_id": (1, 255),
    "is_on": (0, 1),
    "pulse_us": (500, 2500),
    "offset_us": (-100, 100),
    "offset": (-125, 125),
    "low": (0, 1000),
    "high": (0, 1000),
    "low_mv": (4500, 12000),
    "high_mv": (4500, 12000),
    "temperature_c": (50, 100),
    "duration_ms": (0, 30000),
}
