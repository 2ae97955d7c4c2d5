"""RRC board frames: ``AA 55 FUNC LEN DATA[LEN] CRC8`` (newer ArmPi mini, MasterPi, MentorPi).

Pure functions: values -> bytes and back, no I/O. What the board does not check (ids, counts,
ranges) is refused here, since stock firmware obeys whatever carries a valid CRC.
Source: vendor protocol chapters for the RRC board, checked against the vendor SDK's output. The
document omits the count byte of a PWM move and names bus torque the right way round (0x0B off,
0x0C on); SDK and firmware have the count byte, and the firmware agrees with the document on torque.
"""

import struct
from typing import Dict, List, NamedTuple, Tuple, Union

from firmware_bridge.errors import ProtocolError

HEADER = b"\xaa\x55"
SYS, LED, BUZZER, PWM_SERVO, BUS_SERVO = 0, 1, 2, 4, 5
MAX_DATA = 255
MAX_FRAME = MAX_DATA + 5
BAUD = 1_000_000


def _crc_table() -> bytes:
    table = bytearray()
    for value in range(256):
        for _ in range(8):
            value = (value >> 1) ^ (0x8C if value & 1 else 0)
        table.append(value)
    return bytes(table)


_CRC = _crc_table()


def crc8(data: bytes) -> int:
    """Return CRC-8/MAXIM (reflected 0x31, init 0) of ``data``; of b"123456789" it is 0xA1."""
    crc = 0
    for byte in data:
        crc = _CRC[crc ^ byte]
    return crc


class RrcFrame(NamedTuple):
    """One well-formed frame: function number and payload."""

    function: int
    data: bytes


class PwmMove(NamedTuple):
    """Move PWM servos: ``targets`` of (id, pulse in us), all reached after ``duration_ms``."""

    duration_ms: int
    targets: Tuple[Tuple[int, int], ...]


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
    targets: Tuple[Tuple[int, int], ...]


class BusStop(NamedTuple):
    """Stop bus servos where they are."""

    servo_ids: Tuple[int, ...]


class BusTorque(NamedTuple):
    """Switch the torque of one bus servo."""

    servo_id: int
    is_on: bool


class BusPositionRequest(NamedTuple):
    """Ask a bus servo for its measured position."""

    servo_id: int


class PwmPosition(NamedTuple):
    """Reply: the pulse last commanded to a PWM servo (a cache, not a measurement)."""

    servo_id: int
    pulse_us: int


class BusPosition(NamedTuple):
    """Reply: position of a bus servo; ``is_ok`` false when the servo did not answer the board."""

    servo_id: int
    is_ok: bool
    position: int


class Battery(NamedTuple):
    """Pushed about once a second: supply voltage."""

    millivolt: int


ToBoard = Union[
    PwmMove, PwmMoveOne, PwmPositionRequest, PwmOffset, Buzzer, Led,
    BusMove, BusStop, BusTorque, BusPositionRequest,
]  # fmt: skip
FromBoard = Union[PwmPosition, BusPosition, Battery]


def frame_bytes(function: int, data: bytes) -> bytes:
    """Wrap a payload into one frame.

    Raises
    ------
    ProtocolError : payload longer than 255 bytes or function out of range.
    """
    _require("function", function, 0, 255)
    _require("payload length", len(data), 0, MAX_DATA)
    body = bytes((function, len(data))) + data
    return HEADER + body + bytes((crc8(body),))


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
    elif isinstance(message, PwmMoveOne):
        data = struct.pack("<BHBH", 3, *message)
    elif isinstance(message, PwmPositionRequest):
        data = bytes((5, message.servo_id))
    elif isinstance(message, PwmOffset):
        data = struct.pack("<BBb", 7, *message)
    elif isinstance(message, Buzzer):
        data = struct.pack("<HHHH", *message)
    elif isinstance(message, Led):
        data = struct.pack("<BHHH", *message)
    elif isinstance(message, BusStop):
        data = bytes((3, len(message.servo_ids))) + bytes(message.servo_ids)
    elif isinstance(message, BusTorque):
        data = bytes((0x0C if message.is_on else 0x0B, message.servo_id))
    elif isinstance(message, BusPositionRequest):
        data = bytes((5, message.servo_id))
    elif isinstance(message, PwmPosition):
        data = struct.pack("<BBH", message.servo_id, 5, message.pulse_us)
    elif isinstance(message, BusPosition):
        status = 0 if message.is_ok else -1
        data = struct.pack("<BBbH", message.servo_id, 5, status, message.position)
    else:
        data = struct.pack("<BH", 4, message.millivolt)
    return frame_bytes(_FUNCTION[type(message)], data)


