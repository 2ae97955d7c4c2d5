"""How many damaged move frames still look right to a reader that checks header, length and sum.

No range, no instruction is looked at: this is the wire format's own share. The counts are the
published ones of the facts sheet for this project; they are exhaustive, so they must come out
exactly. Source: ours.
"""

from typing import Callable, Dict, NamedTuple, Tuple

from firmware_bridge.codec import dxl2_frame, rrc_frames, sts

Look = Callable[[bytes], bool]


class Plain(NamedTuple):
    """A move frame, the look a plain reader takes at it, and what it lets pass.

    ``known`` counts the changed frames that pass: 1 bit, 2 bits, bursts of 2..8 bits.
    """

    frame: bytes
    looks_right: Look
    known: Tuple[int, int, int]


def _lx(frame: bytes) -> bool:
    is_shape = frame[:2] == b"\x55\x55" and frame[3] + 3 == len(frame)
    return is_shape and ~sum(frame[2:-1]) & 0xFF == frame[-1]


def _lsc(frame: bytes) -> bool:
    is_shape = frame[:2] == b"\x55\x55" and frame[2] + 2 == len(frame)
    return is_shape and frame[3] == 3 and 3 * frame[4] + 5 == frame[2]  # there is no sum


def _sts(frame: bytes) -> bool:
    is_shape = frame[:2] == sts.HEADER and frame[3] + 4 == len(frame)
    return is_shape and sts.checksum(frame[2:-1]) == frame[-1]


def _rrc(frame: bytes) -> bool:
    is_shape = frame[:2] == b"\xaa\x55" and frame[3] + 5 == len(frame)
    return is_shape and rrc_frames.crc8(frame[2:-1]) == frame[-1]


def _dxl2(frame: bytes) -> bool:
    is_shape = frame[:4] == dxl2_frame.HEADER and frame[5] + 256 * frame[6] + 7 == len(frame)
    return is_shape and dxl2_frame.crc16(frame[:-2]) == frame[-2] + 256 * frame[-1]


def _frame(text: str) -> bytes:
    return bytes.fromhex(text)


PLAIN: Dict[str, Plain] = {
    "lx16a": Plain(_frame("55 55 01 07 01 F4 01 E8 03 16"), _lx, (0, 89, 0)),
    "sts": Plain(_frame("FF FF 01 05 03 2A 00 08 C4"), _sts, (0, 54, 0)),
    "rrc": Plain(_frame("AA 55 04 07 01 F4 01 01 01 DC 05 22"), _rrc, (0, 0, 0)),
    "dxl2": Plain(_frame("FF FF FD 00 01 09 00 03 74 00 00 08 00 00 42 89"), _dxl2, (0, 0, 0)),
    "lsc": Plain(_frame("55 55 08 03 01 E8 03 01 F4 01"), _lsc, (40, 780, 4311)),
}
