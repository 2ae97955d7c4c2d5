"""Framing of the RRC board: ``AA 55 FUNC LEN DATA[LEN] CRC8``, and the parsers of both directions.

Pure functions. Source: vendor protocol chapters, checked against the vendor SDK's output; the CRC
is CRC-8/MAXIM over FUNC, LEN and DATA.
"""

from typing import Dict, FrozenSet, NamedTuple

from firmware_bridge.codec.parser import IMPOSSIBLE, NEEDS_MORE, Measure, Parser
from firmware_bridge.codec.ranges import require

HEADER = b"\xaa\x55"
SYS, LED, BUZZER, MOTOR, PWM_SERVO, BUS_SERVO = 0, 1, 2, 3, 4, 5
KEY, IMU, GAMEPAD, SBUS, OLED, RGB = 6, 7, 8, 9, 10, 11
MAX_DATA = 255
MAX_SERVOS = 80  # in one frame; keeps what a parser holds below 256 bytes
MAX_OTHER = 64  # longest payload of what is not about servos
MAX_FRAME = 5 + 4 + 3 * MAX_SERVOS
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
    """What is in a frame: function number and payload."""

    function: int
    data: bytes


def frame_bytes(function: int, data: bytes) -> bytes:
    """Wrap a payload into one frame.

    Raises
    ------
    ProtocolError : payload longer than 255 bytes or function out of range.
    """
    require("function", function, 0, 255)
    require("payload length", len(data), 0, MAX_DATA)
    body = bytes((function, len(data))) + data
    return HEADER + body + bytes((crc8(body),))


def open_frame(frame: bytes) -> RrcFrame:
    """Return what is in a frame that a parser has found whole and checked."""
    return RrcFrame(frame[2], frame[4:-1])


_MOVES = frozenset(3 * n + 4 for n in range(1, MAX_SERVOS + 1))
_TO_BOARD: Dict[int, FrozenSet[int]] = {
    LED: frozenset((7,)),
    BUZZER: frozenset((8,)),
    PWM_SERVO: _MOVES | {2, 3, 6},
    BUS_SERVO: _MOVES | {3, 6} | frozenset(range(2, MAX_SERVOS + 3)),
}
_FROM_BOARD: Dict[int, FrozenSet[int]] = {
    SYS: frozenset((3,)),
    PWM_SERVO: frozenset((3, 4)),
    BUS_SERVO: frozenset((4, 5, 7)),
    IMU: frozenset((24,)),
}


def _measure_by(lengths: Dict[int, FrozenSet[int]]) -> Measure:
    """Return a measure that takes only payload lengths that the function has."""
    other = frozenset(range(MAX_OTHER + 1))
    per_function = [lengths.get(function, other) for function in range(RGB + 1)]

    def measure(buffer: bytearray, start: int) -> int:
        n_have = len(buffer) - start
        if n_have < 4:
            return NEEDS_MORE if n_have < 3 or buffer[start + 2] <= RGB else IMPOSSIBLE
        function, length = buffer[start + 2], buffer[start + 3]
        if function > RGB or length not in per_function[function]:
            return IMPOSSIBLE
        return length + 5

    return measure


_MEASURE_TO_BOARD = _measure_by(_TO_BOARD)
_MEASURE_FROM_BOARD = _measure_by(_FROM_BOARD)


def _is_intact(frame: bytes) -> bool:
    crc, table = 0, _CRC
    for byte in frame[2:]:
        crc = table[crc ^ byte]
    return crc == 0  # a CRC taken over its own value too


def host_parser() -> Parser:
    """Return a parser of what the board sends."""
    return Parser(HEADER, _MEASURE_FROM_BOARD, _is_intact)


def device_parser() -> Parser:
    """Return a parser of what a host sends."""
    return Parser(HEADER, _MEASURE_TO_BOARD, _is_intact)
