"""The bus: questions matched to answers, retries, plausibility, priorities and verified moves.

Blocking, safe to call from any thread, and without a thread of its own. One caller has the line at
a time; between two transactions, and between the frames of a list, it goes to who is most urgent.
An urgent list does not even wait for that (see ``bus_wire``).
"""

import time
from typing import Dict, List, Mapping, NamedTuple, Optional, Sequence, Set, Tuple

from firmware_bridge.bus_turns import Priority, Turns
from firmware_bridge.bus_values import Accept, BusSettings, BusStats, Plausibility, Reading, Verdict
from firmware_bridge.bus_wire import Clock, Wire
from firmware_bridge.codec.parser import Parser
from firmware_bridge.codec.protocol import Quantity, Query, Reply, ServoProtocol, ServoTarget
from firmware_bridge.errors import MotionRefused
from firmware_bridge.links.base import Link

__all__ = ["Bus", "BusSettings", "BusStats", "Priority", "Reading", "Verdict"]

_SLICE_S = 0.002  # longest wait without a look at what became urgent
_SILENCE_S = 0.001  # as long as this after the last byte nothing of the same answer comes
_DEFAULT_BAUD = 1_000_000
_BOARD = -1
_LONG_S = 1.0  # longer than any one answer takes


class _Outcome(NamedTuple):
    replies: List[Tuple[Reply, float]]  # and when they came
    lasted_s: float
    is_preempted: bool


def _allow() -> None:
    return


def _ticks(targets: Sequence[ServoTarget]) -> Dict[int, int]:
    return {target.servo_id: target.ticks for target in targets}


