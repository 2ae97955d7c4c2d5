"""What the scripted server is asked and what it answers; see ``fake_server``."""

import json
import random
import re
from dataclasses import dataclass, field
from typing import Any, Callable, List, Mapping, Optional

from apex_edge.planners.endpoint import Secret

ANSWERS = ("first", "random", "worst", "no_action", "out_of_set", "nan", "prose", "hang")

_COMPACT_ROW = re.compile(r"^(\d+): -?\d+ -?\d+ (\S+) (\S+)$", re.MULTILINE)


@dataclass(frozen=True)
class FakeRequest:
    """One request as it came in; ``body`` is the parsed JSON (None when it is none).

    ``number`` counts from 0; ``key`` is the bearer key, which no repr shows; ``headers`` have
    lower-case names and leave the key out.
    """

    number: int
    path: str
    headers: Mapping[str, str]
    body: Any
    key: Optional[Secret]

    @property
    def prompt(self) -> str:
        """Return the text of the last message, "" without one."""
        try:
            return str(self.body["messages"][-1]["content"])
        except (TypeError, KeyError, IndexError):
            return ""


@dataclass(frozen=True)
class FakeReply:
    """What to send: a normal response after ``latency_s``, or one of FAULTS."""

    body: bytes = b"{}"
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    latency_s: float = 0.0
    fault: str = ""


@dataclass(frozen=True)
class Choice:
    """A candidate as a prompt shows it: how to answer with it, and what it leads to."""

    answer: str
    gap: float
    arrival_s: float


Behaviour = Callable[[FakeRequest], FakeReply]


def completion_body(text: str, finish_reason: str = "stop") -> bytes:
    """Return a chat-completions body with one message."""
    choice = {
        "index": 0,
        "finish_reason": finish_reason,
        "message": {"role": "assistant", "content": text},
    }
    usage = {"prompt_tokens": 100, "completion_tokens": 8, "total_tokens": 108}
    data = {"object": "chat.completion", "model": "fake", "choices": [choice], "usage": usage}
    return json.dumps(data).encode("utf-8")


def completion(text: str, latency_s: float = 0.0) -> FakeReply:
    """Return a normal answer with this text."""
    return FakeReply(completion_body(text), latency_s=latency_s)


def sequence(*replies: FakeReply) -> Behaviour:
    """Return a behaviour that gives one reply after the other and then repeats the last."""
    return lambda request: replies[min(request.number, len(replies) - 1)]


def answering(kind: str, latency_s: float = 0.0, seed: int = 0) -> Behaviour:
    """Return a behaviour that answers every prompt in one way.

    Parameters
    ----------
    kind : "first", "random" or "worst" of the candidates shown; "no_action"; "out_of_set", "nan"
        or "prose" (wrong answers); "hang".
    seed : seed of "random".
    """
    if kind not in ANSWERS:
        raise ValueError(f"no answer is named {kind!r}; known: {', '.join(ANSWERS)}")
    rng = random.Random(seed)

    def behave(request: FakeRequest) -> FakeReply:
        if kind == "hang":
            return FakeReply(fault="hang")
        return completion(_answer(kind, request.prompt, rng), latency_s)

    return behave


def read_choices(prompt: str) -> List[Choice]:
    """Read the candidates out of any of our prompts."""
    rows = _COMPACT_ROW.findall(prompt)
    if rows:
        return [
            Choice(json.dumps({"index": int(number)}), _number(gap), _number(arrival))
            for number, arrival, gap in rows
        ]
    start = prompt.find('[{"x"')
    points = json.JSONDecoder().raw_decode(prompt[start:])[0] if start >= 0 else []
    return [
        Choice(
            json.dumps({"x": point["x"], "y": point["y"]}),
            _number(point["min_distance"]),
            _number(point["arrival_s"]),
        )
        for point in points
    ]


def _answer(kind: str, prompt: str, rng: random.Random) -> str:
    is_index = '{"index": n}' in prompt
    choices = read_choices(prompt)
    if kind == "prose" or (kind in ("first", "random", "worst") and not choices):
        return "I would carefully move the arm somewhere between the two balls."
    if kind == "no_action":
        return '{"index": 0}' if is_index else '{"x": -99, "y": -99}'
    if kind == "out_of_set":
        return '{"index": 1412}' if is_index else '{"x": 5.0, "y": 5.0}'
    if kind == "nan":
        return '{"index": NaN}' if is_index else '{"x": NaN, "y": 0.1}'
    if kind == "worst":
        return min(choices, key=lambda choice: (choice.gap, -choice.arrival_s)).answer
    return (rng.choice(choices) if kind == "random" else choices[0]).answer


def _number(text: Any) -> float:
    try:
        return float(text)
    except (TypeError, ValueError):
        return float("inf")