_FUNCTION: Dict[type, int] = {
    PwmMove: PWM_SERVO, PwmMoveOne: PWM_SERVO, PwmPositionRequest: PWM_SERVO,
    PwmOffset: PWM_SERVO, PwmPosition: PWM_SERVO, Buzzer: BUZZER, Led: LED,
    BusMove: BUS_SERVO, BusStop: BUS_SERVO, BusTorque: BUS_SERVO,
    BusPositionRequest: BUS_SERVO, BusPosition: BUS_SERVO, Battery: SYS,
}  # fmt: skip


def decode_to_board(frame: RrcFrame) -> ToBoard:
    """Read a frame as the board does.

    Raises
    ------
    ProtocolError : unknown function or sub-command, or a length that does not fit.
    """
    function, data = frame
    try:
        if function == LED:
            return Led(*struct.unpack("<BHHH", data))
        if function == BUZZER:
            return Buzzer(*struct.unpack("<HHHH", data))
        if function == PWM_SERVO:
            return _pwm_command(data)
        if function == BUS_SERVO:
            return _bus_command(data)
    except (struct.error, IndexError) as error:
        raise ProtocolError(f"function {function}: payload {data.hex()}: {error}") from error
    raise ProtocolError(f"function {function} takes no command that is known here")


def _pwm_command(data: bytes) -> ToBoard:
    sub = data[0]
    if sub == 1:
        return PwmMove(*_targets(data))
    if sub == 3:
        return PwmMoveOne(*struct.unpack("<HBH", data[1:]))
    if sub == 5:
        return PwmPositionRequest(*struct.unpack("<B", data[1:]))
    if sub == 7:
        return PwmOffset(*struct.unpack("<Bb", data[1:]))
    raise ProtocolError(f"PWM sub-command {sub} is not known; known: 1, 3, 5, 7")


def _bus_command(data: bytes) -> ToBoard:
    sub = data[0]
    if sub == 1:
        return BusMove(*_targets(data))
    if sub == 3:
        if len(data) != 2 + data[1]:
            raise ProtocolError(f"bus stop says {data[1]} servos, payload is {data.hex()}")
        return BusStop(tuple(data[2:]))
    if sub == 5:
        return BusPositionRequest(*struct.unpack("<B", data[1:]))
    if sub in (0x0B, 0x0C):
        return BusTorque(struct.unpack("<B", data[1:])[0], sub == 0x0C)
    raise ProtocolError(f"bus sub-command {sub} is not known; known: 1, 3, 5, 11, 12")


def _targets(data: bytes) -> Tuple[int, Tuple[Tuple[int, int], ...]]:
    _, duration_ms, count = struct.unpack("<BHB", data[:4])
    if len(data) != 4 + 3 * count:
        raise ProtocolError(f"a move of {count} servos needs {4 + 3 * count} bytes: {data.hex()}")
    return duration_ms, tuple(struct.iter_unpack("<BH", data[4:]))  # type: ignore[arg-type]


