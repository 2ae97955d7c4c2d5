"""Heat, supply, load and torque of every servo, a few answers a tick, beside the position reads."""

import math
from dataclasses import dataclass
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.bus import Reading
from firmware_bridge.codec.protocol import Quantity, ServoFlag
from firmware_bridge.policy import WARN
from firmware_bridge.servos import Servos
from firmware_bridge.watch import Trouble, Watch

_ROUND = (
    Quantity.TORQUE,
    Quantity.TEMPERATURE,
    Quantity.VOLTAGE,
    Quantity.LOAD,
    Quantity.FLAGS,
)
_ROUND_S = 0.3  # all of them once; what they tell is named half a second after it began


@dataclass(frozen=True, eq=False)
class Telemetry:
    """What the servos ``servo_ids`` last said of themselves, NaN (flags: 0) where nothing yet.

    ``temperature_c``, ``voltage_v``, ``load`` (-1..1 of the largest torque), ``is_torque_on`` (1,
    0 or NaN) and ``flags``, each (n,); ``board_v`` is what a board says of its own supply.
    """

    names: Tuple[str, ...]
    servo_ids: Tuple[int, ...]
    temperature_c: Array
    voltage_v: Array
    load: Array
    is_torque_on: Array
    flags: Tuple[ServoFlag, ...]
    board_v: float


class Telemeter:
    """Ask in turn, and hand what is heard to a ``Watch``."""

    def __init__(self, servos: Servos, watch: Watch, tick_s: float) -> None:
        self._servos, self._watch = servos, watch
        self._values: Dict[Tuple[Quantity, int], Reading] = {}
        self._round = self._plan()
        self._at = 0
        self._n_a_tick = max(1, math.ceil(len(self._round) * tick_s / _ROUND_S))

    def step(self, but: Sequence[int], suspects: Sequence[int], is_armed: bool) -> List[Trouble]:
        """Ask the next questions, those that clear up ``suspects`` first; ``but`` are left out.

        Raises
        ------
        LinkLost : the link is gone.
        """
        found: List[Trouble] = []
        for servo_id in suspects:
            if Quantity.TORQUE in self._servos.bus.protocol.quantities and servo_id not in but:
                found += self._ask(Quantity.TORQUE, (servo_id,), is_armed)
        for _ in range(self._n_a_tick if self._round else 0):
            quantity, ids = self._round[self._at]
            self._at = (self._at + 1) % len(self._round)
            left = tuple(i for i in ids if i not in but)
            if left:
                found += self._ask(quantity, left, is_armed)
        return found

    def value(self) -> Telemetry:
        """Return all that is known."""
        ids = self._servos.arm.all_ids
        report = self._servos.bus.reports.get(Quantity.VOLTAGE)
        return Telemetry(
            tuple(self._servos.name_of(i) for i in ids),
            ids,
            self._column(Quantity.TEMPERATURE, 1.0),
            self._column(Quantity.VOLTAGE, 0.001),
            self._column(Quantity.LOAD, 0.001),
            self._column(Quantity.TORQUE, 1.0),
            tuple(ServoFlag(int(self._last(Quantity.FLAGS, i, 0))) for i in ids),
            math.nan if report is None else report.values[0] / 1000.0,
        )

    def _ask(self, quantity: Quantity, ids: Tuple[int, ...], is_armed: bool) -> List[Trouble]:
        answers = self._servos.bus.read(quantity, ids)
        found: List[Trouble] = []
        for servo_id, reading in answers.items():
            self._values[quantity, servo_id] = reading
            found += self._judge(quantity, servo_id, reading.values[0], is_armed)
        has_lost = quantity is Quantity.TORQUE and bool(found)
        if has_lost and Quantity.TEMPERATURE in self._servos.bus.protocol.quantities:
            # a hot servo drops its torque as well, and that is the better name
            hot = self._ask(Quantity.TEMPERATURE, ids, is_armed)
            found = [one for one in hot if one.action != WARN] or found
        return found

    def _judge(self, quantity: Quantity, servo_id: int, value: int, armed: bool) -> List[Trouble]:
        one: Optional[Trouble] = None
        if quantity is Quantity.TEMPERATURE:
            one = self._watch.temperature(servo_id, float(value))
        elif quantity is Quantity.VOLTAGE:
            one = self._watch.voltage(servo_id, value / 1000.0)
        elif quantity is Quantity.TORQUE and armed:
            one = self._watch.torque(servo_id, bool(value))
        elif quantity is Quantity.FLAGS:
            return self._watch.flagged(servo_id, ServoFlag(value))
        return [] if one is None else [one]

    def _plan(self) -> List[Tuple[Quantity, Tuple[int, ...]]]:
        """Return one question after the other: all servos at once where one frame can ask that."""
        protocol, ids = self._servos.bus.protocol, self._servos.arm.all_ids
        plan: List[Tuple[Quantity, Tuple[int, ...]]] = []
        for quantity in _ROUND if self._servos.has_feedback else ():
            if quantity not in protocol.quantities:
                continue
            queries = protocol.query(quantity, ids)
            plan += [(quantity, query.servo_ids) for query in queries]
        return plan

    def _column(self, quantity: Quantity, scale: float) -> Array:
        ids = self._servos.arm.all_ids
        return np.array([self._last(quantity, i, math.nan) * scale for i in ids])

    def _last(self, quantity: Quantity, servo_id: int, default: float) -> float:
        reading = self._values.get((quantity, servo_id))
        return default if reading is None else reading.values[0]
