"""What flows through the bus, and the judgement of what a servo says.

A checksum of 8 bits lets one of 256 badly damaged answers through. So a value that jumps, or the
first one ever, counts only when a second answer agrees; what no servo can say never counts.
Source: ours.
"""

import enum
from dataclasses import dataclass
from typing import Callable, Dict, List, Mapping, NamedTuple, Optional, Tuple

from firmware_bridge.codec.protocol import Quantity, Reply, ServoFlag, ServoProtocol


class Reading(NamedTuple):
    """An answer that was accepted.

    ``t_s`` is the time of its last byte; ``n_tries`` counts the questions.
    """

    values: Tuple[int, ...]
    t_s: float
    n_tries: int
    flags: ServoFlag


class Verdict(enum.Enum):
    """What the read-back says of one servo of a move."""

    CONFIRMED = "confirmed"
    MISMATCH = "mismatch"  # it says something else, twice over, after the move was sent again
    UNANSWERED = "unanswered"
    UNVERIFIABLE = "unverifiable"  # the protocol offers nothing to compare with


@dataclass(frozen=True)
class BusSettings:
    """How patient and how trusting the bus is.

    Parameters
    ----------
    slack_s : what adapter and servo may take on top of the wire time of question and answer.
    n_tries : most questions for one value, confirmation included.
    budget_s : most time for one value; a slow line gets the time of three tries instead.
    n_move_tries : how often a move goes out at most.
    max_jump_ticks : a position further from the last one must be confirmed; None is 1.6 % of the
        protocol's range, less than 6 degrees on every servo there is a protocol for.
    settle_s : how long after a move's end a servo without a readable target is measured.
    """

    slack_s: float = 0.003
    n_tries: int = 6
    budget_s: float = 0.025
    n_move_tries: int = 2
    max_jump_ticks: Optional[int] = None
    settle_s: float = 0.02


@dataclass
class BusStats:
    """Counts since the bus was made.

    ``sent`` frames; ``answered`` questions; ``retries`` repeated questions; ``timeouts`` questions
    with no answer; ``bad_frames`` failed checksums; ``foreign`` answers to something else (stale,
    another id); ``implausible`` values refused or asked for again; ``unsolicited`` frames that
    nobody asked for; ``preempted`` transactions and moves that something urgent overtook.
    """

    sent: int = 0
    answered: int = 0
    retries: int = 0
    timeouts: int = 0
    bad_frames: int = 0
    foreign: int = 0
    implausible: int = 0
    unsolicited: int = 0
    preempted: int = 0


_RANGES: Dict[Quantity, Tuple[int, int]] = {
    Quantity.MODEL: (0, 65535),
    Quantity.LOAD: (-1100, 1100),
    Quantity.CURRENT: (-20000, 20000),
    Quantity.TEMPERATURE: (-20, 150),
    Quantity.VOLTAGE: (0, 26000),
    Quantity.FLAGS: (0, 63),
    Quantity.TORQUE: (0, 1),
}
_JUMPS: Dict[Quantity, int] = {
    Quantity.LOAD: 300,
    Quantity.CURRENT: 300,
    Quantity.TEMPERATURE: 3,
    Quantity.VOLTAGE: 300,
}
_JUMP_SHARE = 0.016
_MARGIN_SHARE = 0.1  # a shaft can stand a little outside what can be commanded

Accept = Callable[[Reply, List[Reply]], bool]
"""(an answer, those of the same servo before it that did not count) -> does it count."""


class Plausibility:
    """Judge answers by what is possible and by what the servo said before."""

    def __init__(self, protocol: ServoProtocol, settings: BusSettings) -> None:
        low, high = protocol.ticks
        span = high - low
        margin = int(span * _MARGIN_SHARE)
        self._ranges = dict(_RANGES)
        for quantity in (Quantity.POSITION, Quantity.TARGET, Quantity.LIMITS):
            self._ranges[quantity] = (low - margin, high + margin)
        self._ranges[Quantity.OFFSET] = (-span, span)
        self._ranges[Quantity.SPEED] = (-20 * span, 20 * span)
        jump = settings.max_jump_ticks
        self.jump_ticks = int(span * _JUMP_SHARE) if jump is None else jump
        self._jumps = dict(_JUMPS)
        self._jumps[Quantity.POSITION] = self.jump_ticks
        self._jumps[Quantity.SPEED] = span // 10
        self._last: Dict[Tuple[Quantity, int], Reply] = {}

    def is_possible(self, quantity: Quantity, reply: Reply) -> bool:
        """Say whether a servo can say that at all."""
        low, high = self._ranges[quantity]
        return bool(reply.values) and all(low <= value <= high for value in reply.values)

    def is_near(self, quantity: Quantity, one: Reply, other: Reply) -> bool:
        """Say whether two answers agree as closely as two in a row do."""
        jump = self._jumps.get(quantity, 0)
        if one.flags != other.flags or len(one.values) != len(other.values):
            return False
        return all(abs(a - b) <= jump for a, b in zip(one.values, other.values))

    def accept(self, quantity: Quantity, reply: Reply, heard: List[Reply]) -> bool:
        """Take an answer as true if the last one or another one in ``heard`` agrees; remember it.

        Answers that do not count yet are added to ``heard``.
        """
        if not self.is_possible(quantity, reply):
            return False
        key = (quantity, reply.servo_id)
        witnesses = list(heard)
        if key in self._last:
            witnesses.append(self._last[key])
        heard.append(reply)
        if not any(self.is_near(quantity, reply, witness) for witness in witnesses):
            return False
        self._last[key] = reply
        return True

    def judging(self, quantity: Quantity) -> Accept:
        """Return ``accept`` for one quantity."""

        def judge(reply: Reply, heard: List[Reply]) -> bool:
            return self.accept(quantity, reply, heard)

        return judge

    def comparing(self, quantity: Quantity, wanted: Mapping[int, int], tolerance: int) -> Accept:
        """Return what takes an answer as ``wanted`` at once, another one when it comes twice.

        For a damaged answer looks like a servo that was told something else.
        """

        def compare(reply: Reply, heard: List[Reply]) -> bool:
            if not self.is_possible(quantity, reply):
                return False
            if abs(reply.values[0] - wanted[reply.servo_id]) <= tolerance:
                return True
            heard.append(reply)
            return any(self.is_near(quantity, reply, one) for one in heard[:-1])

        return compare

    def forget(self) -> None:
        """Forget what servos said: after a reconnect nothing is known."""
        self._last.clear()
