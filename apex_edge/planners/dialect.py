"""How a question is worded for one endpoint, and what a refused request teaches about it.

Back ends differ: newer OpenAI models refuse ``max_tokens`` and ``temperature``, others do not know
``json_schema``. A 400 tries the next wording; the one that worked is kept for the next call.
"""

from dataclasses import dataclass, replace
from typing import Any, Dict, Mapping, Optional

from apex_edge.planners.base import PlannerConfig

LADDER = ("json_schema", "json_object", "plain")
MAX_CHANGES = len(LADDER) + 1  # two rungs down, max_tokens, temperature


@dataclass(frozen=True)
class Question:
    """What to ask: one user message and the JSON schema its answer should follow."""

    text: str
    schema: Mapping[str, Any]


@dataclass(frozen=True)
class Dialect:
    """What the endpoint is known to understand; ``rung`` indexes LADDER."""

    rung: int = 0
    tokens_key: str = "max_tokens"
    sends_temperature: bool = True

    def after_400(self, body: bytes) -> Optional["Dialect"]:
        """Return the next wording to try after a refusal, or None when no wording can help."""
        text = body[:4096].decode("utf-8", "replace").lower().replace(" ", "_")
        if "context_size" in text or "context_length" in text:
            return None
        if "max_completion_tokens" in text and self.tokens_key == "max_tokens":
            return replace(self, tokens_key="max_completion_tokens")
        if "temperature" in text and self.sends_temperature:
            return replace(self, sends_temperature=False)
        if self.rung + 1 < len(LADDER):
            return replace(self, rung=self.rung + 1)
        return None

    def body(self, question: Question, model: str, config: PlannerConfig) -> Dict[str, Any]:
        """Return the request body in this wording; no ``model`` is sent when it is empty."""
        body: Dict[str, Any] = {"messages": [{"role": "user", "content": question.text}]}
        if model:
            body["model"] = model
        body[self.tokens_key] = config.max_tokens
        if self.sends_temperature:
            body["temperature"] = config.temperature
        if LADDER[self.rung] == "json_schema":
            # objects, enums and numbers only: a pattern made a real server fail after generating
            schema = {"name": "answer", "strict": True, "schema": dict(question.schema)}
            body["response_format"] = {"type": "json_schema", "json_schema": schema}
        elif LADDER[self.rung] == "json_object":
            body["response_format"] = {"type": "json_object"}
        return body