class Bus:
    """Talk to the servos behind one link.

    Parameters
    ----------
    protocol, link : what is spoken, and over what; ``open`` opens the link.
    settings : patience and trust.
    clock : seconds, monotonic; waits are measured by it.

    ``stats`` counts what went by; ``reports`` holds the last unsolicited report of each quantity.
    """

    def __init__(
        self,
        protocol: ServoProtocol,
        link: Link,
        settings: Optional[BusSettings] = None,
        clock: Clock = time.monotonic,
    ) -> None:
        self.protocol = protocol
        self.link = link
        self.settings = settings or BusSettings()
        self.stats = BusStats()
        self.reports: Dict[Quantity, Reading] = {}
        self._clock = clock
        self._byte_s = 10.0 / (link.baud or protocol.baud or _DEFAULT_BAUD)
        self._turns = Turns()
        slack_s = self.settings.slack_s
        self._wire = Wire(link, clock, self._byte_s, slack_s, protocol.is_half_duplex)
        self._plausibility = Plausibility(protocol, self.settings)
        self._parser: Parser = protocol.parser()
        self._n_bad_before = self._n_heard = 0
        self._n_stops = self._n_moves = 0
        self._told: Dict[int, int] = {}  # id -> ticks it was moved to, as far as that is known

    @property
    def is_open(self) -> bool:
        """Say whether the link is open and has not been lost."""
        return self.link.is_open

    @property
    def is_latched(self) -> bool:
        """Say whether moves are refused until ``release``."""
        return self._wire.is_latched

    def open(self) -> None:
        """Open the link; what servos said before counts no more, a latch stays.

        Raises
        ------
        NoSuchPort, PortBusy, PortError : it cannot be opened, and why.
        """
        with self._turns.turn(Priority.READ):
            if not self.link.is_open:
                self.link.open()
            self._parser, self._n_bad_before = self.protocol.parser(), 0
            self._plausibility.forget()
            self._told = {}
            self._wire.expect_nothing()

    def close(self) -> None:
        """Close the link, from any thread and at any time."""
        self.link.close()

    def send(self, frames: Sequence[bytes], priority: Priority) -> float:
        """Write frames in order and at the pace of the line; return when the last byte has left.

        A stop makes all moves that were called before it end with MotionRefused. ``ESTOP`` is
        ``urgent`` with a latch.

        Raises
        ------
        LinkLost : the link is closed or went away.
        MotionRefused : a move while latched, or one that a stop overtook.
        """
        if priority is Priority.ESTOP:
            return self.urgent(frames)
        if priority is Priority.STOP:
            self._n_stops += 1
        if priority is not Priority.READ:
            self._n_moves += 1
            self._told = {}
        return self._send(frames, priority, self._mark())

    def read(
        self, quantity: Quantity, servo_ids: Sequence[int], priority: Priority = Priority.READ
    ) -> Dict[int, Reading]:
        """Ask servos, or the board itself with no ids; return the answers that can be trusted.

        An id that did not answer plausibly within the budget is missing.

        Raises
        ------
        LinkLost : the link is closed or went away.
        ProtocolError : the protocol does not know the quantity.
        """
        found: Dict[int, Reading] = {}
        for query in self.protocol.query(quantity, servo_ids):
            found.update(self._collect(query, priority, self._plausibility.judging(quantity)))
        return found

    def move(
        self, targets: Sequence[ServoTarget], duration_ms: int, is_verified: bool = True
    ) -> Dict[int, Verdict]:
        """Send a move, compare what the servos say they were told, and send it again if need be.

        A damaged frame may have moved another servo: when one of the targets did not arrive at
        once, the others that were moved before are asked too, and one that was told something else
        is in the answer as MISMATCH; nothing is sent to it. Where a protocol tells positions but no
        targets, the comparison comes after the move's end, and this call lasts as long.

        Raises
        ------
        LinkLost : the link is closed or went away.
        MotionRefused : latched, or overtaken by a stop before everything was sent.
        ProtocolError : no well-formed frame can carry it.
        """
        mark, others = self._mark(), self._told
        self._n_moves += 1
        self._told = {}
        n_moves = self._n_moves
        self._send(self.protocol.move(targets, duration_ms), Priority.MOVE, mark)
        compare = self._comparison()
        if compare is None or not is_verified:
            return {target.servo_id: Verdict.UNVERIFIABLE for target in targets}
        wanted = _ticks(targets)
        others = {i: ticks for i, ticks in others.items() if i not in wanted}
        verdicts = {servo_id: Verdict.CONFIRMED for servo_id in wanted}
        left, n_sent, is_over = list(targets), 1, False
        while left and not is_over:
            if compare is Quantity.POSITION:
                self._let_pass(duration_ms / 1000.0 + self.settings.settle_s, mark)
            found = self._read_back(compare, _ticks(left), others)
            verdicts.update(found)
            left = [t for t in left if found[t.servo_id] is not Verdict.CONFIRMED]
            is_over = self._is_overtaken(mark) or self._n_moves != n_moves
            if not left or is_over or n_sent >= self.settings.n_move_tries:
                break
            n_sent += 1
            self.stats.retries += 1
            self._send(self.protocol.move(left, duration_ms), Priority.MOVE, mark)
        if not is_over:
            self._told = {**others, **wanted}
        return verdicts

    def urgent(self, frames: Sequence[bytes], is_latched: bool = True) -> float:
        """Write frames before everything else, from any thread; return when the last byte has left.

        Moves that were called before end with MotionRefused; with ``is_latched`` so do all others
        until ``release``. A question that it overtook is asked again by itself.

        Raises
        ------
        LinkLost : the link is closed or went away; the latch is set all the same.
        """
        self._told = {}
        sent_s = self._wire.urgent(frames, is_latched)
        self.stats.sent += len(frames)
        return sent_s

    def release(self) -> None:
        """Let moves through again after an urgent stop."""
        self._wire.release()

    def drain(self) -> None:
        """Take what waits on the line without blocking, so that ``reports`` are up to date.

        Raises
        ------
        LinkLost : the link is closed or went away.
        """
        with self._turns.turn_if_free() as is_mine:
            if is_mine:
                self._take_unasked()

    # -- writing ------------------------------------------------------------------------------

    def _mark(self) -> Tuple[int, int]:
        return self._n_stops, self._wire.n_urgent

    def _is_overtaken(self, mark: Tuple[int, int]) -> bool:
        return self._wire.is_latched or mark != self._mark()

    def _send(self, frames: Sequence[bytes], priority: Priority, mark: Tuple[int, int]) -> float:
        def check() -> None:
            if priority is Priority.MOVE and self._is_overtaken(mark):
                self.stats.preempted += 1
                raise MotionRefused(f"{self.link.port}: a stop overtook the move; nothing moves on")

        at = 0
        while at < len(frames):
            with self._turns.turn(priority):
                while at < len(frames):
                    self._wire.put(frames[at], 0, check)
                    self.stats.sent += 1
                    at += 1
                    if self._turns.is_wanted_above(priority):
                        break
        return self._clock() + self.link.idle_in_s()

    def _let_pass(self, duration_s: float, mark: Tuple[int, int]) -> None:
        """Let time pass in slices, the line free for others in between."""
        end_s = self._clock() + duration_s
        while self._clock() < end_s - 1e-9 and not self._is_overtaken(mark):
            with self._turns.turn(Priority.MOVE):
                left_s = end_s - self._clock()
                if left_s > 0.0:
                    self.link.wait_readable(min(_SLICE_S, left_s))
                    self._take_unasked()

    # -- asking -------------------------------------------------------------------------------

    def _read_back(
        self, quantity: Quantity, wanted: Mapping[int, int], others: Mapping[int, int]
    ) -> Dict[int, Verdict]:
        """Compare what servos say with what they were told.

        If one look does not show all of ``wanted`` right, ``others`` are asked too; of those only
        the ones that say something else are in the answer.
        """
        tolerance = self._plausibility.jump_ticks if quantity is Quantity.POSITION else 0
        if self._looks_right(quantity, wanted, tolerance):
            return {servo_id: Verdict.CONFIRMED for servo_id in wanted}
        told = {**others, **wanted}
        accept = self._plausibility.comparing(quantity, told, tolerance)
        verdicts = {servo_id: Verdict.UNANSWERED for servo_id in wanted}
        for query in self.protocol.query(quantity, list(told)):
            for servo_id, reading in self._collect(query, Priority.MOVE, accept).items():
                if abs(reading.values[0] - told[servo_id]) > tolerance:
                    verdicts[servo_id] = Verdict.MISMATCH
                elif servo_id in wanted:
                    verdicts[servo_id] = Verdict.CONFIRMED
        return verdicts

    def _looks_right(self, quantity: Quantity, wanted: Mapping[int, int], tolerance: int) -> bool:
        """Ask once; say whether all servos answered what they were told."""
        for query in self.protocol.query(quantity, list(wanted)):
            replies = [reply for reply, _ in self._ask(query, Priority.MOVE, _LONG_S).replies]
            right = [r for r in replies if abs(r.values[0] - wanted[r.servo_id]) <= tolerance]
            if {reply.servo_id for reply in right} != set(query.servo_ids):
                return False
            self.stats.answered += len(right)
        return True

    def _comparison(self) -> Optional[Quantity]:
        """Return what tells whether a move has arrived, if anything does."""
        known = self.protocol.quantities
        if not self.protocol.has_feedback:  # a board's memory of a command is none of the servo
            return None
        return Quantity.TARGET if Quantity.TARGET in known else Quantity.POSITION

    def _collect(self, query: Query, priority: Priority, accept: Accept) -> Dict[int, Reading]:
        """Ask until ``accept`` has taken an answer of every servo, or the budget is gone.

        Time that others have the line does not count, nor does a try that something overtook.
        """
        missing: Set[int] = set(query.servo_ids)
        found: Dict[int, Reading] = {}
        heard: Dict[int, List[Reply]] = {}
        try_s = self._byte_s * (len(query.frame) + query.n_reply)
        left_s = max(self.settings.budget_s, 3.0 * (try_s + self.settings.slack_s))
        n_tries = 0
        while n_tries < self.settings.n_tries and left_s >= try_s:
            outcome = self._ask(query, priority, left_s)
            if outcome.is_preempted:
                self.stats.preempted += 1
                continue
            n_tries += 1
            left_s -= outcome.lasted_s
            for reply, t_s in outcome.replies:
                if accept(reply, heard.setdefault(reply.servo_id, [])):
                    found[reply.servo_id] = Reading(reply.values, t_s, n_tries, reply.flags)
                    missing.discard(reply.servo_id)
                else:
                    self.stats.implausible += 1
            if found and not missing:
                break
            if missing and len(missing) < len(query.servo_ids):
                query = self.protocol.query(query.quantity, sorted(missing))[0]
        self.stats.retries += max(n_tries - 1, 0)
        self.stats.answered += len(found)
        return found

    def _ask(self, query: Query, priority: Priority, left_s: float) -> _Outcome:
        """Put one question and wait for the answers of all its servos."""
        with self._turns.turn(priority):
            began_s, n_urgent = self._clock(), self._wire.n_urgent
            self._take_unasked()
            n_whole = self._n_heard + query.n_reply
            in_s = self._wire.put(query.frame, query.n_reply, _allow)
            self.stats.sent += 1
            end_s = min(in_s + self.settings.slack_s, began_s + left_s)
            missing = set(query.servo_ids) or {_BOARD}
            replies: List[Tuple[Reply, float]] = []
            while missing and self._wire.n_urgent == n_urgent:
                is_over = self._clock() >= end_s - 1e-9
                n_before = self._n_heard
                frames = self._give_up() if is_over else self._hear(end_s)
                if n_before < self._n_heard >= n_whole:  # all there, and still no answer in it
                    end_s = min(end_s, self._clock() + _SILENCE_S)
                for reply in self._answers(query, frames):
                    missing.discard(reply.servo_id if query.servo_ids else _BOARD)
                    if reply.is_ok:
                        replies.append((reply, self._clock()))
                if is_over:
                    break
            self._wire.expect_nothing()
            is_preempted = bool(missing) and self._wire.n_urgent != n_urgent
            if not missing:
                self.link.mark_idle()
            elif not is_preempted:
                self.stats.timeouts += 1
            return _Outcome(replies, self._clock() - began_s, is_preempted)

    def _answers(self, query: Query, frames: Sequence[bytes]) -> List[Reply]:
        """Return what frames say in answer to a query; note the others."""
        found: List[Reply] = []
        for frame in frames:
            matched = self.protocol.match(query, frame)
            found += matched
            if not matched and not self._note_report(frame):
                self.stats.foreign += 1
        return found

    # -- hearing ------------------------------------------------------------------------------

    def _hear(self, end_s: float) -> List[bytes]:
        """Wait a little for bytes; return the frames they complete."""
        left_s = end_s - self._clock()
        if left_s > 0.0:
            self.link.wait_readable(min(left_s, _SLICE_S))
        data = self.link.read_available()
        self._n_heard += len(data)
        return self._count(self._parser.feed(data))

    def _give_up(self) -> List[bytes]:
        """Treat the line as silent; return the frames that stood behind an unfinished one."""
        return self._count(self._parser.flush())

    def _take_unasked(self) -> None:
        """Take what nobody asked for off the line: reports, and answers that came too late."""
        frames = self._parser.feed(self.link.read_available())
        for frame in self._count(frames + self._parser.flush()):
            if not self._note_report(frame):
                self.stats.foreign += 1

    def _note_report(self, frame: bytes) -> bool:
        reported = self.protocol.report(frame)
        for quantity, reply in reported:
            if self._plausibility.is_possible(quantity, reply):
                self.reports[quantity] = Reading(reply.values, self._clock(), 0, reply.flags)
        self.stats.unsolicited += bool(reported)
        return bool(reported)

    def _count(self, frames: List[bytes]) -> List[bytes]:
        self.stats.bad_frames += self._parser.n_bad - self._n_bad_before
        self._n_bad_before = self._parser.n_bad
        return frames
