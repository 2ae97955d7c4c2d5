"""Ask an OpenAI-compatible endpoint, with an absolute deadline that nothing can stretch.

``ChatClient.start`` returns a Call at once; a worker thread talks to the server and an alarm ends
the call at its deadline whatever the server does. Nothing here raises for what a server does: the
outcome is a Reply whose ``failure`` is "" or one of ``apex_edge.planners.base.FAILURES``.
"""

import logging
import random
import statistics
import threading
import time
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Callable, Deque, List, Optional

from apex_edge.planners.base import Clock, PlannerConfig
from apex_edge.planners.breaker import Breaker
from apex_edge.planners.dialect import MAX_CHANGES, Dialect, Question
from apex_edge.planners.endpoint import Endpoint
from apex_edge.planners.line import Line
from apex_edge.planners.parse import parse_completion, retry_after_s

if TYPE_CHECKING:
    from apex_edge.planners.transport import Exchange

logger = logging.getLogger(__name__)

RETRY_STATUS = (408, 409, 429, 500, 502, 503, 504, 529)
LOCKING_STATUS = (401, 402)  # a refused key or account: only new settings help
BACKOFF_S = 0.05
MAX_WORKERS = 4
HARMLESS = ("", "refusal", "content_filter")  # the endpoint itself works


@dataclass(frozen=True)
class Reply:
    """How a call ended: the model's text, or why there is none. ``latency_s`` is wall time."""

    text: str = ""
    failure: str = ""
    latency_s: float = 0.0
    n_attempts: int = 0
    n_prompt_tokens: int = 0
    n_completion_tokens: int = 0


class Call:
    """One question in flight. Whoever ends it first wins: the worker, the alarm or a cancel."""

    def __init__(
        self,
        budget_s: float,
        line: Line,
        wall_clock: Clock,
        on_end: Callable[[Optional[Reply]], None],
    ) -> None:
        self.line = line
        self._wall_clock = wall_clock
        self._on_end = on_end
        self._lock = threading.Lock()
        self._done = threading.Event()
        self._reply: Optional[Reply] = None
        self._started_s = wall_clock()
        self._deadline_s = self._started_s + budget_s

    @property
    def remaining_s(self) -> float:
        """Return the wall time left, 0 when the call is over."""
        return 0.0 if self._done.is_set() else max(0.0, self._deadline_s - self._wall_clock())

    def result(self) -> Optional[Reply]:
        """Return the reply, or None while the call is under way or when it was cancelled."""
        return self._reply

    def wait(self, timeout_s: float) -> Optional[Reply]:
        """Wait for the end, at most ``timeout_s`` and never past the deadline."""
        self._done.wait(max(0.0, min(timeout_s, self.remaining_s)))
        if self._wall_clock() >= self._deadline_s:
            self.finish(Reply(failure="timeout"))
        return self._reply

    def pause(self, delay_s: float) -> None:
        """Wait before another attempt, not longer than the call is wanted."""
        self._done.wait(delay_s)

    def expire(self) -> None:
        """End the call because its deadline has come."""
        self.finish(Reply(failure="timeout"))

    def cancel(self) -> None:
        """End the call without a reply."""
        self.finish(None)

    def refuse(self, failure: str) -> None:
        """End the call before anything was sent; nothing is counted."""
        self._reply = Reply(failure=failure)
        self._done.set()

    def finish(self, reply: Optional[Reply]) -> None:
        """End the call with ``reply`` unless it is over already; late text is dropped."""
        with self._lock:
            if self._done.is_set():
                return
            now_s = self._wall_clock()
            if reply is not None:
                if now_s >= self._deadline_s:
                    reply = replace(reply, text="", failure="timeout")
                reply = replace(reply, latency_s=now_s - self._started_s)
            self._reply = reply
            self._done.set()
        if reply is None or reply.failure == "timeout":
            self.line.cut()
        self._on_end(reply)


