"""Moves over a line that damages a share of the frames: what is executed, and what is noticed.

In simulated time. A servo is wrong when the target that it was last told differs from the one the
host meant it to have. Every such move must be named by the answer to that very move; a protocol
that tells no targets must name it within 100 ms of the move's end. Source: ours.
"""

import random
import zlib
from typing import Dict, List, NamedTuple, Set, Tuple

from apex_edge.verbs.progress import Progress
from firmware_bridge.bus import Bus, BusSettings, Priority, Verdict
from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import ServoProtocol, ServoTarget
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.damage import DAMAGE, damage
from firmware_bridge.simulator.direct_link import DirectLink
from offline_train.benchmarks.firmware.devices import IDS, device, servos
from offline_train.benchmarks.lines import Line, at_most, note

SUITE = "noisy-moves"
VERIFIED = ("lx16a", "rrc-bus", "sts", "dxl2", "lsc")
UNVERIFIABLE = ("rrc", "i2c")
N_MOVES = 100_000
NOISE_SHARE = 0.1
LATE_S = 0.1
_LOW_SHARE, _HIGH_SHARE = 0.2, 0.8
_DURATION_MS = 20
_TICKS_S = 20_000
_STEP_SHARE = 0.02
_NEAR_TICKS = 1


class Tally(NamedTuple):
    """What became of a number of moves.

    ``n_wrong``: after the first sending a servo held a target that nobody meant; ``n_missed`` of
    them the answer did not name, ``n_late`` came later than allowed; ``n_left`` moves ended with a
    servo that was not told right, and said so; ``n_limp`` switched a torque off, which executes
    no target and is for the session to see.
    """

    n_moves: int
    n_outside: int
    n_wrong: int
    n_missed: int
    n_late: int
    n_left: int
    n_limp: int


class NoisyLine:
    """Damage a share of the frames to the servos while it is switched on."""

    def __init__(self, share: float, rng: random.Random) -> None:
        self.is_on = False
        self.n_damaged = 0
        self._share, self._rng = share, rng
        self._kinds = sorted(DAMAGE)

    def __call__(self, data: bytes) -> bytes:
        """Return what arrives of a frame."""
        if not self.is_on or self._rng.random() >= self._share:
            return data
        self.n_damaged += 1
        return damage(data, self._rng.choice(self._kinds), self._rng)


class Watch:
    """Hear from the servos themselves what they are told, whatever the host believes."""

    def __init__(self, firmware: Firmware) -> None:
        self.told: Dict[int, float] = {}
        self.seen: Set[Tuple[int, float]] = set()
        self._servos = servos(firmware)
        for servo in self._servos.values():
            self.told[servo.servo_id] = servo.target
            servo.on_event = self._note

    @property
    def limp(self) -> Set[int]:
        """Ids of servos whose torque is off."""
        return {i for i, servo in self._servos.items() if not servo.is_torque_on}

    def _note(self, servo: object, what: str, numbers: Dict[str, float]) -> None:
        if what == "move":
            servo_id: int = servo.servo_id  # type: ignore[attr-defined]
            self.told[servo_id] = numbers["ticks"]
            self.seen.add((servo_id, numbers["ticks"]))


