"""What a session tells its supervisor process, and when there is one."""

import logging
from typing import Dict, List, Optional

from firmware_bridge.deadman import Deadman
from firmware_bridge.motion import Motion
from firmware_bridge.servos import Servos
from firmware_bridge.states import UP, SessionState
from firmware_bridge.supervisor import StopBytes

_LOG = logging.getLogger(__name__)
_AGE_STEP_S = 0.02


class Supervision:
    """Keep a ``Deadman`` informed; does nothing without one, or over a link that cannot be shared.

    A board that is told where to hold is told so for each moment of the horizon, so that it
    neither jumps back nor ahead when the host is found dead some time after its last beat.
    """

    def __init__(self, servos: Servos, deadman: Optional[Deadman]) -> None:
        self._servos = servos
        self._deadman = deadman

    def begin(self) -> None:
        """Start supervising, if that is wanted and not under way."""
        deadman, link = self._deadman, self._servos.bus.link
        if deadman is None or deadman.is_on:
            return
        if link.descriptor < 0:
            _LOG.warning("%s cannot be shared with a supervisor process: none is there", link.port)
            return
        deadman.start(link.descriptor)

    def end(self) -> None:
        """Let the supervisor go; it stops nothing."""
        if self._deadman is not None:
            self._deadman.stop()

    def clear(self) -> None:
        """Forget why it acted."""
        if self._deadman is not None:
            self._deadman.clear()

    def trouble(self) -> str:
        """Return why the arm cannot be taken to be supervised; empty when all is well."""
        return "" if self._deadman is None else self._deadman.check()

    def beat(self, motion: Motion, state: SessionState, now_s: float) -> None:
        """Tell it that the host is alive, and what would stop the arm."""
        if self._deadman is None or not self._deadman.is_on:
            return
        stops: List[StopBytes] = []
        if state in UP:
            ages_s = [0.0] if self._servos.ignores_place else motion.ages_s(_AGE_STEP_S)
            for age_s in ages_s:
                frames = self._servos.stop_frames(motion.at(now_s + age_s))
                stops.append(StopBytes(age_s, b"".join(frames)))
        self._deadman.beat(stops, state is SessionState.MOVING)

    def counts(self) -> Dict[str, int]:
        """Return its counters."""
        if self._deadman is None:
            return {}
        return {"beats": self._deadman.n_beats, "supervisor trips": self._deadman.n_trips}
