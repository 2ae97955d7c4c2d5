"""The RRC board under test: the vendor's frames, and crcmod for the checksum.

There is no library of it on the package index, so the peer's frame is built here from the vendor's
description, field by field, with crcmod's checksum.
"""

import random
import struct
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from firmware_bridge.codec import rrc, rrc_frames
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.rrc_board import RrcBoard
from firmware_bridge.simulator.servo import SimServo
from offline_train.benchmarks.firmware import peers
from offline_train.benchmarks.firmware.kit import Kit, Vector

_TO_BOARD: Tuple[Tuple[str, rrc.ToBoard, str], ...] = (
    ("PWM 1", rrc.PwmMove(500, ((1, 1500),)), "AA 55 04 07 01 F4 01 01 01 DC 05 22"),
    (
        "the paper's start pose",
        rrc.PwmMove(3000, ((3, 500), (4, 2171), (5, 1500), (6, 1500))),
        "AA 55 04 10 01 B8 0B 04 03 F4 01 04 7B 08 05 DC 05 06 DC 05 4F",
    ),
    ("PWM offset", rrc.PwmOffset(2, 10), "AA 55 04 03 07 02 0A 02"),
    ("ask PWM position", rrc.PwmPositionRequest(1), "AA 55 04 02 05 01 E0"),
    (
        "bus 1 and 2",
        rrc.BusMove(1000, ((1, 833), (2, 1000))),
        "AA 55 05 0A 01 E8 03 02 01 41 03 02 E8 03 9F",
    ),
    ("bus stop", rrc.BusStop((1, 2)), "AA 55 05 04 03 02 01 02 4B"),
    ("bus torque off", rrc.BusTorque(1, False), "AA 55 05 02 0B 01 B3"),
    ("bus torque on", rrc.BusTorque(1, True), "AA 55 05 02 0C 01 DD"),
    ("ask bus position", rrc.BusRead(5, rrc.BUS_POSITION), "AA 55 05 02 05 05 0E"),
    ("buzzer", rrc.Buzzer(1900, 50, 10, 1), "AA 55 02 08 6C 07 32 00 0A 00 01 00 E9"),
    ("LED", rrc.Led(1, 100, 100, 5), "AA 55 01 07 01 64 00 64 00 05 00 37"),
)
_FROM_BOARD: Tuple[Tuple[str, rrc.FromBoard, str], ...] = (
    (
        "bus position 833",
        rrc.BusReply(5, rrc.BUS_POSITION, True, (833,)),
        "AA 55 05 05 05 05 00 41 03 CC",
    ),
    (
        "bus position failed",
        rrc.BusReply(5, rrc.BUS_POSITION, False, (0,)),
        "AA 55 05 05 05 05 FF 00 00 A3",
    ),
    ("7400 mV", rrc.Battery(7400), "AA 55 00 03 04 E8 1C 2B"),
)
_CRC: List[Any] = []


def _crc(data: bytes) -> Optional[int]:
    """Return crcmod's CRC-8/MAXIM; None without crcmod."""
    if not _CRC:
        crcmod = peers.load("crcmod", "crcmod")
        made = None if crcmod is None else crcmod.mkCrcFun(0x131, initCrc=0, rev=True, xorOut=0)
        _CRC.append(made)
    return None if _CRC[0] is None else int(_CRC[0](data))


def vectors() -> Sequence[Vector]:
    """Return the vendor's frames beside ours, and the check value of the checksum."""
    cases = [Vector(w, rrc.encode(m), bytes.fromhex(t)) for w, m, t in (*_TO_BOARD, *_FROM_BOARD)]
    check = bytes((rrc_frames.crc8(b"123456789"),))
    return [*cases, Vector("CRC of 123456789", check, b"\xa1")]


