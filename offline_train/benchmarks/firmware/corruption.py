"""What a damaged move frame does to a simulated device: every single bit, every short burst.

All changes of 1 bit and all bursts of 2 to 8 bits (first and last bit changed, wire order), fed to
the device through its own parser. With a sum or a CRC none may be executed, for two reasons that
can be proved; boards without a check are reported. Source: ours.
"""

import importlib.util
import random
from typing import Iterator, List, NamedTuple, Sequence

from apex_edge.verbs.progress import Progress
from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import ServoTarget
from firmware_bridge.errors import ProtocolError
from offline_train.benchmarks.firmware.kit import KITS, Kit, kit
from offline_train.benchmarks.firmware.plain_check import PLAIN
from offline_train.benchmarks.lines import Line, at_most, note

SUITE = "corruption"
_BURST_BITS = 8
_SILENCE_S = 0.02
_DURATION_MS = 150


class Count(NamedTuple):
    """How many changed frames there were, were taken for well formed, and moved a servo."""

    n_frames: int
    n_accepted: int
    n_executed: int


def single_bits(frame: bytes) -> Iterator[bytes]:
    """Return the frame with each of its bits changed in turn."""
    for at in range(8 * len(frame)):
        yield changed(frame, 1 << at)


def bursts(frame: bytes, most_bits: int = _BURST_BITS) -> Iterator[bytes]:
    """Return the frame after every burst of 2..most_bits bits: first and last bit changed."""
    for n_bits in range(2, most_bits + 1):
        for start in range(8 * len(frame) - n_bits + 1):
            for middle in range(1 << (n_bits - 2)):
                yield changed(frame, (1 | middle << 1 | 1 << (n_bits - 1)) << start)


def two_bits(frame: bytes) -> Iterator[bytes]:
    """Return the frame with every pair of its bits changed."""
    n_bits = 8 * len(frame)
    for one in range(n_bits):
        for other in range(one + 1, n_bits):
            yield changed(frame, 1 << one | 1 << other)


def changed(frame: bytes, mask: int) -> bytes:
    """Return the frame with the bits of a mask changed, least significant bit of a byte first."""
    whole = int.from_bytes(frame, "little") ^ mask
    return whole.to_bytes(len(frame), "little")


def count(under: Kit, frames: Sequence[bytes], progress: Progress) -> Count:
    """Feed each frame to a device, let the line fall silent, and see what it did."""
    n_accepted = n_executed = 0
    device = under.device()
    before = dict(under.executed(device))
    for frame in frames:
        n_accepted += is_accepted(under, frame)
        device.feed(frame)
        device.step(_SILENCE_S)
        device.replies()
        if under.executed(device) != before:
            n_executed += 1
            device = under.device()  # so that the same target is noticed again
            before = dict(under.executed(device))
        progress.advance()
    return Count(len(frames), n_accepted, n_executed)


def is_accepted(under: Kit, frame: bytes) -> bool:
    """Say whether the device's parser takes any part of it for a frame.

    Without a check only the whole counts: of an I2C transaction there are no parts.
    """
    parser = under.device_parser()
    found = parser.feed(frame) + parser.flush()
    return bool(found) if under.is_checked else found == [frame]


def bus_frames(under: Kit) -> List[bytes]:
    """Return the frames that the bus sends for a move of six servos in this protocol."""
    speaks = protocol(under.name)
    low, high = speaks.ticks
    targets = [ServoTarget(one, (low + high) // 2 + one, 100) for one in range(1, 7)]
    return list(speaks.move(targets, _DURATION_MS))


def kits() -> List[Kit]:
    """Return the kits that are there."""
    names = [name for name in KITS if importlib.util.find_spec(f"{__package__}.kit_{name}")]
    return [kit(name) for name in names]


def measure(scale: float, seed: int) -> List[Line]:
    """Return what damaged moves do, per protocol; below ``scale`` 1.0 a sample of the bursts."""
    rng = random.Random(seed)
    lines = plain_lines()
    for under in kits():
        _check_that_it_moves(under)
        every = list(bursts(under.move_frame))
        lines += _lines(under, "1 bit", list(single_bits(under.move_frame)))
        lines += _lines(under, "burst <= 8 bits", _sample(every, scale, rng))
        pairs = _sample(list(two_bits(under.move_frame)), scale, rng)
        n_taken = sum(is_accepted(under, frame) for frame in pairs)
        lines.append(_taken(f"{under.name}: 2 bits, taken for a frame", n_taken, len(pairs)))
        if under.is_checked:
            damaged = [one for frame in bus_frames(under) for one in bursts(frame)]
            sent = [one for frame in bus_frames(under) for one in single_bits(frame)]
            lines += _lines(under, "six servos, 1 bit", _sample(sent, scale, rng))
            lines += _lines(under, "six servos, burst <= 8 bits", _sample(damaged, scale, rng))
    return lines


def plain_lines() -> List[Line]:
    """Return what passes header, length and sum alone: exhaustive, so equal to the known counts."""
    lines: List[Line] = []
    for name, plain in PLAIN.items():
        changes = (single_bits(plain.frame), two_bits(plain.frame), bursts(plain.frame))
        found = tuple(sum(map(plain.looks_right, frames)) for frames in changes)
        texts = [" / ".join(str(one) for one in counts) for counts in (found, plain.known)]
        what = f"{name}: looks right after 1 bit / 2 bits / burst"
        lines.append(Line(SUITE, what, texts[0], texts[1], found == plain.known))
    return lines


def _lines(under: Kit, what: str, frames: Sequence[bytes]) -> List[Line]:
    with Progress(f"{under.name}, {what}", len(frames)) as progress:
        found = count(under, frames, progress)
    label = f"{under.name}: {what}, executed of {found.n_frames}"
    if under.is_checked:
        return [at_most(SUITE, label, found.n_executed, 0, "{:.0f}")]
    taken = _taken(f"{under.name}: {what}, taken for a frame", found.n_accepted, found.n_frames)
    return [note(SUITE, label, found.n_executed, "{:.0f}"), taken]


def _taken(what: str, n_taken: int, n_frames: int) -> Line:
    figures = {"taken": float(n_taken), "of": float(n_frames)}
    return Line(SUITE, what, f"{n_taken}/{n_frames}", "", None, figures)


def _sample(frames: Sequence[bytes], scale: float, rng: random.Random) -> List[bytes]:
    if scale >= 1.0:
        return list(frames)
    return rng.sample(list(frames), max(1, round(len(frames) * scale)))


def _check_that_it_moves(under: Kit) -> None:
    """Make sure that the undamaged frame moves the device: otherwise none of this says anything."""
    device = under.device()
    before = dict(under.executed(device))
    device.feed(under.move_frame)
    if under.executed(device) == before:
        raise ProtocolError(f"{under.name}: the undamaged move frame moves nothing")
