"""How many intact frames get through when one in twenty is damaged, in every way there is."""

import random
from collections import Counter
from typing import Any, Callable, Iterator, List, Optional, Sequence, Tuple

from apex_edge.verbs.progress import Progress
from firmware_bridge.codec import lx
from firmware_bridge.simulator.damage import DAMAGE, damage
from offline_train.benchmarks.firmware import peers
from offline_train.benchmarks.firmware.byte_machine import FRAMINGS, ByteMachine
from offline_train.benchmarks.firmware.kit import Kit, framed_kits
from offline_train.benchmarks.lines import Line, at_most, note

SUITE = "firmware resync"
N_FRAMES = 20_000
SHARE_BAD = 0.05
_MAX_CHUNK = 64


def measure(scale: float, seed: int) -> List[Line]:
    """Count intact frames that parsers deliver.

    Parameters
    ----------
    scale : share of 20,000 frames per protocol, class of damage and direction.
    seed : of all chance.
    """
    n_frames = max(int(N_FRAMES * scale), 20)
    lines: List[Line] = []
    with Progress("resync", len(framed_kits())) as progress:
        for kit in framed_kits():
            rng = random.Random(f"{seed} {kit.name}")
            lines += _of(kit, n_frames, rng)
            progress.advance()
    return lines + _peer_lines(n_frames, random.Random(f"{seed} peers"))


def _of(kit: Kit, n_frames: int, rng: random.Random) -> List[Line]:
    n_missed = n_intact = n_extra_clean = 0
    shares: List[Tuple[float, str]] = []
    for make in (kit.random_reply, lambda chance: kit.random_command(chance)[0]):
        is_reply = make is kit.random_reply
        new = kit.host_parser if is_reply else kit.device_parser
        clean = [make(rng) for _ in range(n_frames)]
        parser = new()
        n_extra_clean += len(parser.feed(b"".join(clean)) + parser.flush()) - n_frames
        for kind in DAMAGE:
            stream, intact = damaged_stream(clean, kind, rng)
            parser = new()
            n_missed += n_missing(intact, _chunked(parser.feed, stream, rng) + parser.flush())
            n_intact += len(intact)
            if is_reply:
                machine = ByteMachine(parser.header, FRAMINGS[kit.name], parser.check)
                n_lost = n_missing(intact, machine.feed(stream))
                shares.append((1.0 - n_lost / max(len(intact), 1), kind))
    worst, kind = min(shares)
    mean = sum(share for share, _ in shares) / len(shares)
    return [
        at_most(SUITE, f"{kit.name}: intact frames missed of {n_intact}", n_missed, 0, "{:.0f}"),
        note(SUITE, f"{kit.name}: frames too many in undamaged streams", n_extra_clean, "{:.0f}"),
        note(SUITE, f"{kit.name}: share that a byte machine delivers", mean, "{:.4f}"),
        note(SUITE, f"{kit.name}: its share with {kind}, the worst", worst, "{:.4f}"),
    ]


def damaged_stream(
    frames: Sequence[bytes], kind: str, rng: random.Random
) -> Tuple[bytes, List[bytes]]:
    """Return a stream in which some frames are damaged, and the frames that are not."""
    out, intact = bytearray(), []
    for frame in frames:
        if rng.random() < SHARE_BAD:
            out += damage(frame, kind, rng)
        else:
            out += frame
            intact.append(frame)
    return bytes(out), intact


def n_missing(intact: Sequence[bytes], delivered: Sequence[bytes]) -> int:
    """Return how many intact frames were not delivered in their order, or at all."""
    found = iter(delivered)
    if all(frame in found for frame in intact):
        return 0
    short = Counter(intact) - Counter(delivered)
    return max(sum(short.values()), 1)


def _chunked(
    feed: Callable[[bytes], List[bytes]], stream: bytes, rng: random.Random
) -> List[bytes]:
    frames: List[bytes] = []
    at = 0
    while at < len(stream):
        n = rng.randint(1, _MAX_CHUNK)
        frames += feed(stream[at : at + n])
        at += n
    return frames


class _Tape:
    """A port that holds a stream and answers reads with the next of its bytes."""

    timeout = 0.0

    def __init__(self, stream: bytes) -> None:
        self._stream, self._at = stream, 0

    @property
    def is_over(self) -> bool:
        return self._at >= len(self._stream)

    def read(self, n_bytes: int = 1) -> bytes:
        data = self._stream[self._at : self._at + n_bytes]
        self._at += len(data)
        return data


def _peer_lines(n_frames: int, rng: random.Random) -> List[Line]:
    """Measure the readers of two LX libraries on position answers of one servo."""
    frames = [
        lx.encode_reply(lx.Message(1, lx.POS_READ, (rng.randint(0, 1000),)))
        for _ in range(n_frames)
    ]
    lines = []
    for name, reader in (("lewansoul-lx16a", _lewansoul), ("pylx16a", _pylx16a)):
        read = reader()
        if read is None:
            lines.append(Line(SUITE, f"lx16a: share that {name} delivers", "not installed"))
            continue
        worst, worst_kind, total = 1.0, "", 0.0
        for kind in DAMAGE:
            stream, intact = damaged_stream(frames, kind, rng)
            share = 1.0 - n_missing(intact, list(read(_Tape(stream)))) / len(intact)
            total += share / len(DAMAGE)
            if share <= worst:
                worst, worst_kind = share, kind
        lines.append(note(SUITE, f"lx16a: share that {name} delivers", total, "{:.4f}"))
        text = f"lx16a: its share with {worst_kind}, the worst"
        lines.append(note(SUITE, text, worst, "{:.4f}"))
    return lines


def _lewansoul() -> Optional[Callable[[_Tape], Iterator[bytes]]]:
    module: Any = peers.load("lewansoul-lx16a", "lewansoul_lx16a")
    if module is None:
        return None
    module.LOGGER.disabled = True

    def read(tape: _Tape) -> Iterator[bytes]:
        controller = module.ServoController(tape, timeout=60)
        while not tape.is_over:
            try:
                servo_id, command, *content = controller._wait_for_response(1, lx.POS_READ)
            except module.TimeoutError:
                return
            yield lx.frame_bytes(servo_id, command, bytes(content))

    return read


def _pylx16a() -> Optional[Callable[[_Tape], Iterator[bytes]]]:
    module: Any = peers.load("pylx16a", "pylx16a.lx16a")
    if module is None:
        return None

    def read(tape: _Tape) -> Iterator[bytes]:
        module.LX16A._controller = tape
        while not tape.is_over:
            try:
                content = module.LX16A._read_packet(2, 1)
            except (module.ServoTimeoutError, module.ServoChecksumError):
                continue
            yield lx.frame_bytes(1, lx.POS_READ, bytes(content))

    return read