def random_message(rng: random.Random) -> rrc.ToBoard:
    """Make any message to the board."""
    ids = rng.sample(range(1, 254), rng.randint(1, 12))
    duration_ms, one = rng.randint(0, 30000), ids[0]
    low = rng.randint(0, 999)
    low_mv = rng.randint(4500, 11999)
    makers: Tuple[Callable[[], rrc.ToBoard], ...] = (
        lambda: rrc.PwmMove(duration_ms, tuple((i, rng.randint(500, 2500)) for i in ids)),
        lambda: rrc.PwmMoveOne(duration_ms, one, rng.randint(500, 2500)),
        lambda: rrc.PwmPositionRequest(one),
        lambda: rrc.PwmOffset(one, rng.randint(-100, 100)),
        lambda: rrc.PwmOffsetRequest(one),
        lambda: rrc.Buzzer(*(rng.randint(0, 0xFFFF) for _ in range(4))),
        lambda: rrc.Led(one, *(rng.randint(0, 0xFFFF) for _ in range(3))),
        lambda: rrc.BusMove(duration_ms, tuple((i, rng.randint(0, 1000)) for i in ids)),
        lambda: rrc.BusStop(tuple(ids)),
        lambda: rrc.BusTorque(one, rng.random() < 0.5),
        lambda: rrc.BusRead(one, rng.choice(list(rrc.BUS_READS))),
        lambda: rrc.BusSetId(one, ids[-1]),
        lambda: rrc.BusOffset(one, rng.randint(-125, 125)),
        lambda: rrc.BusSaveOffset(one),
        lambda: rrc.BusLimits(one, low, rng.randint(low + 1, 1000)),
        lambda: rrc.BusVinLimits(one, low_mv, rng.randint(low_mv + 1, 12000)),
        lambda: rrc.BusTempLimit(one, rng.randint(50, 100)),
    )
    return rng.choice(makers)()


def random_answer(rng: random.Random) -> rrc.FromBoard:
    """Make any message to the host."""
    one = rng.randint(1, 253)
    what = rng.choice(list(rrc.BUS_READS))
    code = rrc.BUS_READS[what]
    values = struct.unpack(code, bytes(rng.randrange(256) for _ in range(struct.calcsize(code))))
    turns = struct.unpack("<6f", struct.pack("<6f", *(rng.uniform(-20, 20) for _ in range(6))))
    makers: Tuple[Callable[[], rrc.FromBoard], ...] = (
        lambda: rrc.PwmPosition(one, rng.randint(500, 2500)),
        lambda: rrc.PwmOffsetReply(one, rng.randint(-100, 100)),
        lambda: rrc.BusReply(one, what, rng.random() < 0.8, values),
        lambda: rrc.Battery(rng.randint(0, 0xFFFF)),
        lambda: rrc.Imu(*turns),
    )
    return rng.choice(makers)()


def random_command(rng: random.Random) -> Tuple[bytes, Optional[bytes]]:
    """Return our bytes of any command, and the same built from the vendor's description."""
    message = random_message(rng)
    ours = rrc.encode(message)
    body = ours[2:-1]
    if isinstance(message, (rrc.PwmMove, rrc.BusMove)):
        content = [1, message.duration_ms & 255, message.duration_ms >> 8, len(message.targets)]
        for servo_id, value in message.targets:
            content += [servo_id, value & 255, value >> 8]
        body = bytes([4 if isinstance(message, rrc.PwmMove) else 5, len(content), *content])
    crc = _crc(body)
    return ours, None if crc is None else b"\xaa\x55" + body + bytes((crc,))


def round_trip(rng: random.Random) -> bool:
    """Say whether a random message of either direction comes back as it was."""
    if rng.random() < 0.5:
        sent: Any = random_message(rng)
        frames = rrc_frames.device_parser().feed(rrc.encode(sent))
        got: List[Any] = list(map(rrc.decode_to_board, frames))
    else:
        sent = random_answer(rng)
        frames = rrc_frames.host_parser().feed(rrc.encode(sent))
        got = list(map(rrc.decode_from_board, frames))
    return got == [sent] and type(got[0]) is type(sent)


def random_reply(rng: random.Random) -> bytes:
    """Return a well-formed frame to the host."""
    return rrc.encode(random_answer(rng))


def device() -> Firmware:
    """Make a board with six PWM servos; it keeps pulses within 500..2500."""
    return RrcBoard([SimServo(one, 1500, (500, 2500), 6000.0) for one in range(1, 7)])


def executed(firmware: Firmware) -> Dict[int, int]:
    """Return the pulse each servo was last sent to."""
    assert isinstance(firmware, RrcBoard)
    return firmware.commanded


KIT = Kit(
    name="rrc",
    peer="crcmod and the vendor's frames",
    vectors=vectors,
    random_command=random_command,
    round_trip=round_trip,
    random_reply=random_reply,
    host_parser=rrc_frames.host_parser,
    device_parser=rrc_frames.device_parser,
    move_frame=rrc.encode(rrc.PwmMove(500, ((1, 1500),))),
    device=device,
    executed=executed,
)
