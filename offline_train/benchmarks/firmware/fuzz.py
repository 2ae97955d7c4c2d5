"""Do bytes of any kind break anything: mutated frames, random bytes, in both directions.

Nothing is caught here: the first exception of a parser, decoder or simulated device ends the run.
"""

import random
from typing import List, Tuple

from apex_edge.verbs.progress import Progress
from firmware_bridge.codec import protocol
from firmware_bridge.codec.parser import Parser
from firmware_bridge.codec.protocol import Query, ServoProtocol
from firmware_bridge.simulator.damage import DAMAGE, damage
from offline_train.benchmarks.firmware.kit import Kit, kits
from offline_train.benchmarks.lines import Line, at_least, at_most

SUITE = "firmware fuzz"
N_FRAMES = 5_000_000
N_RANDOM_BYTES = 100_000_000
MAX_HELD = 512
_CHECK_BITS = {"lx16a": 8, "lsc": 0, "rrc": 8, "sts": 8, "dxl2": 16}
_BATCH = 1000
_CHUNK = 65536
_POOL = 500
_PROBES = 20_000


def measure(scale: float, seed: int) -> List[Line]:
    """Feed damaged frames and random bytes to everything that takes bytes.

    Parameters
    ----------
    scale : share of 5,000,000 mutated frames and of 100 MB random bytes, over all protocols.
    seed : of all chance.
    """
    lines: List[Line] = []
    all_kits = kits()
    n_frames = max(int(N_FRAMES * scale) // len(all_kits), 2)
    n_bytes = max(int(N_RANDOM_BYTES * scale) // len(all_kits), 1)
    n_fed = 0
    with Progress("fuzz", len(all_kits)) as progress:
        for kit in all_kits:
            rng = random.Random(f"{seed} {kit.name}")
            n_mutated, n_held = _mutate(kit, n_frames, rng)
            n_fed += n_mutated
            lines += _random_bytes(kit, n_bytes, n_held, rng)
            progress.advance()
    text = "mutated frames taken without an exception"
    return [at_least(SUITE, text, n_fed, n_frames * len(all_kits), "{:.0f}"), *lines]


def _mutate(kit: Kit, n_frames: int, rng: random.Random) -> Tuple[int, int]:
    """Return how many mutated frames were fed and the most bytes that a parser held."""
    drawn = [kit.random_command(rng)[0] for _ in range(_POOL)]
    commands = [frame for frame in drawn if len(frame) > 1]  # one byte cannot be cut
    answers = [kit.random_reply(rng) for _ in range(_POOL)]
    speech = protocol(kit.name)
    queries = _queries(speech)
    firmware, host, device = kit.device(), kit.host_parser(), kit.device_parser()
    kinds = list(DAMAGE)
    n_held = n_fed = 0
    while n_fed < n_frames:
        for _ in range(min(_BATCH, n_frames - n_fed) // 2 + 1):
            arriving = damage(rng.choice(commands), rng.choice(kinds), rng)
            firmware.feed(arriving)
            device.feed(arriving)
            for frame in host.feed(damage(rng.choice(answers), rng.choice(kinds), rng)):
                speech.match(rng.choice(queries), frame)
                speech.report(frame)
            n_fed += 2
            n_held = max(n_held, host.n_held, device.n_held)
        firmware.step(0.001)
        firmware.replies()
    return n_fed, n_held


def _queries(speech: ServoProtocol) -> List[Query]:
    """Return every question to servos 1..6."""
    quantities = sorted(speech.quantities, key=lambda one: one.value)
    return [query for one in quantities for query in speech.query(one, (1, 2, 3, 4, 5, 6))]


def _random_bytes(kit: Kit, n_bytes: int, n_held: int, rng: random.Random) -> List[Line]:
    parsers = (kit.host_parser(), kit.device_parser())
    expected = [n_bytes / 2 * _false_rate(kit, parser, rng) for parser in parsers]
    for _ in range(-(-n_bytes // (2 * _CHUNK))):
        for parser in parsers:
            parser.feed(rng.getrandbits(8 * _CHUNK).to_bytes(_CHUNK, "little"))
            n_held = max(n_held, parser.n_held)
    lines = [at_most(SUITE, f"{kit.name}: bytes held back at most", n_held, MAX_HELD, "{:.0f}")]
    if parsers[0].header:
        n_false = sum(parser.n_frames for parser in parsers)
        text = f"{kit.name}: false frames in {n_bytes / 1e6:.3g} MB of random bytes"
        text += ", at most 10 times the analytic number"
        lines.append(at_most(SUITE, text, n_false, 10.0 * sum(expected), "{:.3g}"))
    return lines


def _false_rate(kit: Kit, parser: Parser, rng: random.Random) -> float:
    """Return how likely a frame starts at a random byte: header, shape, checksum.

    The share of legal shapes behind a header is sampled; without a checksum what the values must
    be is part of it.
    """
    if not parser.header:
        return 1.0
    n_legal = 0
    for _ in range(_PROBES):
        probe = bytearray(parser.header + rng.getrandbits(2048).to_bytes(256, "little"))
        n_legal += parser.measure(probe, 0) > 0
    # where not one was drawn, the upper end of what that allows
    share = max(n_legal, 1) / _PROBES
    return float(2.0 ** -(8 * len(parser.header) + _CHECK_BITS[kit.name])) * share
