"""What each protocol brings to the proofs: vectors, random commands, a peer, a simulated device."""

import importlib
import random
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from firmware_bridge.codec.parser import Parser
from firmware_bridge.simulator.base import Firmware


class Vector(NamedTuple):
    """One byte-exact case: our bytes beside those of the vendor's or a peer's library."""

    what: str
    ours: bytes
    expected: bytes


class Kit(NamedTuple):
    """One protocol under test; everything random comes out of the generator that is passed in.

    ``random_command`` returns our bytes and the peer's (None without the peer);
    ``round_trip`` says whether decode(encode(x)) == x for a random message x of either direction;
    ``random_reply`` returns a well-formed frame to the host; ``move_frame`` is the frame that the
    facts of error detection are stated for; ``device`` makes a simulated device that the frame
    moves, with ids 1..6 and limits 200..800 (or their like in the protocol's ticks), and
    ``executed`` returns the last commanded target per id of such a device.
    """

    name: str
    peer: str
    vectors: Callable[[], Sequence[Vector]]
    random_command: Callable[[random.Random], Tuple[bytes, Optional[bytes]]]
    round_trip: Callable[[random.Random], bool]
    random_reply: Callable[[random.Random], bytes]
    host_parser: Callable[[], Parser]
    device_parser: Callable[[], Parser]
    move_frame: bytes
    device: Callable[[], Firmware]
    executed: Callable[[Firmware], Dict[int, int]]
    is_checked: bool = True


KITS = ("lx16a", "lsc", "rrc", "sts", "dxl2", "i2c")


def kit(name: str) -> Kit:
    """Return the kit of a protocol: ``KIT`` in the module ``kit_NAME`` beside this one."""
    found: Kit = importlib.import_module(f"{__package__}.kit_{name}").KIT
    return found


def kits() -> List[Kit]:
    """Return the kits of all protocols."""
    return [kit(name) for name in KITS]


def framed_kits() -> List[Kit]:
    """Return the kits of protocols whose frames start with a header; I2C has no need of one."""
    return [each for each in kits() if each.host_parser().header]
