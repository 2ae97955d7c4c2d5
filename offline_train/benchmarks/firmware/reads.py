"""Reads over a line that spoils a share of the answers: what the bus takes for true, and how soon.

In simulated time, one servo asked at a time while all of them move. A value is wrong when it is
more than 6 degrees away from everywhere the shaft has been from the question to the answer.
Source: ours.
"""

import random
import zlib
from typing import Dict, List, NamedTuple

from apex_edge.verbs.progress import Progress
from firmware_bridge.bus import Bus
from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity
from firmware_bridge.simulator.direct_link import DirectLink
from firmware_bridge.simulator.servo import SimServo
from offline_train.benchmarks.firmware.devices import (
    IDS,
    TICKS_PER_DEG,
    FaultyAnswers,
    device,
    servos,
)
from offline_train.benchmarks.lines import Line, at_least, at_most, note

SUITE = "reads"
CHECKED = ("lx16a", "rrc-bus", "sts", "dxl2")
N_READS = 20000
N_LEAST = 2000  # fewer say nothing about 99.9 %
WRONG_DEG = 6.0
SOON_S = 0.025
_MOVE_EVERY = 100  # reads
_MOVE_S = 2.0


class Tally(NamedTuple):
    """What became of a number of reads."""

    n_reads: int
    n_soon: int
    n_wrong: int
    n_tries: int
    worst_s: float
    n_faults: int


def count(name: str, share: float, n_reads: int, seed: int) -> Tally:
    """Read positions over a faulty line and compare them with the truth."""
    rng = random.Random(zlib.crc32(f"{name} {share} {seed}".encode()))
    inner = device(name, seed)
    firmware = FaultyAnswers(inner, share, rng)
    moving = servos(inner)
    bus = Bus(protocol(name), DirectLink(firmware), clock=lambda: firmware.t_s)
    bus.open()
    wrong_ticks = WRONG_DEG * TICKS_PER_DEG[name]
    n_soon = n_wrong = n_tries = 0
    worst_s = 0.0
    with Progress(f"reads, {name}", n_reads) as progress:
        for at in range(n_reads):
            if at % _MOVE_EVERY == 0:
                _send_somewhere(moving, rng)
            servo = moving[IDS[at % len(IDS)]]
            began_s, first = firmware.t_s, servo.actual
            found = bus.read(Quantity.POSITION, (servo.servo_id,))
            lasted_s = firmware.t_s - began_s
            worst_s = max(worst_s, lasted_s)
            progress.advance()
            if servo.servo_id not in found:
                continue
            reading = found[servo.servo_id]
            low, high = sorted((first, servo.actual))
            off = max(low - reading.values[0], reading.values[0] - high)
            n_wrong += off > wrong_ticks
            n_soon += lasted_s <= SOON_S
            n_tries += reading.n_tries
    return Tally(n_reads, n_soon, n_wrong, n_tries, worst_s, firmware.n_faults)


def measure(scale: float, seed: int) -> List[Line]:
    """Return the lines of all checksummed protocols with position feedback, at 10 % and 30 %."""
    n_reads = max(int(N_READS * scale), N_LEAST)
    lines: List[Line] = []
    for name in CHECKED:
        tally = count(name, 0.1, n_reads, seed)
        what = f"{name}: {n_reads} reads, 10 % faulty answers"
        soon = 100.0 * tally.n_soon / n_reads
        lines += [
            at_most(SUITE, f"{what}: wrong by > 6 deg", tally.n_wrong, 0, "{:.0f}"),
            at_least(SUITE, f"{what}: answered within 25 ms, %", soon, 99.9, "{:.2f}"),
            at_most(SUITE, f"{what}: mean tries", _mean_tries(tally), 1.15, "{:.3f}"),
            note(SUITE, f"{what}: slowest, ms", 1e3 * tally.worst_s, "{:.1f}"),
        ]
        tally = count(name, 0.3, n_reads, seed)
        what = f"{name}: {n_reads} reads, 30 % faulty answers"
        soon = 100.0 * tally.n_soon / n_reads
        lines += [
            note(SUITE, f"{what}: wrong by > 6 deg", tally.n_wrong, "{:.0f}"),
            note(SUITE, f"{what}: answered within 25 ms, %", soon, "{:.2f}"),
            note(SUITE, f"{what}: mean tries", _mean_tries(tally), "{:.3f}"),
        ]
    return lines


def _mean_tries(tally: Tally) -> float:
    return tally.n_tries / max(tally.n_soon, 1)


def _send_somewhere(moving: Dict[int, SimServo], rng: random.Random) -> None:
    servo = moving[rng.choice(IDS)]
    low, high = servo.ticks
    servo.command(rng.uniform(0.2, 0.8) * (high - low) + low, _MOVE_S)
