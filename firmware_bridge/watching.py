"""Measure the arm once a tick and look after its servos; says what is wrong and does nothing."""

import threading
from typing import Callable, Dict, List, Optional, Set

from firmware_bridge.bus import Reading
from firmware_bridge.codec.protocol import Quantity
from firmware_bridge.diagnose import why_silent
from firmware_bridge.motion import Motion, Rhythm
from firmware_bridge.policy import HOLD, Policy
from firmware_bridge.servos import Measured, Servos
from firmware_bridge.states import LATCHED, UP, SessionState
from firmware_bridge.telemetry import Telemeter, Telemetry
from firmware_bridge.watch import Kind, Trouble, Watch

_AGAIN = 2  # a servo found dead is asked in every second tick


class Watching:
    """``seen`` is the last measurement, None before the first and where nothing can be measured."""

    def __init__(
        self, servos: Servos, policy: Policy, rhythm: Rhythm, clock: Callable[[], float]
    ) -> None:
        names = {i: servos.name_of(i) for i in servos.arm.all_ids}
        self.seen: Optional[Measured] = None
        self._servos, self._clock = servos, clock
        self._watch = Watch(policy, names, servos.arm.servo_ids)
        self._telemeter = Telemeter(servos, self._watch, rhythm.tick_s)
        self._dead: Dict[int, Kind] = {}  # silent servos, and what was found out
        self._told_dead: Set[int] = set()
        self._back: List[int] = []
        self._n_looks = 0
        self._is_free = threading.Lock()
        self._heard: Optional[Reading] = None

    def forget(self) -> None:
        """Start anew, as after opening the link and before arming."""
        self.seen = None
        self._watch.forget()
        self._dead.clear()
        self._told_dead.clear()
        self._back.clear()

    def start_from(self, seen: Measured) -> None:
        """Take a first measurement."""
        self.seen = seen

    def look(self, motion: Motion, state: SessionState) -> List[Trouble]:
        """Measure, ask for a few other values, and return what is wrong with an arm that is up.

        Raises
        ------
        LinkLost : the link is gone.
        """
        if not self._servos.has_feedback:
            return self._board_supply(state)
        if not self._is_free.acquire(blocking=False):
            return []  # another thread is at it
        try:
            return self._measure(motion, state)
        finally:
            self._is_free.release()

    def explain(self, silent: Trouble) -> Trouble:
        """Find out why a servo is silent; takes up to 0.3 s.

        Raises
        ------
        LinkLost : the link is gone.
        """
        others = [i for i in self._servos.arm.all_ids if i != silent.servo_id]
        found = why_silent(self._servos.bus, silent.servo_id, others, self._clock)
        self._dead[silent.servo_id] = found.kind
        return self._told(found.kind, silent.servo_id, found.text)

    def came_back(self) -> Optional[Trouble]:
        """Return the news that a servo found dead answers again, once."""
        if not self._back:
            return None
        text = "was silent and is back: it was reset, most likely by a dip of its supply"
        return self._told(Kind.BROWN_OUT, self._back.pop(), text)

    def telemetry(self) -> Telemetry:
        """Return all that the servos have said of themselves."""
        return self._telemeter.value()

    def _measure(self, motion: Motion, state: SessionState) -> List[Trouble]:
        self._n_looks += 1
        is_up = state in UP
        but = () if self._n_looks % _AGAIN == 0 else tuple(self._dead)
        began_s = self._clock()
        seen = self._servos.measure(but, self.seen)
        self.seen = seen
        for servo_id in [i for i in self._dead if i not in seen.missing]:
            if self._dead.pop(servo_id) is Kind.DEAD:
                self._back.append(servo_id)
        if not is_up:
            found = self._watch.silent(self._clock(), seen) if state in LATCHED else []
        else:
            self._watch.expect(began_s, motion.at(began_s))
            found = self._watch.measured(self._clock(), seen)
        found = [one for one in found if one.kind is not Kind.DEAD or self._is_news(one.servo_id)]
        suspects = self._watch.suspects() if is_up else []
        return found + self._telemeter.step(seen.missing, suspects, is_up)

    def _is_news(self, servo_id: int) -> bool:
        """Note a servo that fell silent; a garbled one falls silent again and again."""
        is_new = servo_id not in self._told_dead
        self._dead.setdefault(servo_id, Kind.DEAD)
        self._told_dead.add(servo_id)
        return is_new

    def _board_supply(self, state: SessionState) -> List[Trouble]:
        """Judge what a board reports of its supply, each report once."""
        report = self._servos.bus.reports.get(Quantity.VOLTAGE)
        if report is None or report is self._heard or state not in UP:
            return []
        self._heard = report
        trouble = self._watch.voltage(0, report.values[0] / 1000.0)
        return [] if trouble is None else [trouble]

    def _told(self, kind: Kind, servo_id: int, text: str) -> Trouble:
        who = f"{self._servos.name_of(servo_id)} (id {servo_id})"
        return Trouble(kind, servo_id, f"{kind.value}: {who} {text}", HOLD)
