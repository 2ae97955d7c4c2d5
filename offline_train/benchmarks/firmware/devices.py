"""Simulated devices for the benches of the bus, and the scale of each protocol's ticks."""

import random
from typing import Dict, List, NamedTuple, Tuple

from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.damage import DAMAGE, damage
from firmware_bridge.simulator.i2c_board import I2cBoard
from firmware_bridge.simulator.make import Setup, make_servos
from firmware_bridge.simulator.servo import SimServo

IDS = (1, 2, 3, 4, 5, 6)
TICKS_PER_DEG: Dict[str, float] = {
    "lx16a": 1000.0 / 240.0,
    "lsc": 1000.0 / 240.0,
    "rrc": 2000.0 / 180.0,
    "rrc-bus": 1000.0 / 240.0,
    "sts": 4096.0 / 360.0,
    "dxl2": 4096.0 / 360.0,
}
LOST, LATE, STALE = "lost", "late", "stale"
_LATE_S = (0.002, 0.03)
_N_REMEMBERED = 12


def device(name: str, seed: int) -> Firmware:
    """Return a simulated device with servos 1..6 that have a rate and a lag and nothing else."""
    if name == "i2c":
        return I2cBoard(make_servos(Setup("rrc", ids=IDS, seed=seed, is_plain=True)))
    return Setup(name, ids=IDS, seed=seed, is_plain=True).firmware()


def servos(firmware: Firmware) -> Dict[int, SimServo]:
    """Return the servos of a device by id."""
    made: List[SimServo] = firmware.servos  # type: ignore[attr-defined]
    return {servo.servo_id: servo for servo in made}


class _Late(NamedTuple):
    due_s: float
    data: bytes


class FaultyAnswers(Firmware):
    """A device some of whose answers are damaged, lost, late, or answers to something else.

    ``n_faults`` counts them.

    Parameters
    ----------
    inner : the device.
    share : of the answers that something happens to.
    rng : decides.
    """

    def __init__(self, inner: Firmware, share: float, rng: random.Random) -> None:
        self.inner = inner
        self.baud = inner.baud
        self.share = share
        self.n_faults = 0
        self._rng = rng
        self._kinds: Tuple[str, ...] = (*sorted(DAMAGE), LOST, LATE, STALE)
        self._late: List[_Late] = []
        self._before: List[bytes] = []

    @property
    def t_s(self) -> float:  # type: ignore[override]
        """Simulated time."""
        return self.inner.t_s

    def feed(self, data: bytes) -> None:
        """Take bytes from the wire."""
        self.inner.feed(data)

    def step(self, dt_s: float) -> None:
        """Let time pass."""
        self.inner.step(dt_s)

    def replies(self) -> bytes:
        """Return what arrives at the host by now."""
        arrived = b"".join(one.data for one in self._late if one.due_s <= self.t_s)
        self._late = [one for one in self._late if one.due_s > self.t_s]
        answer = self.inner.replies()
        if not answer:
            return arrived
        before, self._before = self._before, [*self._before[1 - _N_REMEMBERED :], answer]
        if self._rng.random() >= self.share:
            return arrived + answer
        self.n_faults += 1
        kind = self._rng.choice(self._kinds)
        if kind == LOST:
            return arrived
        if kind == LATE:
            self._late.append(_Late(self.t_s + self._rng.uniform(*_LATE_S), answer))
            return arrived
        if kind == STALE:
            return arrived + (self._rng.choice(before) if before else b"")
        return arrived + damage(answer, kind, self._rng)
