"""The LSC / xArm board under test, beside the xarm package."""

import random
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union

from firmware_bridge.codec import lsc
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.lsc_board import LscBoard
from firmware_bridge.simulator.servo import SimServo
from offline_train.benchmarks.firmware import peers
from offline_train.benchmarks.firmware.kit import Kit, Vector

LIMITS = (200, 800)
_VECTORS: Tuple[Tuple[str, Union[lsc.ToBoard, lsc.FromBoard], str], ...] = (
    ("id 1 to 500", lsc.Move(1000, ((1, 500),)), "55 55 08 03 01 E8 03 01 F4 01"),
    (
        "three servos",
        lsc.Move(800, ((1, 500), (2, 300), (6, 1000))),
        "55 55 0E 03 03 20 03 01 F4 01 02 2C 01 06 E8 03",
    ),
    ("unload 1..6", lsc.Unload((1, 2, 3, 4, 5, 6)), "55 55 09 14 06 01 02 03 04 05 06"),
    ("ask position", lsc.PositionRequest((2,)), "55 55 04 15 01 02"),
    ("ask supply", lsc.BatteryRequest(), "55 55 02 0F"),
    ("PWM id 1 to 2000", lsc.Move(1000, ((1, 2000),)), "55 55 08 03 01 E8 03 01 D0 07"),
    (
        "PWM 2 and 9",
        lsc.Move(800, ((2, 1200), (9, 2300))),
        "55 55 0B 03 02 20 03 02 B0 04 09 FC 08",
    ),
    ("7500 mV", lsc.Battery(7500), "55 55 04 0F 4C 1D"),
    ("group 8 once", lsc.GroupRun(8, 1), "55 55 05 06 08 01 00"),
)


class _Line:
    """Keep what the library writes."""

    def __init__(self) -> None:
        self.sent = b""

    def write(self, data: Sequence[int]) -> None:
        self.sent += bytes(data)

    def flush(self) -> None:
        """Do nothing: all is sent."""


_LOADED: List[Any] = []


def _controller() -> Any:
    """Return the library's controller on a line that only listens; None without the library."""
    if not _LOADED:
        xarm = peers.load("xarm", "xarm")
        made = None if xarm is None else xarm.Controller.__new__(xarm.Controller)
        if made is not None:
            made._device, made._is_serial, made.debug = _Line(), True, False
        _LOADED.append(made)
    return _LOADED[0]


def _by_peer(message: Any, data: bytes) -> Optional[bytes]:
    arm = _controller()
    if arm is None:
        return None
    arm._device.sent = b""
    if isinstance(message, lsc.Move):
        arm.setPosition([list(pair) for pair in message.targets], duration=message.duration_ms)
    elif isinstance(message, lsc.Unload):
        arm.servoOff(list(message.servo_ids))
    elif isinstance(message, lsc.PositionRequest):  # its question waits for an answer
        data = bytes((len(message.servo_ids), *message.servo_ids))
        arm._send(arm.CMD_GET_SERVO_POSITION, data)
    elif isinstance(message, lsc.BatteryRequest):
        arm._send(arm.CMD_GET_BATTERY_VOLTAGE)
    else:  # it has no calls for groups; its framing then
        arm._send(data[3], data[4:])
    sent: bytes = arm._device.sent
    return sent


def vectors() -> Sequence[Vector]:
    """Return the published frames beside ours."""
    return [Vector(what, lsc.encode(message), bytes.fromhex(t)) for what, message, t in _VECTORS]


def random_message(rng: random.Random) -> lsc.ToBoard:
    """Make any message to the board."""
    ids = rng.sample(range(1, 254), rng.randint(1, lsc.MAX_SERVOS))
    makers: Tuple[Callable[[], lsc.ToBoard], ...] = (
        lambda: lsc.Move(rng.randint(0, 30000), tuple((i, rng.randint(0, 1000)) for i in ids)),
        lambda: lsc.Unload(tuple(ids)),
        lambda: lsc.PositionRequest(tuple(ids)),
        lsc.BatteryRequest,
        lambda: lsc.GroupRun(rng.randint(0, 255), rng.randint(0, 0xFFFF)),
        lsc.GroupStop,
        lambda: lsc.GroupSpeed(rng.randint(0, 255), rng.randint(1, 1000)),
    )
    return rng.choice(makers)()


def random_answer(rng: random.Random) -> lsc.FromBoard:
    """Make any message to the host."""
    ids = rng.sample(range(1, 254), rng.randint(1, lsc.MAX_SERVOS))
    makers: Tuple[Callable[[], lsc.FromBoard], ...] = (
        lambda: lsc.Positions(tuple((i, rng.randint(-100, 1100)) for i in ids)),
        lambda: lsc.Battery(rng.randint(0, 20000)),
        lambda: lsc.GroupRun(rng.randint(0, 255), rng.randint(0, 0xFFFF)),
        lsc.GroupStop,
        lambda: lsc.GroupComplete(rng.randint(0, 255), rng.randint(0, 0xFFFF)),
    )
    return rng.choice(makers)()


def random_command(rng: random.Random) -> Tuple[bytes, Optional[bytes]]:
    """Return our bytes of any command and those of the library."""
    message = random_message(rng)
    ours = lsc.encode(message)
    return ours, _by_peer(message, ours)


def round_trip(rng: random.Random) -> bool:
    """Say whether a random message of either direction comes back as it was."""
    if rng.random() < 0.5:
        sent: Any = random_message(rng)
        got: List[Any] = list(map(lsc.decode_to_board, lsc.device_parser().feed(lsc.encode(sent))))
    else:
        sent = random_answer(rng)
        got = list(map(lsc.decode_from_board, lsc.host_parser().feed(lsc.encode(sent))))
    return got == [sent] and type(got[0]) is type(sent)


def random_reply(rng: random.Random) -> bytes:
    """Return a well-formed frame to the host."""
    return lsc.encode(random_answer(rng))


def device() -> Firmware:
    """Make a board with six servos that have limits."""
    board = LscBoard([SimServo(one, 500, (0, 1000), 3000.0) for one in range(1, 7)])
    for member in board.members:
        member.set_limits(*LIMITS)
    return board


def executed(firmware: Firmware) -> Dict[int, int]:
    """Return the target each servo last set out for."""
    assert isinstance(firmware, LscBoard)
    return firmware.commanded


KIT = Kit(
    name="lsc",
    peer="xarm",
    vectors=vectors,
    random_command=random_command,
    round_trip=round_trip,
    random_reply=random_reply,
    host_parser=lsc.host_parser,
    device_parser=lsc.device_parser,
    move_frame=lsc.encode(lsc.Move(1000, ((1, 500),))),
    device=device,
    executed=executed,
    is_checked=False,
)
