"""Feetech STS under test, beside feetech-servo-sdk and ftservo-python-sdk."""

import random
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

from firmware_bridge.codec import sts
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.servo import SimServo
from firmware_bridge.simulator.sts_bus import StsBus
from offline_train.benchmarks.firmware import peers
from offline_train.benchmarks.firmware.kit import Kit, Vector
from offline_train.benchmarks.firmware.record_port import RecordPort

LIMITS = (819, 3276)  # 200..800 of a servo with 1000 steps
_START = 1000
_GOALS = tuple((one, (2048 + 10 * one).to_bytes(2, "little")) for one in range(1, 7))
_FACTS: Tuple[Tuple[str, sts.ToServo, str], ...] = (
    ("ping", sts.Ping(1), "FF FF 01 02 01 FB"),
    ("read position", sts.Read(1, 56, 2), "FF FF 01 04 02 38 02 BE"),
    ("goal 2048", sts.Write(1, 42, b"\x00\x08"), "FF FF 01 05 03 2A 00 08 C4"),
    ("torque off", sts.Write(1, 40, b"\x00"), "FF FF 01 04 03 28 00 CF"),
    ("torque off for all", sts.Write(0xFE, 40, b"\x00"), "FF FF FE 04 03 28 00 D2"),
    ("prepare 1000", sts.RegWrite(2, 42, b"\xe8\x03"), "FF FF 02 05 04 2A E8 03 DF"),
    ("action", sts.Action(), "FF FF FE 02 05 FA"),
    (
        "six goals",
        sts.SyncWrite(42, _GOALS),
        "FF FF FE 16 83 2A 02 01 0A 08 02 14 08 03 1E 08 04 28 08 05 32 08 06 3C 08 25",
    ),
    (
        "six positions",
        sts.SyncRead(56, 2, (1, 2, 3, 4, 5, 6)),
        "FF FF FE 0A 82 38 02 01 02 03 04 05 06 26",
    ),
    (
        "WritePosEx 2048 at 1500, acceleration 50",
        sts.Write(1, 41, bytes((50, 0x00, 0x08, 0, 0, 0xDC, 0x05))),
        "FF FF 01 0A 03 29 32 00 08 00 00 DC 05 AD",
    ),
)
_REPLIES: Tuple[Tuple[str, sts.Status, str], ...] = (
    ("position 2048", sts.Status(1, 0, b"\x00\x08"), "FF FF 01 04 00 00 08 F2"),
    ("the same, overloaded", sts.Status(1, 32, b"\x00\x08"), "FF FF 01 04 20 00 08 D2"),
)


def vectors() -> Sequence[Vector]:
    """Return the published frames beside ours."""
    cases: List[Vector] = []
    for what, message, text in (*_FACTS, *_REPLIES):
        cases.append(Vector(what, sts.encode(message), bytes.fromhex(text)))
    return cases


class _Sdk(NamedTuple):
    """One vendor library, its packet handler and what comes first in its calls."""

    handler: Any
    first: Tuple[Any, ...]
    port: RecordPort


_LOADED: List[_Sdk] = []


def sdks() -> Sequence[_Sdk]:
    """Return the vendor libraries that are there."""
    if not _LOADED:
        old = peers.load("feetech-servo-sdk", "scservo_sdk")
        if old is not None:
            port = RecordPort()
            _LOADED.append(_Sdk(old.PacketHandler(0), (port,), port))
        new = peers.load("ftservo-python-sdk", "scservo_sdk")
        if new is not None:
            port = RecordPort()
            _LOADED.append(_Sdk(new.sms_sts(port), (), port))
    return _LOADED