def count(name: str, n_moves: int, seed: int) -> Tally:
    """Move one servo after the other to random places over a noisy line."""
    rng = random.Random(zlib.crc32(f"{name} {seed}".encode()))
    firmware, dialect = device(name, seed), protocol(name)
    line = NoisyLine(NOISE_SHARE, rng)
    bus = Bus(dialect, DirectLink(firmware, line), BusSettings(), lambda: firmware.t_s)
    bus.open()
    low, high = _limits(bus, dialect)
    middle = (low + high) // 2
    bus.move([ServoTarget(i, middle, _TICKS_S) for i in IDS], _DURATION_MS)
    watch = Watch(firmware)
    meant = {servo_id: middle for servo_id in IDS}
    watch.told.update(meant)
    n_outside = n_wrong = n_missed = n_late = n_left = n_limp = 0
    line.is_on = True
    with Progress(f"moves, {name}", n_moves) as progress:
        for at in range(n_moves):
            target = _next_target(rng, IDS[at % len(IDS)], meant, (low, high))
            meant[target.servo_id] = target.ticks
            watch.seen.clear()
            began_s = firmware.t_s
            verdicts = bus.move([target], _DURATION_MS)
            lasted_s = firmware.t_s - began_s - _DURATION_MS / 1000.0
            n_outside += any(not low <= ticks <= high for _, ticks in watch.seen)
            strays = {i for i, ticks in watch.seen if abs(ticks - meant[i]) > _NEAR_TICKS}
            wrong = {i for i, told in watch.told.items() if abs(told - meant[i]) > _NEAR_TICKS}
            limp = watch.limp
            wrong -= limp
            named = {i for i, verdict in verdicts.items() if verdict is not Verdict.CONFIRMED}
            n_wrong += bool(strays)
            n_missed += bool(wrong - named)
            n_late += bool(wrong) and lasted_s > LATE_S
            n_left += bool(named)
            n_limp += bool(limp)
            if named or wrong or limp:
                _put_right(bus, line, meant)
                watch.told.update(meant)
            progress.advance()
    return Tally(n_moves, n_outside, n_wrong, n_missed, n_late, n_left, n_limp)


def measure(scale: float, seed: int) -> List[Line]:
    """Return the lines of every protocol."""
    n_moves = max(int(N_MOVES * scale), 1)
    lines: List[Line] = []
    for name in VERIFIED:
        tally = count(name, n_moves, seed)
        what = f"{name}: {n_moves} moves, 10 % damaged"
        lines += [
            at_most(SUITE, f"{what}: executed outside limits", tally.n_outside, 0, "{:.0f}"),
            at_most(SUITE, f"{what}: wrong and not noticed", tally.n_missed, 0, "{:.0f}"),
            at_most(SUITE, f"{what}: noticed later than 100 ms", tally.n_late, 0, "{:.0f}"),
            note(SUITE, f"{what}: a wrong target was executed", tally.n_wrong, "{:.0f}"),
            note(SUITE, f"{what}: reported wrong after all tries", tally.n_left, "{:.0f}"),
            note(SUITE, f"{what}: switched a torque off", tally.n_limp, "{:.0f}"),
        ]
    for name in UNVERIFIABLE:
        lines.append(_says_so(name))
    return lines


def _says_so(name: str) -> Line:
    """Return whether a protocol without read-back says that it cannot tell."""
    firmware = device(name, 0)
    bus = Bus(protocol(name), DirectLink(firmware), clock=lambda: firmware.t_s)
    bus.open()
    verdicts = bus.move([ServoTarget(1, 1500)], _DURATION_MS)
    n_claims = sum(verdict is not Verdict.UNVERIFIABLE for verdict in verdicts.values())
    return at_most(SUITE, f"{name}: moves claimed to be verified", n_claims, 0, "{:.0f}")


def _limits(bus: Bus, dialect: ServoProtocol) -> Tuple[int, int]:
    """Store limits in every servo that can keep them; return what the servos must keep within."""
    low, high = dialect.ticks
    span = high - low
    inner = (low + int(_LOW_SHARE * span), low + int(_HIGH_SHARE * span))
    is_kept = False
    for servo_id in IDS:
        frames = dialect.set_limits(servo_id, *inner)
        is_kept = bool(frames)
        bus.send(frames, Priority.MOVE)
    return inner if is_kept else (low, high)


def _next_target(
    rng: random.Random, servo_id: int, meant: Dict[int, int], limits: Tuple[int, int]
) -> ServoTarget:
    """Return a new place, near enough to be reached within the move."""
    low, high = limits
    most = int(_STEP_SHARE * (high - low))
    step = rng.choice((-1, 1)) * rng.randint(most // 2, most)
    ticks = meant[servo_id] + step
    if not low <= ticks <= high:
        ticks = meant[servo_id] - step
    return ServoTarget(servo_id, ticks, _TICKS_S)


def _put_right(bus: Bus, line: NoisyLine, meant: Dict[int, int]) -> None:
    """Bring all servos back to where they should be, over a quiet line."""
    line.is_on = False
    bus.send(bus.protocol.torque(IDS, True), Priority.MOVE)
    bus.move([ServoTarget(i, ticks, _TICKS_S) for i, ticks in meant.items()], _DURATION_MS)
    line.is_on = True
