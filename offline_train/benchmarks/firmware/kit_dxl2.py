"""Dynamixel 2.0 under test, beside dynamixel-sdk.

That library works out the stuffing and drops the result. Where a payload needs it, the expectation
is its own stuffing and its own CRC put together; ``needs_stuffing`` tells such frames apart.
"""

import random
from typing import Any, Dict, List, Optional, Sequence, Tuple

from firmware_bridge.codec import dxl2, dxl2_frame
from firmware_bridge.codec.dxl2_frame import MAX_ID
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.dxl_bus import DxlBus
from firmware_bridge.simulator.servo import SimServo
from offline_train.benchmarks.firmware import peers
from offline_train.benchmarks.firmware.kit import Kit, Vector
from offline_train.benchmarks.firmware.record_port import RecordPort

LIMITS = (819, 3276)  # 200..800 of a servo with 1000 steps
_START = 1000
_GOAL = dxl2.Write(1, 116, (2048).to_bytes(4, "little"))
_FACTS: Tuple[Tuple[str, dxl2.ToServo, str], ...] = (
    ("ping", dxl2.Ping(1), "FF FF FD 00 01 03 00 01 19 4E"),
    ("read position", dxl2.Read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    ("goal 2048", _GOAL, "FF FF FD 00 01 09 00 03 74 00 00 08 00 00 42 89"),
    ("torque off", dxl2.Write(1, 64, b"\x00"), "FF FF FD 00 01 06 00 03 40 00 00 DE E6"),
    (
        "a payload that needs stuffing",
        dxl2.Write(1, 116, b"\xff\xff\xfd\x00"),
        "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7",
    ),
)
_AWKWARD = (0xFF, 0xFF, 0xFF, 0xFD, 0xFD, 0x00)


def vectors() -> Sequence[Vector]:
    """Return the published frames, and the published check value of the CRC, beside ours."""
    cases = [Vector(what, dxl2.encode(one), bytes.fromhex(text)) for what, one, text in _FACTS]
    check = dxl2_frame.crc16(b"123456789").to_bytes(2, "big")
    return [*cases, Vector("CRC of 123456789", check, b"\xfe\xe8")]


class _Sdk:
    """The vendor library's packet handler on a port that records."""

    def __init__(self, module: Any) -> None:
        self.port = RecordPort()
        self.handler = module.PacketHandler(2.0)

    def corrected(self, raw: bytes) -> bytes:
        """Return a frame with the stuffing that the library worked out and dropped."""
        stuffed = list(self.handler.addStuffing(list(raw)))
        crc = self.handler.updateCRC(0, stuffed, len(stuffed) - 2)
        return bytes(stuffed[:-2]) + int(crc).to_bytes(2, "little")


_LOADED: List[_Sdk] = []


def sdk() -> Optional[_Sdk]:
    """Return the vendor library if it is there."""
    if not _LOADED:
        module = peers.load("dynamixel-sdk", "dynamixel_sdk")
        if module is not None:
            _LOADED.append(_Sdk(module))
    return _LOADED[0] if _LOADED else None


def needs_stuffing(frame: bytes) -> bool:
    """Say whether a frame of ours holds stuffed bytes."""
    return b"\xff\xff\xfd\xfd" in frame[7:-2]


def random_message(rng: random.Random) -> dxl2.ToServo:
    """Make any message to a servo; every third payload is made of what stuffing is about."""
    servo_id = rng.randint(0, MAX_ID)
    address = rng.randint(0, 130)
    n_bytes = rng.randint(1, 12)
    kind = rng.randrange(8)
    if kind == 0:
        return dxl2.Ping(servo_id)
    if kind == 1:
        return dxl2.Action(servo_id)
    if kind == 2:
        return dxl2.Reboot(servo_id)
    if kind == 3:
        return dxl2.Read(servo_id, address, n_bytes)
    ids = rng.sample(range(MAX_ID + 1), rng.randint(1, 12))
    if kind == 4:
        return dxl2.SyncRead(address, n_bytes, tuple(ids))
    if kind == 5:
        return dxl2.SyncWrite(address, tuple((one, _bytes(rng, n_bytes)) for one in ids))
    content = _bytes(rng, n_bytes)
    if kind == 6:
        return dxl2.Write(servo_id, address, content)
    return dxl2.RegWrite(servo_id, address, content)


def by_sdk(peer: _Sdk, message: dxl2.ToServo) -> bytes:
    """Return what the vendor library sends for a message, as it sends it."""
    handler, port = peer.handler, peer.port
    if isinstance(message, dxl2.Ping):
        handler.ping(port, message.servo_id)
    elif isinstance(message, dxl2.Action):
        handler.action(port, message.servo_id)
    elif isinstance(message, dxl2.Reboot):
        handler.reboot(port, message.servo_id)
    elif isinstance(message, dxl2.Read):
        handler.readTxRx(port, message.servo_id, message.address, message.n_bytes)
    elif isinstance(message, dxl2.SyncRead):
        ids = list(message.servo_ids)
        handler.syncReadTx(port, message.address, message.n_bytes, ids, len(ids), False)
    elif isinstance(message, dxl2.SyncWrite):
        n_bytes = len(message.items[0][1])
        parameters = [value for one, content in message.items for value in (one, *content)]
        handler.syncWriteTxOnly(port, message.address, n_bytes, parameters, len(parameters))
    else:
        is_write = isinstance(message, dxl2.Write)
        send = handler.writeTxRx if is_write else handler.regWriteTxRx
        content = list(message.data)
        send(port, message.servo_id, message.address, len(content), content)
    port.is_using = False
    return port.taken()


def random_command(rng: random.Random) -> Tuple[bytes, Optional[bytes]]:
    """Return our bytes of any message and the vendor library's, its stuffing put right."""
    message = random_message(rng)
    ours = dxl2.encode(message)
    peer = sdk()
    if peer is None:
        return ours, None
    theirs = by_sdk(peer, message)
    return ours, peer.corrected(theirs) if needs_stuffing(ours) else theirs


def round_trip(rng: random.Random) -> bool:
    """Say whether a random message of either direction comes back as it was."""
    if rng.random() < 0.5:
        message = random_message(rng)
        frames = dxl2.servo_parser().feed(dxl2.encode(message))
        back = [dxl2.decode_to_servo(frame) for frame in frames]
        return back == [message] and type(back[0]) is type(message)
    status = _random_status(rng)
    frames = dxl2.host_parser().feed(dxl2.encode(status))
    return [dxl2.decode_from_servo(frame) for frame in frames] == [status]


def random_reply(rng: random.Random) -> bytes:
    """Return a well-formed frame to the host."""
    return dxl2.encode(_random_status(rng))


def device() -> Firmware:
    """Make six servos with limits."""
    bus = DxlBus([SimServo(one, _START, (0, 4095), 3000.0) for one in range(1, 7)])
    for member in bus.members:
        member.set("min_position", LIMITS[0])
        member.set("max_position", LIMITS[1])
        member.save()
    return bus


def executed(firmware: Firmware) -> Dict[int, int]:
    """Return the goal each servo last set out for."""
    assert isinstance(firmware, DxlBus)
    return firmware.commanded


def _random_status(rng: random.Random) -> dxl2.Status:
    content = _bytes(rng, rng.randint(0, dxl2.MAX_STATUS))
    return dxl2.Status(rng.randint(0, MAX_ID), rng.randrange(256), content)


def _bytes(rng: random.Random, n_bytes: int) -> bytes:
    if rng.random() < 0.3:
        return bytes(rng.choice(_AWKWARD) for _ in range(n_bytes))
    return bytes(rng.randrange(256) for _ in range(n_bytes))


KIT = Kit(
    name="dxl2",
    peer="dynamixel-sdk",
    vectors=vectors,
    random_command=random_command,
    round_trip=round_trip,
    random_reply=random_reply,
    host_parser=dxl2.host_parser,
    device_parser=dxl2.servo_parser,
    move_frame=dxl2.encode(_GOAL),
    device=device,
    executed=executed,
)