def decode_from_board(frame: RrcFrame) -> FromBoard:
    """Read a frame as the host does.

    Raises
    ------
    ProtocolError : not a reply or report that is known here, or a length that does not fit.
    """
    function, data = frame
    if function == SYS and len(data) == 3 and data[0] == 4:
        return Battery(*struct.unpack("<H", data[1:]))
    if function == PWM_SERVO and len(data) == 4 and data[1] == 5:
        return PwmPosition(*struct.unpack("<BxH", data))
    if function == BUS_SERVO and len(data) == 5 and data[1] == 5:
        servo_id, status, position = struct.unpack("<BxbH", data)
        return BusPosition(servo_id, status == 0, position)
    raise ProtocolError(f"function {function} with payload {data.hex()} is no known report")


class RrcParser:
    """Find intact frames in a byte stream with garbage, cuts and flipped bits in it.

    After a header that turns out false it goes on one byte later, so a bad length swallows
    nothing (the vendor's byte machine loses 57 % of the intact frames then). Holds back at most
    one frame's worth of bytes. ``n_bad_crc`` and ``n_skipped`` (bytes) count what was dropped.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.n_frames = 0
        self.n_bad_crc = 0
        self.n_skipped = 0

    def feed(self, data: bytes) -> List[RrcFrame]:
        """Take bytes as they come and return the frames they complete."""
        self._buffer += data
        return self._scan(is_final=False)

    def flush(self) -> List[RrcFrame]:
        """Give up on an unfinished frame (the line fell silent); return what stood behind it."""
        return self._scan(is_final=True)

    def _scan(self, is_final: bool) -> List[RrcFrame]:
        buffer, frames = self._buffer, []
        at = 0
        while True:
            start = buffer.find(HEADER, at)
            if start < 0:
                keep_last = bool(buffer) and buffer[-1] == HEADER[0] and not is_final
                start = max(len(buffer) - keep_last, at)
                self.n_skipped += start - at
                at = start
                break
            self.n_skipped += start - at
            at = start
            n_frame = 5 + buffer[at + 3] if at + 4 <= len(buffer) else MAX_FRAME
            if at + n_frame > len(buffer):
                if not is_final:
                    break
                at, self.n_skipped = at + 1, self.n_skipped + 1
                continue
            body = bytes(buffer[at + 2 : at + n_frame - 1])
            if crc8(body) == buffer[at + n_frame - 1]:
                frames.append(RrcFrame(body[0], body[2:]))
                at += n_frame
            else:
                self.n_bad_crc += 1
                at, self.n_skipped = at + 1, self.n_skipped + 1
        del buffer[:at]
        self.n_frames += len(frames)
        return frames


def _validate(message: Union[ToBoard, FromBoard]) -> None:
    if isinstance(message, (PwmMove, BusMove)):
        low, high = (500, 2500) if isinstance(message, PwmMove) else (0, 1000)
        ids = [target[0] for target in message.targets]
        _require("number of servos", len(ids), 1, 83)
        if len(set(ids)) != len(ids):
            raise ProtocolError(f"a move names a servo twice: {ids}")
        for servo_id, value in message.targets:
            _require("servo id", servo_id, 1, 253)
            _require("servo target", value, low, high)
        _require("duration_ms", message.duration_ms, 0, 30000)
        return
    if isinstance(message, BusStop):
        _require("number of servos", len(message.servo_ids), 1, 253)
        for servo_id in message.servo_ids:
            _require("servo id", servo_id, 1, 253)
        return
    for name, value in zip(message._fields, message):
        _require(name, int(value), *_RANGES.get(name, (0, 0xFFFF)))


_RANGES: Dict[str, Tuple[int, int]] = {
    "servo_id": (1, 253),
    "led_id": (1, 255),
    "pulse_us": (500, 2500),
    "offset_us": (-100, 100),
    "duration_ms": (0, 30000),
}


def _require(name: str, value: int, low: int, high: int) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ProtocolError(f"{name} = {value!r} is not a whole number in {low}..{high}")
