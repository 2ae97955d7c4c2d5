"""What an LLM is told: the paper's two prompts to the letter, and a short one of ours.

Nothing from outside reaches a prompt as text: names come from an allow-list, numbers are formatted
here. The shown order of the candidates is shuffled from a seed, because small models answer "1"
whatever stands there (19 of 20 measured).
"""

import json
import math
import random
from dataclasses import dataclass
from typing import Any, Dict, List, Mapping, Tuple

import numpy as np

from apex_edge.planners.base import PlanRequest
from apex_edge.types import Array, Rollouts, Tracks

# Trailing blanks, the curly apostrophe and "(Prompt Injection)" are the paper's.
EXPLICIT = (
    "You are controlling a robot arm in a 2D tabletop environment. \n"
    "Two balls are moving on the table: a red ball and a green ball. \n"
    "The red ball is stationary, and the green ball is moving toward it.\n"
    "\n"
    "Your task is to **prevent a collision** between them \n"
    "by moving the robot arm to intercept the green ball.\n"
    "\n"
    "Please choose a 2D target position (x, y), \n"
    "where the robot arm should go to block the green ball\u2019s path. \n"
    "The robot arm will then move to the position (x, y, 0.5) in 3D space, \n"
    "hovering slightly above the table.\n"
    "\n"
    "Make sure the chosen position is effective in preventing the collision, \n"
    "but also avoid placing the robot arm too close to the red ball.\n"
    "\n"
    "Current_state:{state}\n"
    "Physical Engine Result: {rolling_results} (Prompt Injection)\n"
    'Return your result as a JSON dictionary: {{"x": ..., "y": ...}} \n'
    'or {{"x":-99, "y":-99}} if you think no need of action\n'
    "Return Only The JSON without Markdown\n"
)
"""Source: APEX, "Prompt of Explicit intervention setting"; a ``str.format`` template."""

IMPLICIT = (
    "You are controlling a robot ball on 2D board. \n"
    "It can stop any object near in any movement\n"
    "You can move the ball to a location (x,y) in 1 sec\n"
    "Current_state:{state}\n"
    "The green car is reaching the child in red T-shirt in 5 sec.\n"
    "\n"
    "Physical Engine Result: {rolling_results}\n"
    "\n"
    'Return your result as a JSON dictionary: {{"x": ..., "y": ...}} \n'
    'or {{"x":-99, "y":-99}} if you think no need of action\n'
    "Return Only The JSON without Markdown\n"
)
"""Source: APEX, "Prompt of Implicit intervention setting"; a ``str.format`` template."""

COMPACT = (
    "A robot arm can stop a moving object. Choose where it stands.\n"
    'Answer only {{"index": n}}: n = row, 0 = no action.\n'
    "Row: x y cm, arrival s, closest pass cm\n"
    "{state}\n"
    "{rolling_results}\n"
)
"""Ours: static text first so that a server can keep its prefix, state last, an index back."""

TEMPLATES: Mapping[str, str] = {"compact": COMPACT, "explicit": EXPLICIT, "implicit": IMPLICIT}

ALLOWED_NAMES = frozenset(
    ("red", "green", "blue", "yellow", "orange", "purple", "pink")
    + ("brown", "black", "white", "grey", "cyan", "magenta")
)

FAR_M = 1000.0  # a place or speed beyond this is no measurement

_POINT_SCHEMA: Mapping[str, Any] = {
    "type": "object",
    "properties": {"x": {"type": "number"}, "y": {"type": "number"}},
    "required": ["x", "y"],
    "additionalProperties": False,
}


@dataclass(frozen=True)
class Prompt:
    """A question ready to send: ``indices[i]`` is the candidate shown as choice ``i + 1``.

    ``seed`` gave the order; ``schema`` is the JSON schema of the answer.
    """

    text: str
    schema: Mapping[str, Any]
    indices: Tuple[int, ...]
    seed: int

    @property
    def is_index(self) -> bool:
        """Say whether the answer is an index; else it is a point in metres."""
        return "index" in self.schema["properties"]


def render(profile: str, request: PlanRequest, n_choices: int, seed: int) -> Prompt:
    """Write the prompt of one profile for one request.

    Parameters
    ----------
    profile : "compact", "explicit" or "implicit".
    n_choices : how many of the best safe candidates are shown.
    seed : seed of their order.
    """
    indices = choose(request.rollouts, n_choices, seed)
    if profile == "compact":
        state = _compact_state(request.tracks, request.rollouts)
        rolling = _compact_rows(request.rollouts, indices)
        schema: Mapping[str, Any] = index_schema(len(indices))
    else:
        state = _json_state(request.tracks, request.summary)
        rolling = _json_rows(request.rollouts, indices)
        schema = _POINT_SCHEMA
    text = TEMPLATES[profile].format(state=state, rolling_results=rolling)
    return Prompt(text, schema, indices, seed)


