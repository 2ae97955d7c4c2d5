"""Keep of a scene what a report needs, as the steps go by, in little memory."""

import math
from typing import Dict, List, Optional, Set, Tuple

import cv2
import numpy as np

from apex_edge.record.draw import annotate
from apex_edge.record.montage import Moment, montage, spread
from apex_edge.record.safe_points import draw_safe_points
from apex_edge.record.summary import Event, PlannerCall, SceneNotes
from apex_edge.types import Array, Rollouts, Step, Tracks

MOMENT_WIDTH_PX = 640
N_MOMENTS = 6
MAX_PLAIN = 24
"""Plain moments kept before every second one is let go (a moment is 0.9 MB)."""
MAX_EVENTS = 60
MIN_GAP_S = 0.3
ARRIVED_M = 0.006
SIMULATED_AFTER_S = 0.3
ACTS = ("intervene", "redirect")


class SceneStory:
    """Collect a scene's key moments, decisions, timings and safe points.

    Give every step to ``write``, then ask for ``notes``. Steps without a picture (size 0) count
    but show nothing.
    """

    def __init__(self) -> None:
        """Start an empty story."""
        self._n_frames = 0
        self._t_zero_s = math.nan
        self._last: Optional[Step] = None
        self._key: Dict[str, Moment] = {}
        self._plain: List[Moment] = []
        self._plain_every_s = 1.0
        self._events: List[Event] = []
        self._calls: List[PlannerCall] = []
        self._timing_s: Dict[str, List[float]] = {}
        self._sent_s: List[float] = []
        self._state: Tuple[str, ...] = ()
        self._plan: Optional[Tuple[Rollouts, Tracks, int]] = None
        self._has_acted = False

    def write(self, step: Step) -> None:
        """Take in one step."""
        if self._n_frames == 0:
            self._t_zero_s = step.frame.t_s
        self._n_frames += 1
        t_s = step.frame.t_s - self._t_zero_s
        for stage, took_s in step.timing_s.items():
            self._timing_s.setdefault(stage, []).append(took_s)
        self._note_decision(step, t_s)
        self._note_plan(step)
        if step.frame.colour_bgr.size:
            self._keep_moments(step, t_s)
            self._last = step
        if _is_act(step):
            self._has_acted = True

    def notes(self) -> SceneNotes:
        """Return what was kept."""
        moments = self._moments()
        return SceneNotes(
            n_frames=self._n_frames,
            duration_s=self._last.frame.t_s - self._t_zero_s if self._last else 0.0,
            montage=montage(moments) if moments else None,
            safe_points=draw_safe_points(*self._plan) if self._plan else None,
            events=tuple(self._events),
            calls=tuple(self._calls),
            timing_s=self._timing_s,
            frame_to_command_s=tuple(self._sent_s),
        )

    def _note_decision(self, step: Step, t_s: float) -> None:
        decision, ack = step.decision, step.ack
        if step.proposal is not None:
            asked = step.proposal
            self._calls.append(
                PlannerCall(
                    t_s,
                    asked.source,
                    asked.kind,
                    asked.index,
                    asked.latency_s,
                    decision.verdict,
                    asked.detail,
                )
            )
        text = decision.reason or decision.summary
        if ack is not None and not ack.is_accepted:
            text = f"refused: {ack.reason}"
        if ack is not None and ack.is_accepted:
            self._sent_s.append(ack.t_sent_s - step.frame.t_s)
        state = (decision.action, decision.source, decision.verdict)
        if (state != self._state or _is_act(step)) and len(self._events) < MAX_EVENTS:
            self._events.append(Event(t_s, decision.action, decision.source, text))
        self._state = state

    def _note_plan(self, step: Step) -> None:
        if step.rollouts is None or self._has_acted:
            return
        if _is_act(step) or self._plan is None:
            self._plan = (step.rollouts, step.tracks, step.decision.index)

    def _keep_moments(self, step: Step, t_s: float) -> None:
        labels = [name for name in self._new_labels(step, t_s) if name not in self._key]
        is_due = not self._plain or t_s - self._plain[-1].t_s >= self._plain_every_s
        if not labels and not is_due:
            return
        picture = _shrunk(annotate(step, self._t_zero_s))
        for label in labels:
            self._key[label] = Moment(label, t_s, picture)
        if is_due:
            self._plain.append(Moment(step.decision.action.replace("none", "clear"), t_s, picture))
        if len(self._plain) > MAX_PLAIN:
            self._plain = self._plain[::2]
            self._plain_every_s *= 2.0

    def _new_labels(self, step: Step, t_s: float) -> List[str]:
        labels = ["start"]
        if step.hazards is not None and bool(np.any(step.hazards.is_fired)):
            labels.append("hazard")
        hazard = self._key.get("hazard")
        is_later = hazard is not None and t_s - hazard.t_s >= SIMULATED_AFTER_S
        if step.rollouts is not None and is_later and not self._has_acted:
            labels.append("simulated")
        if _is_act(step):
            labels.append("intervention")
        if self._has_acted and _is_there(step):
            labels.append("arm there")
        return labels

    def _moments(self) -> List[Moment]:
        if self._last is None:
            return []
        t_s = self._last.frame.t_s - self._t_zero_s
        end = Moment("end", t_s, _shrunk(annotate(self._last, self._t_zero_s)))
        if "hazard" not in self._key and "intervention" not in self._key:
            return _one_per_time([*spread(self._plain, N_MOMENTS - 1), end])
        told = _one_per_time([*sorted(self._key.values(), key=lambda m: m.t_s), end])[-N_MOMENTS:]
        return _filled(told, self._plain)


def _is_act(step: Step) -> bool:
    is_accepted = step.ack is not None and step.ack.is_accepted
    return step.decision.action in ACTS and is_accepted


def _is_there(step: Step) -> bool:
    if step.arm is None or step.decision.target_m is None:
        return False
    away = np.asarray(step.arm.tip_m) - np.asarray(step.decision.target_m)
    return float(np.linalg.norm(away)) <= ARRIVED_M


def _one_per_time(moments: List[Moment]) -> List[Moment]:
    """Keep the most telling of the moments that share a frame: the last named."""
    kept: List[Moment] = []
    seen: Set[float] = set()
    for moment in reversed(moments):
        if moment.t_s not in seen:
            seen.add(moment.t_s)
            kept.append(moment)
    return kept[::-1]


def _filled(told: List[Moment], plain: List[Moment]) -> List[Moment]:
    """Add plain moments where the story leaves the widest gaps, up to N_MOMENTS."""
    filled, rest = list(told), list(plain)
    while len(filled) < N_MOMENTS and rest:
        gaps = [min(abs(moment.t_s - kept.t_s) for kept in filled) for moment in rest]
        widest = int(np.argmax(gaps))
        if gaps[widest] < MIN_GAP_S:
            break
        filled.append(rest.pop(widest))
    return sorted(filled, key=lambda moment: moment.t_s)


def _shrunk(picture: Array) -> Array:
    height, width = picture.shape[:2]
    if width <= MOMENT_WIDTH_PX:
        return picture
    size = (MOMENT_WIDTH_PX, max(1, round(height * MOMENT_WIDTH_PX / width)))
    small: Array = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    return small
