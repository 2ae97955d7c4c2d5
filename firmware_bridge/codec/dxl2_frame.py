"""Dynamixel 2.0 frames: CRC, byte stuffing and where a frame ends.

``FF FF FD 00 ID LEN_L LEN_H INST P.. CRC_L CRC_H``; LEN counts what stands behind it. A body may
not hold ``FF FF FD``: a further ``FD`` is put behind each and taken out again.
Source: vendor protocol manual. The vendor's own Python library (4.1.0) drops the result of its
stuffing, so that a payload ``FF FF FD`` leaves it unstuffed; servos cannot be sure of those frames
and here they are refused.
"""

from typing import Dict, NamedTuple, Tuple

from firmware_bridge.codec.parser import IMPOSSIBLE, NEEDS_MORE, Parser
from firmware_bridge.codec.ranges import require
from firmware_bridge.errors import ProtocolError

HEADER = b"\xff\xff\xfd\x00"
BROADCAST, MAX_ID = 0xFE, 0xFC
PING, READ, WRITE, REG_WRITE, ACTION, REBOOT = 1, 2, 3, 4, 5, 8
STATUS, SYNC_READ, SYNC_WRITE = 0x55, 0x82, 0x83
MAX_FRAME = 512
MAX_REPLY = 32
"""Bytes of the longest status frame that is believed; the longest answer asked for has 21."""

_FALSE_HEADER, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"
_ALL = MAX_FRAME - 7
LENGTHS: Dict[int, Tuple[int, int]] = {
    PING: (3, 3), READ: (7, 9), WRITE: (6, _ALL), REG_WRITE: (6, _ALL), ACTION: (3, 3),
    REBOOT: (3, 3), SYNC_READ: (8, _ALL), SYNC_WRITE: (9, _ALL),
}  # fmt: skip
"""Lowest and highest LEN per instruction, stuffing included."""


class Body(NamedTuple):
    """One frame without its wrapping: the parameters are not stuffed."""

    servo_id: int
    instruction: int
    data: bytes


def _crc_table() -> Tuple[int, ...]:
    table = []
    for value in range(256):
        crc = value << 8
        for _ in range(8):
            crc = crc << 1 ^ (0x8005 if crc & 0x8000 else 0)
        table.append(crc & 0xFFFF)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes) -> int:
    """Return the CRC-16 (0x8005, init 0, not reflected); of b"123456789" it is 0xFEE8."""
    crc = 0
    for byte in data:
        crc = (crc & 0xFF) << 8 ^ _CRC[crc >> 8 ^ byte]
    return crc


def stuff(body: bytes) -> bytes:
    """Put an ``FD`` behind every ``FF FF FD``."""
    return body.replace(_FALSE_HEADER, _STUFFED)


def unstuff(body: bytes) -> bytes:
    """Take the ``FD`` behind every ``FF FF FD`` out again.

    Raises
    ------
    ProtocolError : one without it: the sender did not stuff.
    """
    if body.count(_FALSE_HEADER) != body.count(_STUFFED):
        raise ProtocolError(f"a false header without stuffing in {body.hex()}")
    return body.replace(_STUFFED, _FALSE_HEADER)


def frame_bytes(servo_id: int, instruction: int, data: bytes) -> bytes:
    """Wrap an instruction and its parameters into one frame.

    Raises
    ------
    ProtocolError : longer than 512 bytes, or id or instruction out of range.
    """
    require("servo id", servo_id, 0, BROADCAST)
    require("instruction", instruction, 0, 255)
    body = stuff(bytes((instruction,)) + data)
    require("frame length", len(body) + 9, 10, MAX_FRAME)
    frame = HEADER + bytes((servo_id,)) + (len(body) + 2).to_bytes(2, "little") + body
    return frame + crc16(frame).to_bytes(2, "little")


def body_of(frame: bytes) -> Body:
    """Unwrap a checked frame.

    Raises
    ------
    ProtocolError : the sender did not stuff it.
    """
    body = unstuff(frame[7:-2])
    return Body(frame[4], body[0], body[1:])


def _length(buffer: bytearray, start: int) -> int:
    return buffer[start + 5] | buffer[start + 6] << 8


def _measure_status(buffer: bytearray, start: int) -> int:
    n_there = len(buffer) - start
    if n_there > 4 and buffer[start + 4] > MAX_ID:
        return IMPOSSIBLE
    if n_there < 8:
        return NEEDS_MORE
    length = _length(buffer, start)
    if buffer[start + 7] != STATUS or not 4 <= length <= MAX_REPLY - 7:
        return IMPOSSIBLE
    return length + 7


def _measure_instruction(buffer: bytearray, start: int) -> int:
    n_there = len(buffer) - start
    if n_there > 4 and MAX_ID < buffer[start + 4] != BROADCAST:
        return IMPOSSIBLE
    if n_there < 8:
        return NEEDS_MORE
    low, high = LENGTHS.get(buffer[start + 7], (0, -1))
    length = _length(buffer, start)
    return length + 7 if low <= length <= high else IMPOSSIBLE


def _is_right(frame: bytes) -> bool:
    return crc16(frame[:-2]) == frame[-2] | frame[-1] << 8


def servo_parser() -> Parser:
    """Return a parser of what the host sends, as a servo hears it."""
    return Parser(HEADER, _measure_instruction, _is_right)


def host_parser() -> Parser:
    """Return a parser of what servos send; frames longer than ``MAX_REPLY`` are not believed."""
    return Parser(HEADER, _measure_status, _is_right)
