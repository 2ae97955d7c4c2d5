"""What a bad line does to one frame. Seeded: the random generator is passed in.

Source: the classes of damage that users of servo buses report, see docs/hardware/simulator.md.
"""

import random
from typing import Callable, Dict


def _flip(frame: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(8 * len(frame))
    out = bytearray(frame)
    out[at // 8] ^= 1 << (at % 8)
    return bytes(out)


def _flip_two(frame: bytes, rng: random.Random) -> bytes:
    out = bytearray(frame)
    for at in rng.sample(range(8 * len(frame)), 2):
        out[at // 8] ^= 1 << (at % 8)
    return bytes(out)


def _burst(frame: bytes, rng: random.Random) -> bytes:
    """Change up to 8 bits in a row, the first and the last of them for certain."""
    n_bits = rng.randint(2, 8)
    start = rng.randrange(8 * len(frame) - n_bits + 1)
    pattern = 1 | (1 << (n_bits - 1)) | rng.getrandbits(n_bits)
    whole = int.from_bytes(frame, "little") ^ (pattern << start)
    return whole.to_bytes(len(frame), "little")


def _drop(frame: bytes, rng: random.Random) -> bytes:
    at = rng.randrange(len(frame))
    return frame[:at] + frame[at + 1 :]


def _insert(frame: bytes, rng: random.Random) -> bytes:
    at = rng.randint(0, len(frame))
    return frame[:at] + bytes((rng.randrange(256),)) + frame[at:]


def _truncate(frame: bytes, rng: random.Random) -> bytes:
    return frame[: rng.randrange(1, len(frame))]


def _garbage(frame: bytes, rng: random.Random) -> bytes:
    return bytes(rng.randrange(256) for _ in frame)


def _long_length(frame: bytes, rng: random.Random) -> bytes:
    """Force one byte behind the header to 255: in most protocols that is, or grows, the length."""
    at = min(rng.choice((2, 3)), len(frame) - 1)
    return frame[:at] + b"\xff" + frame[at + 1 :]


def _duplicate(frame: bytes, rng: random.Random) -> bytes:
    return frame * 2


DAMAGE: Dict[str, Callable[[bytes, random.Random], bytes]] = {
    "flip": _flip,
    "flip-two": _flip_two,
    "burst": _burst,
    "drop": _drop,
    "insert": _insert,
    "truncate": _truncate,
    "garbage": _garbage,
    "long-length": _long_length,
    "duplicate": _duplicate,
}


def damage(frame: bytes, kind: str, rng: random.Random) -> bytes:
    """Return what arrives of a frame (at least 2 bytes) that a line damages in the given way."""
    return DAMAGE[kind](frame, rng)
