"""Read what an LLM answered: tolerant of wrapping, strict about content, never raising.

A model wraps its JSON in prose, fences or thoughts; that is taken off. What is inside must be
exactly one index or one point: a key twice, NaN, a boolean or a huge number is a failure, not a
guess. Source: ours (the paper's code strips with a regular expression and passes the text on).
"""

import json
import math
import re
from dataclasses import dataclass
from email.utils import mktime_tz, parsedate_tz
from typing import Any, Dict, List, Mapping, Optional, Tuple

NO_ACTION_COORDINATE = -99.0
TEXT_LIMIT = 65536
DIGITS_LIMIT = 18  # more digits than any index, coordinate or token count has

_THINK = re.compile(r"<(/?)think(?:ing)?>", re.IGNORECASE)
_FENCE = re.compile(r"```[A-Za-z]*")
_BARE_INDEX = re.compile(r"[\"'`]?([0-9]{1,3})[\"'`]?\.?")
_SECONDS = re.compile(r"[0-9]{1,6}(?:\.[0-9]{1,6})?")
_PLAIN_NUMBER = re.compile(r"[+-]?[0-9]{1,9}(?:\.[0-9]{1,12})?")


@dataclass(frozen=True)
class Answer:
    """What the text says: ``kind`` is "index", "point", "no_action" or "failure".

    ``index`` counts from 1; ``x_m``, ``y_m`` are as the model wrote them; ``failure`` is one of
    ``apex_edge.planners.base.FAILURES``.
    """

    kind: str
    index: int = 0
    x_m: float = math.nan
    y_m: float = math.nan
    failure: str = ""


@dataclass(frozen=True)
class Completion:
    """The message in a chat-completions body, or why there is none."""

    text: str = ""
    failure: str = ""
    n_prompt_tokens: int = 0
    n_completion_tokens: int = 0


class _RefusedError(ValueError):
    """Carry the kind of failure out of the JSON hooks."""


def parse_index(text: str, n_choices: int) -> Answer:
    """Read an index 1..n_choices, or 0 for no action, from ``{"index": 2}`` or a bare digit."""
    stripped = strip_wrapping(text)
    bare = _BARE_INDEX.fullmatch(stripped)
    if bare:
        number: float = float(bare.group(1))
    else:
        found, failure = last_object(stripped, ("index",))
        if found is None:
            return _failed(failure)
        number, failure = _as_number(found["index"])
        if failure:
            return _failed(failure)
    if not number.is_integer():
        return _failed("schema")
    if number == 0:
        return Answer("no_action")
    if not 1 <= number <= n_choices:
        return _failed("out_of_set")
    return Answer("index", index=int(number))


def parse_point(text: str) -> Answer:
    """Read a point from ``{"x": 0.1, "y": 0.2}``; -99 for both is no action, for one a failure."""
    found, failure = last_object(strip_wrapping(text), ("x", "y"))
    if found is None:
        return _failed(failure)
    x, failure_x = _as_number(found["x"])
    y, failure_y = _as_number(found["y"])
    if failure_x or failure_y:
        return _failed(failure_x or failure_y)
    n_sentinels = (x == NO_ACTION_COORDINATE) + (y == NO_ACTION_COORDINATE)
    if n_sentinels == 2:
        return Answer("no_action")
    if n_sentinels == 1:
        return _failed("schema")
    return Answer("point", x_m=x, y_m=y)


def parse_completion(body: bytes) -> Completion:
    """Read the message out of an OpenAI-compatible response body.

    A cut or withheld answer (finish_reason length, content_filter), a refusal field and an error
    object under status 200 are failures even when the text would parse.
    """
    try:
        data = _loads(body.decode("utf-8"))
    except UnicodeDecodeError:
        return Completion(failure="bad_json")
    except _RefusedError as error:
        return Completion(failure=str(error))
    if not isinstance(data, dict):
        return Completion(failure="schema")
    if data.get("error"):
        return Completion(failure=_error_kind(data["error"]))
    choices = data.get("choices")
    if not isinstance(choices, list) or not choices or not isinstance(choices[0], dict):
        return Completion(failure="schema")
    text, failure = _message_text(choices[0])
    usage = data.get("usage")
    counts = usage if isinstance(usage, dict) else {}
    return Completion(
        text, failure, _count(counts, "prompt_tokens"), _count(counts, "completion_tokens")
    )


def strip_wrapping(text: str) -> str:
    """Take off thoughts (closed, unclosed, or closed without an opening) and code fences."""
    text = text[:TEXT_LIMIT]
    kept: List[str] = []
    position, depth = 0, 0
    for tag in _THINK.finditer(text):
        if not depth:
            kept.append(text[position : tag.start()])
        if not tag.group(1):
            depth += 1
        elif depth:
            depth -= 1
        else:
            kept = []  # all before a closing tag without an opening was thought
        position = tag.end()
    if not depth:
        kept.append(text[position:])
    return _FENCE.sub(" ", " ".join(kept)).strip()