def random_message(rng: random.Random) -> sts.ToServo:
    """Make any message to a servo."""
    servo_id = rng.randint(0, sts.MAX_ID)
    address = rng.randint(0, 60)
    n_bytes = rng.randint(1, 10)
    kind = rng.randrange(7)
    if kind == 0:
        return sts.Ping(servo_id)
    if kind == 1:
        return sts.Action()
    if kind == 2:
        return sts.Read(servo_id, address, n_bytes)
    ids = rng.sample(range(sts.MAX_ID + 1), rng.randint(1, 12))
    if kind == 3:
        return sts.SyncRead(address, n_bytes, tuple(ids))
    if kind == 4:
        return sts.SyncWrite(address, tuple((one, _bytes(rng, n_bytes)) for one in ids))
    content = _bytes(rng, n_bytes)
    if kind == 5:
        return sts.Write(servo_id, address, content)
    return sts.RegWrite(servo_id, address, content)


def by_sdk(sdk: _Sdk, message: sts.ToServo) -> bytes:
    """Return what a vendor library sends for a message."""
    handler, first = sdk.handler, sdk.first
    if isinstance(message, sts.Ping):
        handler.ping(*first, message.servo_id)
    elif isinstance(message, sts.Action):
        handler.action(*first, message.servo_id)
    elif isinstance(message, sts.Read):
        handler.readTxRx(*first, message.servo_id, message.address, message.n_bytes)
    elif isinstance(message, sts.SyncRead):
        ids = list(message.servo_ids)
        handler.syncReadTx(*first, message.address, message.n_bytes, ids, len(ids))
    elif isinstance(message, sts.SyncWrite):
        n_bytes = len(message.items[0][1])
        parameters = [value for one, content in message.items for value in (one, *content)]
        handler.syncWriteTxOnly(*first, message.address, n_bytes, parameters, len(parameters))
    else:
        is_write = isinstance(message, sts.Write)
        send = handler.writeTxRx if is_write else handler.regWriteTxRx
        content = list(message.data)
        send(*first, message.servo_id, message.address, len(content), content)
    sdk.port.is_using = False
    return sdk.port.taken()


def random_command(rng: random.Random) -> Tuple[bytes, Optional[bytes]]:
    """Return our bytes of any message and those of one of the vendor libraries."""
    message = random_message(rng)
    ours = sts.encode(message)
    there = sdks()
    return ours, by_sdk(rng.choice(there), message) if there else None


def round_trip(rng: random.Random) -> bool:
    """Say whether a random message of either direction comes back as it was."""
    if rng.random() < 0.5:
        message = random_message(rng)
        frames = sts.servo_parser().feed(sts.encode(message))
        back = [sts.decode_to_servo(frame) for frame in frames]
        return back == [message] and type(back[0]) is type(message)
    status = _random_status(rng)
    frames = sts.host_parser().feed(sts.encode(status))
    return [sts.decode_from_servo(frame) for frame in frames] == [status]


def random_reply(rng: random.Random) -> bytes:
    """Return a well-formed frame to the host."""
    return sts.encode(_random_status(rng))


def device() -> Firmware:
    """Make six servos with limits."""
    bus = StsBus([SimServo(one, _START, (0, 4095), 3000.0) for one in range(1, 7)])
    for member in bus.members:
        member.set("min_position", LIMITS[0])
        member.set("max_position", LIMITS[1])
        member.save()
    return bus


def executed(firmware: Firmware) -> Dict[int, int]:
    """Return the goal each servo last set out for."""
    assert isinstance(firmware, StsBus)
    return firmware.commanded


def _random_status(rng: random.Random) -> sts.Status:
    n_bytes = rng.randint(0, sts.MAX_REPLY - 6)
    return sts.Status(rng.randint(0, sts.MAX_ID), rng.randint(0, 0x7F), _bytes(rng, n_bytes))


def _bytes(rng: random.Random, n_bytes: int) -> bytes:
    return bytes(rng.randrange(256) for _ in range(n_bytes))


KIT = Kit(
    name="sts",
    peer="feetech-servo-sdk, ftservo-python-sdk",
    vectors=vectors,
    random_command=random_command,
    round_trip=round_trip,
    random_reply=random_reply,
    host_parser=sts.host_parser,
    device_parser=sts.servo_parser,
    move_frame=sts.encode(sts.Write(1, 42, b"\x00\x08")),
    device=device,
    executed=executed,
)