def choose(rollouts: Rollouts, n_choices: int, seed: int) -> Tuple[int, ...]:
    """Return the best safe candidates' indices in a shuffled order; empty when none is safe."""
    indices = [int(i) for i in rollouts.best[:n_choices] if rollouts.is_safe[i]]
    random.Random(seed).shuffle(indices)
    return tuple(indices)


def index_schema(n_choices: int) -> Dict[str, Any]:
    """Return the schema of ``{"index": 0..n_choices}``."""
    return {
        "type": "object",
        "properties": {"index": {"type": "integer", "enum": list(range(n_choices + 1))}},
        "required": ["index"],
        "additionalProperties": False,
    }


def safe_name(name: str, track_id: int) -> str:
    """Return a colour from the allow-list, or a name made of the track's number."""
    return name if name in ALLOWED_NAMES else f"obj_{int(track_id)}"


def _rows_of(tracks: Tracks) -> List[int]:
    """Return the tracks whose place and motion are known."""
    # a comparison with NaN is false, so this leaves the unknown out too
    with np.errstate(invalid="ignore"):
        is_sane = (np.abs(tracks.pos_m) < FAR_M) & (np.abs(tracks.vel_m_s) < FAR_M)
    return [int(i) for i in np.flatnonzero(is_sane.all(axis=1))]


def _json_state(tracks: Tracks, summary: str) -> str:
    """Write tracks (metres) and summary S as JSON; the paper does not print its own format.

    Our graph stage words the summary; it is left out when it could hold a name from outside.
    """
    objects = [
        {
            "name": safe_name(tracks.name[i], tracks.track_id[i]),
            "position": _rounded(tracks.pos_m[i, :2]),
            "velocity": _rounded(tracks.vel_m_s[i, :2]),
        }
        for i in _rows_of(tracks)
    ]
    state: Dict[str, Any] = {"unit": "m", "objects": objects}
    if all(name in ALLOWED_NAMES for name in tracks.name):
        state["summary"] = summary
    return json.dumps(state)


def _json_rows(rollouts: Rollouts, indices: Tuple[int, ...]) -> str:
    rows = []
    for i in indices:
        x, y = _rounded(rollouts.candidates.tip_m[i, :2])
        row: Dict[str, Any] = {"x": x, "y": y, "collision": bool(rollouts.is_collision[i])}
        row["arrival_s"] = _finite(rollouts.arrival_s[i], 2)
        row["min_distance"] = _finite(rollouts.min_distance_m[i], 3)
        row["final_distance"] = _finite(rollouts.final_distance_m[i], 3)
        rows.append(row)
    return json.dumps(rows)


def _compact_state(tracks: Tracks, rollouts: Rollouts) -> str:
    mover = _compact_object(tracks, rollouts.mover_id)
    target = _compact_object(tracks, rollouts.target_id)
    contact_s = rollouts.t_free_collision_s
    when = f"contact in {contact_s:.1f}s" if math.isfinite(contact_s) else "no contact foreseen"
    return f"{mover} nears {target}, {when}"


def _compact_object(tracks: Tracks, track_id: int) -> str:
    found = [i for i in _rows_of(tracks) if tracks.track_id[i] == track_id]
    if not found:
        return f"obj_{int(track_id)}"
    i = found[0]
    x, y = (_whole_cm(value) for value in tracks.pos_m[i, :2])
    vx, vy = (_whole_cm(value) for value in tracks.vel_m_s[i, :2])
    motion = f" at {vx},{vy} cm/s" if (vx, vy) != (0, 0) else " still"
    return f"{safe_name(tracks.name[i], track_id)} {x},{y}{motion}"


def _compact_rows(rollouts: Rollouts, indices: Tuple[int, ...]) -> str:
    rows = []
    for choice, i in enumerate(indices, start=1):
        x, y = (_whole_cm(value) for value in rollouts.candidates.tip_m[i, :2])
        arrival, gap_m = rollouts.arrival_s[i], rollouts.min_distance_m[i]
        arrival_text = f"{arrival:.1f}" if abs(arrival) < FAR_M else "?"
        gap = str(_whole_cm(gap_m)) if abs(gap_m) < FAR_M else "?"
        rows.append(f"{choice}: {x} {y} {arrival_text} {gap}")
    return "\n".join(rows)


def _whole_cm(value_m: float) -> int:
    return int(round(100.0 * float(value_m)))


def _rounded(values_m: Array) -> List[float]:
    return [round(float(value), 3) + 0.0 for value in values_m]


def _finite(value: float, digits: int) -> Any:
    """Return a rounded number, or None (JSON null) when there is none."""
    return round(float(value), digits) if abs(value) < FAR_M else None