class ChatClient:
    """Talk to one endpoint: one session, one retry, a circuit breaker, a remembered dialect."""

    def __init__(
        self,
        endpoint: Endpoint,
        config: PlannerConfig,
        seed: int,
        wall_clock: Clock = time.monotonic,
    ) -> None:
        # requests and its certificates take 0.1 s and more to import: now, not in an alarm
        from apex_edge.planners.transport import Transport

        self._config = config
        self._model = endpoint.model
        self._wall_clock = wall_clock
        self._random = random.Random(seed)
        self._lock = threading.Lock()
        self._breaker = Breaker()
        self._latency_s: Deque[float] = deque(maxlen=20)
        self._transport = Transport(endpoint)
        self._workers: List[threading.Thread] = []
        self._last_failure = ""
        self.dialect = Dialect()

    def start(self, question: Question, budget_s: float) -> Call:
        """Send ``question`` in the background; the call ends within ``budget_s`` of wall time."""

        def settle(reply: Optional[Reply]) -> None:
            alarm.cancel()
            self._settle(reply)

        call = Call(budget_s, Line(), self._wall_clock, settle)
        alarm = threading.Timer(max(0.0, budget_s), call.expire)
        alarm.daemon = True
        refusal = self._refusal(budget_s)
        if refusal:
            call.refuse(refusal)
            return call
        worker = threading.Thread(
            target=self._work, args=(call, question), name="apex-llm", daemon=True
        )
        self._workers.append(worker)
        alarm.start()
        worker.start()
        return call

    def ask(self, question: Question, budget_s: float) -> Reply:
        """Send ``question`` and wait; returns within ``budget_s`` of wall time, never raises."""
        call = self.start(question, budget_s)
        return call.wait(budget_s) or Reply(failure="closed")

    def close(self) -> None:
        """Close idle connections. Calls in flight are their owner's to cancel."""
        self._transport.close()

    def _refusal(self, budget_s: float) -> str:
        """Return why no call may start, "" when one may."""
        if not budget_s > 0:
            return "timeout"
        self._workers = [worker for worker in self._workers if worker.is_alive()]
        if len(self._workers) >= MAX_WORKERS:  # stuck in name look-up, which cannot be interrupted
            return "connect"
        with self._lock:
            return "" if self._breaker.allows(self._wall_clock()) else "circuit_open"

    def _work(self, call: Call, question: Question) -> None:
        reply = Reply(failure="connect")
        try:
            reply = self._converse(call, question)
        finally:
            call.finish(reply)

    def _converse(self, call: Call, question: Question) -> Reply:
        """Ask until there is an answer or another attempt cannot help or does not fit."""
        dialect, n_changes, n_attempts, is_retried = self.dialect, 0, 0, False
        while call.remaining_s > 0:
            began_s = self._wall_clock()
            body = dialect.body(question, self._model, self._config)
            exchange = self._transport.post(body, call.remaining_s, call.line)
            n_attempts += 1
            if exchange.status == 400 and n_changes < MAX_CHANGES:
                changed = dialect.after_400(exchange.body)
                if changed is not None:
                    dialect, n_changes = changed, n_changes + 1
                    continue
            delay_s = None if is_retried else self._retry_delay_s(exchange, call, began_s)
            if delay_s is None:
                return self._conclude(exchange, dialect, n_attempts)
            is_retried = True
            call.pause(delay_s)
        return Reply(failure="timeout", n_attempts=n_attempts)

    def _conclude(self, exchange: "Exchange", dialect: Dialect, n_attempts: int) -> Reply:
        if exchange.status in LOCKING_STATUS:
            with self._lock:
                self._breaker.lock()
        if exchange.failure:
            return Reply(failure=exchange.failure, n_attempts=n_attempts)
        self.dialect = dialect
        found = parse_completion(exchange.body)
        return Reply(
            text=found.text,
            failure=found.failure,
            n_attempts=n_attempts,
            n_prompt_tokens=found.n_prompt_tokens,
            n_completion_tokens=found.n_completion_tokens,
        )

    def _retry_delay_s(self, exchange: "Exchange", call: Call, began_s: float) -> Optional[float]:
        """Return how long to wait before the one retry, or None when it cannot help or fit.

        A retry is expected to take as long as calls usually do, or as long as this one took: a
        server that failed after generating would fail as late again.
        """
        if not exchange.is_unanswered and exchange.status not in RETRY_STATUS:
            return None
        if exchange.headers.get("x-should-retry", "").lower() == "false":
            return None
        asked_s = retry_after_s(exchange.headers, time.time())
        delay_s = BACKOFF_S * self._random.random() if asked_s is None else asked_s
        usual_s = statistics.median(self._latency_s) if self._latency_s else 0.0
        needed_s = delay_s + max(usual_s, self._wall_clock() - began_s)
        return delay_s if needed_s < call.remaining_s else None

    def _settle(self, reply: Optional[Reply]) -> None:
        """Count the end of a call, and say so once when the endpoint's state changes."""
        with self._lock:
            was_closed = self._breaker.is_closed
            if reply is None:
                self._breaker.forget()
                return
            if reply.failure in HARMLESS:
                self._breaker.succeed()
                self._latency_s.append(reply.latency_s)
            else:
                self._breaker.fail(self._wall_clock())
            is_closed, last = self._breaker.is_closed, self._last_failure
            self._last_failure = reply.failure
        if reply.failure and reply.failure != last:
            logger.warning("the LLM endpoint failed: %s; the reflex acts alone", reply.failure)
        elif last and not reply.failure:
            logger.info("the LLM endpoint answers again")
        if was_closed and not is_closed:
            logger.warning("the LLM endpoint keeps failing; not asked again for now")
