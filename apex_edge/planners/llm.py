"""The LLM planner: one question in flight, one proposal per question, nothing moved here.

It adds meaning (whether, whom, which), never safety: the reflex is ready before it is asked and
fires without it. Source: APEX algorithm 1 line 10 ("Plan"); the asynchronous form is ours.
"""

import logging
from collections import deque
from dataclasses import dataclass
from typing import Deque, Mapping, Optional

import numpy as np

from apex_edge.planners.base import Clock, Planner, PlannerConfig, PlanRequest
from apex_edge.planners.client import Call, ChatClient, Reply
from apex_edge.planners.dialect import Question
from apex_edge.planners.endpoint import endpoint_from
from apex_edge.planners.parse import Answer, parse_index, parse_point
from apex_edge.planners.prompts import FAR_M, Prompt, render
from apex_edge.types import Proposal, Rollouts

logger = logging.getLogger(__name__)

SNAP_M = 0.005  # a point this near to a candidate means it; the grid is about as coarse
HOUR_S = 3600.0


@dataclass(frozen=True)
class Usage:
    """What the planner has cost so far; ``cost`` is in the currency of the configured prices."""

    n_calls: int = 0
    n_failures: int = 0
    n_prompt_tokens: int = 0
    n_completion_tokens: int = 0
    cost: float = 0.0


@dataclass(frozen=True)
class _Open:
    """The question in flight; without ``call`` it was answered before it was sent."""

    request: PlanRequest
    prompt: Optional[Prompt] = None
    call: Optional[Call] = None
    failure: str = ""


class LlmPlanner(Planner):
    """Ask a model over HTTP which candidate to take, or whether to act at all.

    Raises
    ------
    PlannerError : at construction, for an endpoint that can never work.
    """

    def __init__(
        self, config: PlannerConfig, env: Mapping[str, str], clock: Clock, seed: int
    ) -> None:
        self._config = config
        self._clock = clock
        self._seed = seed
        self._client = ChatClient(endpoint_from(config, env), config, seed)
        self._open: Optional[_Open] = None
        self._asked_s: Deque[float] = deque()
        self._is_closed = False
        self.usage = Usage()
        logger.info("LLM planner: prompt %s, order seed %d", config.profile, seed)

    def ask(self, request: PlanRequest) -> None:
        """Send the request in the background; cancels an older one."""
        self.cancel()
        now_s = self._clock()
        budget_s = min(request.deadline_s - now_s, self._config.timeout_s)
        seed = order_seed(self._seed, request.snapshot)
        prompt = render(self._config.profile, request, self._config.n_choices, seed)
        failure = self._refusal(prompt, now_s)
        if failure:
            self._open = _Open(request, failure=failure)
            return
        self._asked_s.append(now_s)
        call = self._client.start(Question(prompt.text, prompt.schema), budget_s)
        self._open = _Open(request, prompt, call)

    def poll(self, now_s: float) -> Optional[Proposal]:
        """Return the answer once it is there, a failure past the deadline, else None."""
        if self._open is None:
            return None
        if self._open.call is None:
            return self._deliver(Reply(failure=self._open.failure))
        reply = self._open.call.result()
        if not now_s < self._open.request.deadline_s:
            self._open.call.expire()
            reply = self._open.call.result()
            latency_s = reply.latency_s if reply is not None else 0.0
            return self._deliver(Reply(failure="timeout", latency_s=latency_s))
        return None if reply is None else self._deliver(reply)

    def wait(self, timeout_s: float) -> Optional[Proposal]:
        """Wait in wall time for the answer, at most ``timeout_s`` and never past the deadline."""
        if self._open is not None and self._open.call is not None:
            reply = self._open.call.wait(timeout_s)
            return None if reply is None else self._deliver(reply)
        return self.poll(self._clock())

    def cancel(self) -> None:
        """Forget the request in flight; its connection is shut."""
        if self._open is not None and self._open.call is not None:
            self._open.call.cancel()
        self._open = None

    def close(self) -> None:
        """Cancel and close the connections; later requests fail as "closed"."""
        self.cancel()
        self._is_closed = True
        self._client.close()

    @property
    def is_pending(self) -> bool:
        """Say whether an answer is still to be returned."""
        return self._open is not None

    def _refusal(self, prompt: Prompt, now_s: float) -> str:
        """Return why this question is not sent, "" when it is."""
        if self._is_closed:
            return "closed"
        if not prompt.indices:
            return "no_candidates"
        while self._asked_s and now_s - self._asked_s[0] >= HOUR_S:
            self._asked_s.popleft()
        return "budget" if len(self._asked_s) >= self._config.max_calls_per_hour else ""

    def _deliver(self, reply: Reply) -> Proposal:
        assert self._open is not None
        asked, self._open = self._open, None
        if reply.failure or asked.prompt is None:
            proposal = _proposal(asked.request, reply, "failure", detail=reply.failure)
        else:
            proposal = interpret(asked.request, asked.prompt, reply)
        self._account(asked, reply, proposal)
        return proposal

    def _account(self, asked: _Open, reply: Reply, proposal: Proposal) -> None:
        if asked.call is None:
            return
        used, config = self.usage, self._config
        cost = 1e-6 * (
            reply.n_prompt_tokens * config.price_prompt_per_mtok
            + reply.n_completion_tokens * config.price_completion_per_mtok
        )
        self.usage = Usage(
            used.n_calls + 1,
            used.n_failures + (proposal.kind == "failure"),
            used.n_prompt_tokens + reply.n_prompt_tokens,
            used.n_completion_tokens + reply.n_completion_tokens,
            used.cost + cost,
        )


def order_seed(seed: int, snapshot: int) -> int:
    """Return the seed of one query's order, the same for the same run seed and snapshot."""
    return 1000003 * seed + snapshot


def interpret(request: PlanRequest, prompt: Prompt, reply: Reply) -> Proposal:
    """Turn the model's text into a proposal; a text that names no candidate is a failure."""
    if prompt.is_index:
        answer = parse_index(reply.text, len(prompt.indices))
        index = prompt.indices[answer.index - 1] if answer.kind == "index" else -1
    else:
        answer = parse_point(reply.text)
        index = nearest_candidate(request.rollouts, answer) if answer.kind == "point" else -1
        if answer.kind == "point" and index < 0:
            answer = Answer("failure", failure="out_of_set")
    if answer.kind == "failure":
        return _proposal(request, reply, "failure", detail=answer.failure)
    shown = prompt.indices.index(index) + 1 if index in prompt.indices else 0
    detail = f"choice {shown} of {len(prompt.indices)}, order seed {prompt.seed}"
    kind = "no_action" if answer.kind == "no_action" else "move"
    return _proposal(request, reply, kind, index, detail)


def nearest_candidate(rollouts: Rollouts, answer: Answer) -> int:
    """Return the candidate within 5 mm of a point on the table, the nearest one, or -1."""
    if max(abs(answer.x_m), abs(answer.y_m)) > FAR_M:
        return -1
    offset_m = rollouts.candidates.tip_m[:, :2] - np.array([answer.x_m, answer.y_m])
    distance_m = np.hypot(offset_m[:, 0], offset_m[:, 1])
    index = int(np.argmin(distance_m))
    return index if distance_m[index] <= SNAP_M else -1


def _proposal(
    request: PlanRequest, reply: Reply, kind: str, index: int = -1, detail: str = ""
) -> Proposal:
    return Proposal(
        source="llm",
        kind=kind,
        snapshot=request.snapshot,
        index=index,
        latency_s=reply.latency_s,
        detail=detail,
    )
