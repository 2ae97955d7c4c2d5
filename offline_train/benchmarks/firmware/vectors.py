"""Are the bytes right: published frames, other people's libraries, the way back, any chunks."""

import random
from typing import List

from apex_edge.verbs.progress import Progress
from firmware_bridge.simulator.damage import DAMAGE, damage
from offline_train.benchmarks.firmware.kit import Kit, kits
from offline_train.benchmarks.lines import Line, at_most, note

SUITE = "firmware vectors"
N_COMMANDS = 100_000
_N_STREAMS = 2000
_N_IN_STREAM = 12


def measure(scale: float, seed: int) -> List[Line]:
    """Compare bytes of every protocol.

    Parameters
    ----------
    scale : share of 100,000 random commands per protocol.
    seed : of all chance.
    """
    lines: List[Line] = []
    with Progress("vectors", len(kits())) as progress:
        for kit in kits():
            lines += _of(kit, max(int(N_COMMANDS * scale), 1), random.Random(f"{seed} {kit.name}"))
            progress.advance()
    return lines


def _of(kit: Kit, n_commands: int, rng: random.Random) -> List[Line]:
    cases = kit.vectors()
    n_wrong = sum(case.ours != case.expected for case in cases)
    pairs = [kit.random_command(rng) for _ in range(n_commands)]
    compared = [(ours, theirs) for ours, theirs in pairs if theirs is not None]
    n_lost = sum(not kit.round_trip(rng) for _ in range(n_commands))
    n_streams = max(_N_STREAMS * n_commands // N_COMMANDS, 1)
    n_torn = sum(not is_same_in_chunks(kit, rng) for _ in range(n_streams))
    what = f"{kit.name}: "
    lines = [at_most(SUITE, f"{what}{len(cases)} published frames, wrong", n_wrong, 0)]
    if compared:
        n_other = sum(ours != theirs for ours, theirs in compared)
        text = f"{what}{len(compared)} random commands, other than {kit.peer}"
        lines.append(at_most(SUITE, text, n_other, 0))
    if len(compared) < len(pairs):
        text = f"{what}commands without a peer ({kit.peer}) to compare with"
        lines.append(note(SUITE, text, len(pairs) - len(compared), "{:.0f}"))
    lines.append(at_most(SUITE, f"{what}{n_commands} round trips, changed", n_lost, 0))
    lines.append(
        at_most(SUITE, f"{what}{n_streams} damaged streams in chunks, other frames", n_torn, 0)
    )
    return lines


def is_same_in_chunks(kit: Kit, rng: random.Random) -> bool:
    """Say whether a stream with damage in it gives the same frames in one piece and in many."""
    stream = b""
    for _ in range(_N_IN_STREAM):
        frame = kit.random_reply(rng)
        stream += damage(frame, rng.choice(list(DAMAGE)), rng) if rng.random() < 0.3 else frame
    whole, torn = kit.host_parser(), kit.host_parser()
    in_one = whole.feed(stream) + whole.flush()
    in_many: List[bytes] = []
    at = 0
    while at < len(stream):
        n = rng.randint(1, 9)
        in_many += torn.feed(stream[at : at + n])
        at += n
    in_many += torn.flush()
    return in_one == in_many
