"""What a report tells: one run, its scenes, and what was noted of each."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Mapping, NamedTuple, Optional, Sequence, Tuple

from apex_edge.types import Array


class Event(NamedTuple):
    """A change in what is done, on the scene's clock."""

    t_s: float
    action: str
    source: str
    text: str


class PlannerCall(NamedTuple):
    """An answer of a planner and what became of it."""

    t_s: float
    source: str
    kind: str
    candidate: int
    latency_s: float
    verdict: str
    detail: str


@dataclass(frozen=True)
class SceneNotes:
    """What SceneStory kept of one scene's steps.

    ``montage`` and ``safe_points`` are (h, w, 3) uint8 BGR or None; ``timing_s`` maps stage to
    its wall times; ``frame_to_command_s`` from capture to the last servo byte, one per command.
    """

    n_frames: int
    duration_s: float
    montage: Optional[Array]
    safe_points: Optional[Array]
    events: Tuple[Event, ...]
    calls: Tuple[PlannerCall, ...]
    timing_s: Mapping[str, Sequence[float]]
    frame_to_command_s: Tuple[float, ...]


@dataclass(frozen=True)
class SceneResult:
    """How one scene went; times on the scene's clock, NaN for what never happened.

    ``t_free_contact_s`` is when the mover would have touched the target had nobody acted (NaN:
    never, or not known); ``visible_s`` for how long before that it was visibly in motion.
    """

    kind: str
    notes: SceneNotes
    seed: Optional[int] = None
    is_collision: bool = False
    is_intervention: bool = False
    source: str = "none"
    t_free_contact_s: float = math.nan
    visible_s: float = math.nan
    t_trigger_s: float = math.nan
    t_reflex_s: float = math.nan
    t_command_s: float = math.nan
    t_arrived_s: float = math.nan
    video: Optional[Path] = None
    counters: Mapping[str, int] = field(default_factory=dict)

    @property
    def would_collide(self) -> bool:
        """Say whether a contact was known to come."""
        return math.isfinite(self.t_free_contact_s)

    @property
    def verdict(self) -> str:
        """Say in one or two words how it ended."""
        if self.is_collision:
            return "collision"
        if self.is_intervention:
            return "prevented" if self.would_collide else "false alarm"
        return "no contact" if self.would_collide else "left alone"

    @property
    def margin_s(self) -> float:
        """Return the time from the arm's arrival to the contact that did not come (or NaN)."""
        return math.nan if self.is_collision else self.t_free_contact_s - self.t_arrived_s


@dataclass(frozen=True)
class RunSummary:
    """One run of the program.

    ``is_judged`` says that the scenes' ends are known (twin); a replay of a recording is not.
    ``about`` is shown as it is (versions, settings, machine).
    """

    title: str
    scenes: Tuple[SceneResult, ...]
    command: str = ""
    created: str = ""
    is_judged: bool = True
    about: Mapping[str, str] = field(default_factory=dict)