def last_object(text: str, keys: Tuple[str, ...]) -> Tuple[Optional[Dict[str, Any]], str]:
    """Return the last balanced top-level JSON object that has all ``keys``, or a failure kind.

    An object further back is never taken when a later one that names a wanted key is malformed:
    the model changed its mind, and to what cannot be read.
    """
    failure = "bad_json"
    for start, end in reversed(_object_spans(text)):
        piece = text[start:end]
        try:
            value = _loads(piece)
        except _RefusedError as error:
            if any(f'"{key}"' in piece for key in keys):
                return None, str(error)
            continue
        if all(key in value for key in keys):
            return value, ""
        if any(key in value for key in keys):
            return None, "schema"
        failure = "schema"
    return None, failure


def _object_spans(text: str) -> List[Tuple[int, int]]:
    """Find top-level {...} in one pass; braces inside strings of an object do not count."""
    spans: List[Tuple[int, int]] = []
    depth = start = 0
    is_string = is_escaped = False
    for position, letter in enumerate(text):
        if is_string:
            is_string = is_escaped or letter != '"'
            is_escaped = letter == "\\" and not is_escaped
        elif letter == "{":
            start = start if depth else position
            depth += 1
        elif depth and letter == '"':
            is_string = True
        elif depth and letter == "}":
            depth -= 1
            if not depth:
                spans.append((start, position + 1))
    return spans


def _loads(text: str) -> Any:
    """Parse JSON strictly.

    Raises
    ------
    _RefusedError : not JSON, a key twice, NaN or infinity, or a number too long to be meant.
    """
    try:
        return json.loads(
            text,
            object_pairs_hook=_object,
            parse_constant=_constant,
            parse_int=_integer,
            parse_float=_real,
        )
    except _RefusedError:
        raise
    except (ValueError, RecursionError):
        raise _RefusedError("bad_json") from None


def _object(pairs: List[Tuple[str, Any]]) -> Dict[str, Any]:
    built = dict(pairs)
    if len(built) != len(pairs):
        raise _RefusedError("bad_json")
    return built


def _constant(name: str) -> float:
    raise _RefusedError("not_finite")


def _integer(digits: str) -> int:
    # checked before int(): conversion of a million digits takes quadratic time on old Pythons
    if len(digits) > DIGITS_LIMIT + 1:
        raise _RefusedError("not_finite")
    return int(digits)


def _real(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise _RefusedError("not_finite")
    return value


def _as_number(value: Any) -> Tuple[float, str]:
    """Return a finite number and "", or NaN and a failure kind."""
    if isinstance(value, str) and _PLAIN_NUMBER.fullmatch(value.strip()):
        return float(value), ""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return math.nan, "schema"
    return float(value), ""


def _message_text(choice: Dict[str, Any]) -> Tuple[str, str]:
    """Return the text of one choice and "", or "" and a failure kind."""
    finish = choice.get("finish_reason")
    if finish == "length":
        return "", "truncated"
    if finish == "content_filter":
        return "", "content_filter"
    message = choice.get("message")
    if not isinstance(message, dict):
        return "", "schema"
    if message.get("refusal"):
        return "", "refusal"
    content = message.get("content")
    if isinstance(content, list):
        parts = [part for part in content if isinstance(part, dict)]
        if any(part.get("type") == "refusal" for part in parts):
            return "", "refusal"
        content = "".join(str(part["text"]) for part in parts if "text" in part)
    if isinstance(content, str) and content.strip():
        return content, ""
    return _tool_text(message.get("tool_calls"))


def _tool_text(calls: Any) -> Tuple[str, str]:
    if isinstance(calls, list) and len(calls) == 1 and isinstance(calls[0], dict):
        function = calls[0].get("function")
        if isinstance(function, dict) and isinstance(function.get("arguments"), str):
            return function["arguments"], ""
    return "", "schema"


def _error_kind(error: Any) -> str:
    """Map an error object sent under status 200 (as some routers do) to a failure kind."""
    code = error.get("code") if isinstance(error, dict) else None
    if isinstance(code, bool) or not isinstance(code, int):
        return "http_5xx"
    return status_kind(code) or "http_5xx"


def status_kind(status: int) -> str:
    """Return the failure kind of an HTTP status, "" for 2xx."""
    if 200 <= status < 300:
        return ""
    if status in (401, 402, 403):
        return "auth"
    if status == 429:
        return "rate_limited"
    if 300 <= status < 400:
        return "http_3xx"
    return "http_4xx" if 400 <= status < 500 else "http_5xx"


def retry_after_s(headers: Mapping[str, str], now_wall_s: float) -> Optional[float]:
    """Read retry-after-ms or Retry-After (seconds or HTTP date); None when absent or unreadable."""
    milliseconds = _plain(headers.get("retry-after-ms", ""))
    if milliseconds is not None:
        return milliseconds / 1000.0
    text = headers.get("retry-after", "").strip()
    seconds = _plain(text)
    if seconds is not None:
        return seconds
    parsed = parsedate_tz(text) if text else None
    return max(0.0, mktime_tz(parsed) - now_wall_s) if parsed else None


def _plain(text: str) -> Optional[float]:
    return float(text) if _SECONDS.fullmatch(text.strip()) else None


def _count(counts: Dict[str, Any], key: str) -> int:
    value = counts.get(key)
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else 0


def _failed(kind: str) -> Answer:
    return Answer("failure", failure=kind)
