"""What every planner offers: ask without waiting, poll for a wish, cancel.

A planner never moves anything. Its Proposal is an index into the rollouts it was shown, "no
action", or a typed failure; ``apex_edge.decide`` verifies it against the newest state.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Callable, Mapping, Optional

from apex_edge.config import setting
from apex_edge.types import Proposal, Rollouts, Tracks

Clock = Callable[[], float]

FAILURES = (
    "timeout",  # no complete answer before the deadline
    "connect",  # no connection, or it broke before the first byte of a response
    "tls",  # certificate or handshake refused
    "bad_http",  # what came back is not HTTP
    "http_3xx",  # a redirect; never followed, it would carry the key elsewhere
    "http_4xx",  # the request was refused
    "auth",  # 401, 402 or 403
    "rate_limited",  # 429
    "http_5xx",  # the server failed
    "truncated",  # the body or the answer was cut short
    "too_large",  # more than 64 KiB
    "refusal",  # the model declined
    "content_filter",  # the server withheld the answer
    "bad_json",  # not JSON, or ambiguous JSON (a key twice)
    "schema",  # JSON of another shape
    "out_of_set",  # names no candidate
    "not_finite",  # NaN, infinity or a number too large to be meant
    "circuit_open",  # the endpoint failed too often; not asked
    "budget",  # the hourly cap on calls is used up; not asked
    "no_candidates",  # nothing safe to choose from; not asked
    "closed",  # the planner was closed
)
"""Every ``Proposal.detail`` of kind "failure". decide.py adds its own verdicts (stale, unsafe)."""


@dataclass(frozen=True)
class PlanRequest:
    """What a planner is shown: one snapshot of the scene and its simulated outcomes.

    ``snapshot`` is the ``seq`` of ``rollouts``; ``deadline_s`` is absolute, on the same clock as
    ``t_s``; ``mode`` is "reflex_first" or "wait_until_deadline"; ``summary`` is
    the graph stage's S.
    """

    snapshot: int
    t_s: float
    deadline_s: float
    mode: str
    summary: str
    tracks: Tracks
    rollouts: Rollouts


@dataclass(frozen=True)
class PlannerConfig:
    """Section [planner]: which planner is asked, and where the LLM is.

    APEX_LLM_BASE_URL, APEX_LLM_MODEL, APEX_LLM_API_KEY and APEX_LLM_API_KEY_FILE override
    ``base_url``, ``model`` and the key. The key itself is never a setting.
    """

    type: str = setting("llm", "planner plug-in; llm without an endpoint is the same as none")
    base_url: str = setting("", "OpenAI-compatible endpoint, e.g. https://api.openai.com/v1")
    model: str = setting("", "model name sent to the endpoint; empty sends none")
    api_key_env: str = setting("", "name of the environment variable that holds the key")
    api_key_file: str = setting("", "file that holds the key, readable by its owner only")
    ca_file: str = setting("", "PEM file of the certificate authority to trust; empty: certifi's")
    profile: str = setting(
        "compact",
        "prompt: compact (an index), explicit or implicit (the paper's, x and y)",
        choices=("compact", "explicit", "implicit"),
    )
    n_choices: int = setting(5, "safe candidates shown to the planner", low=1, high=20)
    max_tokens: int = setting(48, "longest answer, tokens", low=1, high=4096)
    temperature: float = setting(0.0, "sampling temperature", low=0.0, high=2.0)
    timeout_s: float = setting(5.0, "longest wait for one answer, s", low=0.05, high=60.0)
    max_calls_per_hour: int = setting(600, "cap on calls in any hour", low=1, high=100000)
    price_prompt_per_mtok: float = setting(0.0, "price of a million prompt tokens", low=0.0)
    price_completion_per_mtok: float = setting(0.0, "price of a million answer tokens", low=0.0)


class Planner(ABC):
    """Propose an intervention in the background.

    Every implementation is built as ``Kind(config, env, clock, seed)``: settings, the environment
    to look up overrides in, a callable that gives seconds on the scene's clock (monotonic or
    simulated) and a seed. It belongs to the one thread that calls it.
    """

    @abstractmethod
    def __init__(
        self, config: PlannerConfig, env: Mapping[str, str], clock: Clock, seed: int
    ) -> None: ...

    @abstractmethod
    def ask(self, request: PlanRequest) -> None:
        """Start thinking about ``request``; cancels an older one. Never blocks, never raises."""

    @abstractmethod
    def poll(self, now_s: float) -> Optional[Proposal]:
        """Return the answer to the newest request once, or None while there is nothing to say.

        Parameters
        ----------
        now_s : time on the scene's clock; past the request's deadline the answer is a failure.
        """

    @abstractmethod
    def wait(self, timeout_s: float) -> Optional[Proposal]:
        """Wait for the answer in wall time, at most ``timeout_s`` and never past the deadline.

        Only for a run as fast as possible, where the scene's clock stands still meanwhile.
        """

    @abstractmethod
    def cancel(self) -> None:
        """Forget the request in flight, if any; its answer is never returned."""

    @abstractmethod
    def close(self) -> None:
        """Cancel and release connections."""

    @property
    @abstractmethod
    def is_pending(self) -> bool:
        """Say whether a request waits for ``poll`` or ``wait`` to return its answer."""
