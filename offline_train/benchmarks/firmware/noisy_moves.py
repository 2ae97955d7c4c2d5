"""Moves over a line that damages a share of the frames: what is executed, and what is noticed.

In simulated time. A servo is wrong when the target that it last set out for differs from the one
the host meant it to have. Every such move must be named by the answer to that very move, unless it
was sent again and is right by then. Where a protocol tells positions but no targets, wrong is more
than 6 degrees, a move is sent once, and the answer must come within 100 ms of the move's end.
Source: ours.
"""

import random
import zlib
from typing import Dict, List, NamedTuple, Set, Tuple

from apex_edge.verbs.progress import Progress
from firmware_bridge.bus import Bus, BusSettings, Priority, Verdict
from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.damage import DAMAGE, damage
from firmware_bridge.simulator.direct_link import DirectLink
from offline_train.benchmarks.firmware.devices import IDS, TICKS_PER_DEG, device, servos
from offline_train.benchmarks.lines import Line, at_most, note

SUITE = "noisy-moves"
VERIFIED = ("lx16a", "rrc-bus", "sts", "dxl2", "lsc")
UNVERIFIABLE = ("rrc", "i2c")
N_MOVES = 100_000
NOISE_SHARE = 0.1
LATE_S = 0.1
WRONG_DEG = 6.0
_LOW_SHARE, _HIGH_SHARE = 0.2, 0.8
_TICKS_S = 20_000


class _Plan(NamedTuple):
    """How far and how fast it goes, and what counts as wrong."""

    duration_ms: int
    step_share: float  # of the range between the limits, at most
    wrong_ticks: float
    n_move_tries: int


def _plan(name: str) -> _Plan:
    if Quantity.TARGET in protocol(name).quantities:
        return _Plan(20, 0.02, 1.0, BusSettings().n_move_tries)
    return _Plan(80, 0.1, WRONG_DEG * TICKS_PER_DEG[name], 1)


class Tally(NamedTuple):
    """What became of a number of moves.

    ``n_wrong``: a servo set out for a target that nobody meant; ``n_missed``: one is not told right
    at the end and the answer does not name it; ``n_late``: it set out for a wrong one and the
    answer came later than allowed; ``n_left`` moves ended with a
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


class Rig:
    """A device with limits, a bus over a noisy line, and what the servos should have been told."""

    def __init__(self, name: str, seed: int, rng: random.Random) -> None:
        self.plan = _plan(name)
        self.firmware = device(name, seed)
        self.line = NoisyLine(NOISE_SHARE, rng)
        settings = BusSettings(n_move_tries=self.plan.n_move_tries)
        link = DirectLink(self.firmware, self.line)
        self.bus = Bus(protocol(name), link, settings, lambda: self.firmware.t_s)
        self.bus.open()
        self.limits = _limits(self.bus)
        self.meant = {servo_id: sum(self.limits) // 2 for servo_id in IDS}
        self.watch = Watch(self.firmware)
        self.put_right()

    @property
    def wrong(self) -> Set[int]:
        """Ids of servos that pull towards something else than they were meant to."""
        most, meant = self.plan.wrong_ticks, self.meant
        told = self.watch.told
        return {i for i in IDS if abs(told[i] - meant[i]) > most} - self.watch.limp

    def put_right(self) -> bool:
        """Bring all servos to where they should be, over a quiet line; say whether they are."""
        self.line.is_on = False
        self.bus.send(self.bus.protocol.torque(IDS, True), Priority.MOVE)
        targets = [ServoTarget(i, ticks, _TICKS_S) for i, ticks in self.meant.items()]
        verdicts = self.bus.move(targets, 10 * self.plan.duration_ms)
        self.line.is_on = True
        is_right = all(verdict is Verdict.CONFIRMED for verdict in verdicts.values())
        return is_right and not self.wrong and not self.watch.limp

    def next_target(self, servo_id: int, rng: random.Random) -> ServoTarget:
        """Mean a servo to go somewhere new, near enough to be reached within the move."""
        low, high = self.limits
        most = int(self.plan.step_share * (high - low))
        step = rng.choice((-1, 1)) * rng.randint(most // 2, most)
        ticks = self.meant[servo_id] + step
        if not low <= ticks <= high:
            ticks = self.meant[servo_id] - step
        self.meant[servo_id] = ticks
        return ServoTarget(servo_id, ticks, _TICKS_S)


def count(name: str, n_moves: int, seed: int) -> Tally:
    """Move one servo after the other to random places over a noisy line.

    A device whose settings the noise has spoilt is replaced.
    """
    rng = random.Random(zlib.crc32(f"{name} {seed}".encode()))
    rig = Rig(name, seed, rng)
    n_outside = n_wrong = n_missed = n_late = n_left = n_limp = 0
    with Progress(f"moves, {name}", n_moves) as progress:
        for at in range(n_moves):
            target = rig.next_target(IDS[at % len(IDS)], rng)
            rig.watch.seen.clear()
            began_s = rig.firmware.t_s
            verdicts = rig.bus.move([target], rig.plan.duration_ms)
            lasted_s = rig.firmware.t_s - began_s - rig.plan.duration_ms / 1000.0
            low, high = rig.limits
            seen, most = rig.watch.seen, rig.plan.wrong_ticks
            n_outside += any(not low <= ticks <= high for _, ticks in seen)
            is_stray = any(abs(ticks - rig.meant[i]) > most for i, ticks in seen)
            n_wrong += is_stray
            wrong, limp = rig.wrong, rig.watch.limp
            named = {i for i, verdict in verdicts.items() if verdict is not Verdict.CONFIRMED}
            n_missed += bool(wrong - named)
            n_late += is_stray and bool(wrong) and lasted_s > LATE_S
            n_left += bool(named)
            n_limp += bool(limp)
            if (named or wrong or limp) and not rig.put_right():
                rig = Rig(name, seed, rng)
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
    verdicts = bus.move([ServoTarget(1, 1500)], 20)
    n_claims = sum(verdict is not Verdict.UNVERIFIABLE for verdict in verdicts.values())
    return at_most(SUITE, f"{name}: moves claimed to be verified", n_claims, 0, "{:.0f}")


def _limits(bus: Bus) -> Tuple[int, int]:
    """Store limits in every servo that can keep them; return what the servos must keep within."""
    low, high = bus.protocol.ticks
    span = high - low
    inner = (low + int(_LOW_SHARE * span), low + int(_HIGH_SHARE * span))
    is_kept = False
    for servo_id in IDS:
        frames = bus.protocol.set_limits(servo_id, *inner)
        is_kept = bool(frames)
        bus.send(frames, Priority.MOVE)
    return inner if is_kept else (low, high)
