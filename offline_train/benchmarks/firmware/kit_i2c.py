"""The I2C board under test. There is no library to compare frames with, only published bytes.

smbus2's messages carry ours in ``random_command`` where it is there: they must not change a byte.
"""

import random
from typing import Dict, List, Optional, Sequence, Tuple, Union

from firmware_bridge.codec import i2c
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.i2c_board import I2cBoard
from firmware_bridge.simulator.servo import SimServo
from offline_train.benchmarks.firmware import peers
from offline_train.benchmarks.firmware.kit import Kit, Vector

_START_US = 1000
_FACTS: Tuple[Tuple[str, Union[i2c.ToBoard, i2c.Battery], str], ...] = (
    (
        "ids 1, 3 to 1000, 2000 in 800 ms",
        i2c.Move(800, ((1, 1000), (3, 2000))),
        "28 02 20 03 01 E8 03 03 D0 07",
    ),
    (
        "the paper's start pose",
        i2c.Move(3000, ((3, 500), (4, 2171), (5, 1500), (6, 1500))),
        "28 04 B8 0B 03 F4 01 04 7B 08 05 DC 05 06 DC 05",
    ),
    (
        "the paper's reset pose",
        i2c.Move(3000, ((3, 1602), (4, 1630), (5, 2487), (6, 1500))),
        "28 04 B8 0B 03 42 06 04 5E 06 05 B7 09 06 DC 05",
    ),
    ("gripper", i2c.Move(800, ((1, 1500),)), "28 01 20 03 01 DC 05"),
    ("battery request", i2c.BatteryRequest(), "00"),
    ("battery 12220 mV", i2c.Battery(12220), "BC 2F"),
)


def vectors() -> Sequence[Vector]:
    """Return the published frames beside ours."""
    return [Vector(what, i2c.encode(one), bytes.fromhex(text)) for what, one, text in _FACTS]


def random_message(rng: random.Random) -> i2c.ToBoard:
    """Make any message to the board."""
    kind = rng.randrange(4)
    servo_id = rng.randint(1, i2c.MAX_ID)
    if kind == 0:
        return i2c.BatteryRequest()
    if kind == 1:
        return i2c.Angle(servo_id, rng.randint(0, 180))
    if kind == 2:
        return i2c.Motor(rng.randint(1, i2c.N_MOTORS), rng.randint(-100, 100))
    ids = rng.sample(range(1, i2c.MAX_ID + 1), rng.randint(1, i2c.MAX_ID))
    targets = tuple((one, rng.randint(500, 2500)) for one in ids)
    return i2c.Move(rng.randint(0, 30000), targets)


def random_command(rng: random.Random) -> Tuple[bytes, Optional[bytes]]:
    """Return our bytes of any message, and what smbus2's message of them would put on the wire."""
    ours = i2c.encode(random_message(rng))
    module = peers.load("smbus2", "smbus2") if not _LOADED else None
    if module is not None:
        _LOADED.append(module.i2c_msg)
    if not _LOADED:
        return ours, None
    return ours, bytes(_LOADED[0].write(i2c.ADDRESS, list(ours)))  # type: ignore[attr-defined]


_LOADED: List[object] = []


def round_trip(rng: random.Random) -> bool:
    """Say whether a random message of either direction comes back as it was."""
    if rng.random() < 0.5:
        message = random_message(rng)
        frames = i2c.board_parser().feed(i2c.encode(message))
        back = [i2c.decode_to_board(frame) for frame in frames]
        return back == [message] and type(back[0]) is type(message)
    battery = i2c.Battery(rng.randint(0, 0xFFFF))
    frames = i2c.host_parser().feed(i2c.encode(battery))
    return [i2c.decode_from_board(frame) for frame in frames] == [battery]


def random_reply(rng: random.Random) -> bytes:
    """Return a voltage that a supply can have."""
    return i2c.encode(i2c.Battery(rng.randint(*i2c.PLAUSIBLE_MV)))


def device() -> Firmware:
    """Make a board with six servos; it has no limits but 500..2500 us."""
    return I2cBoard([SimServo(one, _START_US, (500, 2500), 3300.0) for one in range(1, 7)])


def executed(firmware: Firmware) -> Dict[int, int]:
    """Return the pulse each servo was last commanded to."""
    assert isinstance(firmware, I2cBoard)
    return firmware.commanded


KIT = Kit(
    name="i2c",
    peer="smbus2 (carries the bytes)",
    vectors=vectors,
    random_command=random_command,
    round_trip=round_trip,
    random_reply=random_reply,
    host_parser=i2c.host_parser,
    device_parser=i2c.board_parser,
    move_frame=i2c.encode(i2c.Move(800, ((1, 1500),))),
    device=device,
    executed=executed,
    is_checked=False,
)
