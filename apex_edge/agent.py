"""The agent: wire the stages, one step a frame (algorithm 1 of the paper, on a table).

``step`` is deterministic: it reads no clock but the one handed in and keeps its state in its
stages. ``run`` is the thin loop around it, and the only place that catches everything: whatever
fails, the arm is stopped first.
"""

import logging
import time
from dataclasses import dataclass, replace
from typing import Callable, Dict, List, Optional, Tuple

import numpy as np

from apex_edge import graph
from apex_edge.act import Actuator
from apex_edge.cameras.base import Camera
from apex_edge.config import setting
from apex_edge.decide import Decider, OpenHazard, Situation
from apex_edge.errors import CameraError
from apex_edge.perception import Perception
from apex_edge.planners.base import Planner, PlanRequest
from apex_edge.simulate.base import PhysicsSim, SimulateConfig, problem_from
from apex_edge.triggers.base import Trigger
from apex_edge.types import (
    ArmAck,
    ArmCommand,
    ArmState,
    Array,
    Candidates,
    Decision,
    DifferenceGraph,
    Frame,
    HazardScores,
    Proposal,
    Rollouts,
    SceneGraph,
    Step,
    Tracks,
    TrackStatus,
)

log = logging.getLogger(__name__)

STALE_S = 0.25
"""Without a frame for this long the arm holds: what it was told to do rests on an old picture."""
MAX_AGE_S = 0.5  # no move is started on a picture older than this
SWITCH_S = 0.2  # by which another hazard must be more urgent to be followed instead of the open one
MOVING_M_S = 0.02
MOVES = ("intervene", "redirect", "return")


@dataclass(frozen=True)
class AgentConfig:
    """What the agent guards and how it talks about it."""

    protected: Tuple[str, ...] = setting(("red",), "names of the objects nothing may run into")
    top_k: int = setting(3, "salient edges that make the summary (APEX algorithm 1, line 3)", 1, 20)
    latency_s: float = setting(0.03, "s charged for the way from capture to servo byte", 0, 1)


@dataclass(frozen=True)
class Parts:
    """The stages of one agent; ``actuator`` None means watch only."""

    perception: Perception
    trigger: Trigger
    simulator: PhysicsSim
    simulate: SimulateConfig
    decider: Decider
    planner: Planner
    candidates: Candidates
    tip_radius_m: float
    mode: str
    actuator: Optional[Actuator] = None


class Stopwatch:
    """Split the wall time of a step into named stages."""

    def __init__(self, timer: Callable[[], float]) -> None:
        self._timer = timer
        self._last_s = timer()
        self.timing_s: Dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on ``stage``."""
        now_s = self._timer()
        self.timing_s[stage] = now_s - self._last_s
        self._last_s = now_s


class Agent:
    """Follow a table frame by frame and stop what would run into a protected object.

    Parameters
    ----------
    config : what to guard.
    parts : the stages.
    clock : seconds on the base of the frames' capture times.
    timer : wall clock for the stage timings, which never enter a decision.
    """

    def __init__(
        self,
        config: AgentConfig,
        parts: Parts,
        clock: Callable[[], float],
        timer: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._config = config
        self._parts = parts
        self._clock = clock
        self._timer = timer
        self._graph: Optional[SceneGraph] = None
        self._asked = -1
        self._last_t_s = float("nan")

    def step(self, frame: Frame) -> Step:
        """Take one frame through all stages and return everything it led to."""
        watch = Stopwatch(self._timer)
        detections, tracks = self._parts.perception.step(frame)
        watch.lap("perceive")
        difference = self._difference(frame, tracks)
        watch.lap("graph")
        hazards = None
        if difference is not None:
            hazards = self._parts.trigger.score(difference, self._parts.simulate.horizon_s)
        watch.lap("trigger")
        hazard = self._most_urgent(hazards, tracks)
        arm = self._parts.actuator.state() if self._parts.actuator is not None else None
        rollouts = self._rollouts(frame, tracks, hazard, arm)
        watch.lap("simulate")
        proposal = self._parts.planner.poll(self._clock())
        summary = self._summary(difference, hazards)
        decision = self._decide(frame, tracks, hazard, rollouts, proposal, arm, summary)
        watch.lap("decide")
        command, ack = self._act(decision)
        watch.lap("act")
        self._ask(decision, hazard, rollouts, tracks)
        return Step(
            frame=frame,
            detections=detections,
            tracks=tracks,
            difference=difference,
            hazards=hazards,
            rollouts=rollouts,
            proposal=proposal,
            decision=decision,
            command=command,
            ack=ack,
            arm=arm,
            timing_s=watch.timing_s,
        )

    @property
    def colour_use(self) -> Dict[str, float]:
        """Return per colour how much of its tolerance its objects use up (1: about to be lost)."""
        return self._parts.perception.drift.used

    def hold(self) -> None:
        """Stop the arm where it is and start afresh: what was foreseen is no longer true."""
        if self._parts.actuator is not None:
            self._parts.actuator.stop()
        self._parts.planner.cancel()
        self._parts.decider.blind(self._clock())
        self._parts.trigger.reset()
        self._parts.perception.reset()
        self._graph = None

    def close(self) -> None:
        """Drop what is in flight and leave the arm where it is, stopped."""
        try:
            if self._parts.actuator is not None:
                self._parts.actuator.stop()
        finally:
            self._parts.planner.close()

    def _difference(self, frame: Frame, tracks: Tracks) -> Optional[DifferenceGraph]:
        """Build G_t and, against the frame before, the difference graph."""
        if frame.camera is None or frame.is_repeated:
            return None
        newer = graph.build(tracks)
        older, self._graph = self._graph, newer
        if older is None or newer.t_s <= older.t_s:
            return None
        return graph.difference(older, newer)

    def _most_urgent(self, hazards: Optional[HazardScores], tracks: Tracks) -> Optional[OpenHazard]:
        """Return the alarm with the earliest pessimistic contact about a protected object.

        The one that is followed already keeps its place unless another is clearly more urgent.
        """
        if hazards is None or not hazards.is_fired.any():
            return None
        alarms = [
            alarm
            for edge in np.flatnonzero(hazards.is_fired)
            for alarm in self._alarm(hazards, int(edge), tracks)
        ]
        if not alarms:
            return None
        first = min(alarms, key=lambda alarm: alarm.ttc_early_s)
        open_pair = self._parts.decider.pair
        for alarm in alarms:
            if alarm.pair == open_pair and alarm.ttc_early_s - first.ttc_early_s < SWITCH_S:
                return alarm
        return first

    def _alarm(self, hazards: HazardScores, edge: int, tracks: Tracks) -> List[OpenHazard]:
        """Return the alarm of one edge as who threatens which protected object; [] when none does.

        Of two that move the trigger calls the faster one the mover; a protected object that is the
        faster of the two is threatened all the same.
        """
        mover_id, target_id = int(hazards.mover_id[edge]), int(hazards.target_id[edge])
        rows = {int(track_id): row for row, track_id in enumerate(tracks.track_id)}
        protected = self._config.protected
        if tracks.name[rows[target_id]] not in protected:
            speed = float(np.linalg.norm(tracks.vel_m_s[rows[target_id]]))
            if tracks.name[rows[mover_id]] not in protected or speed < MOVING_M_S:
                return []
            mover_id, target_id = target_id, mover_id
        ttc_s, early_s = float(hazards.ttc_s[edge]), float(hazards.ttc_early_s[edge])
        return [OpenHazard(mover_id, target_id, ttc_s, early_s)]

    def _rollouts(
        self,
        frame: Frame,
        tracks: Tracks,
        hazard: Optional[OpenHazard],
        arm: Optional[ArmState],
    ) -> Optional[Rollouts]:
        """Simulate every candidate for the open pair, each with its own arm arrival time."""
        pair = hazard.pair if hazard is not None else self._parts.decider.pair
        if pair is None or not _are_alive(tracks, pair):
            return None
        problem = problem_from(
            tracks, pair[0], pair[1], self._parts.simulate, self._parts.tip_radius_m
        )
        arrival_s = self._arrival_s(frame, arm)
        return self._parts.simulator.rollout(problem, self._parts.candidates, arrival_s)

    def _arrival_s(self, frame: Frame, arm: Optional[ArmState]) -> Array:
        """Return when the arm could stand at each candidate (n,), in s from the capture time."""
        n = len(self._parts.candidates.tip_m)
        if self._parts.actuator is None or arm is None:
            return np.zeros(n)
        late_s = max(self._clock() - frame.t_s, 0.0) + self._config.latency_s
        arrival_s = self._parts.actuator.travel_s(self._parts.candidates, arm) + late_s
        decider = self._parts.decider
        if decider.index >= 0 and np.isfinite(arrival_s[decider.index]):
            arrival_s[decider.index] = decider.remaining_s(frame.t_s)
        return arrival_s

    def _summary(
        self, difference: Optional[DifferenceGraph], hazards: Optional[HazardScores]
    ) -> str:
        if difference is None or hazards is None:
            return ""
        horizon_s = self._parts.simulate.horizon_s
        return graph.summarise(difference, hazards, self._config.top_k, horizon_s)

    def _decide(
        self,
        frame: Frame,
        tracks: Tracks,
        hazard: Optional[OpenHazard],
        rollouts: Optional[Rollouts],
        proposal: Optional[Proposal],
        arm: Optional[ArmState],
        summary: str,
    ) -> Decision:
        period_s = frame.t_s - self._last_t_s
        self._last_t_s = frame.t_s
        situation = Situation(
            seq=frame.seq,
            t_s=frame.t_s,
            hazard=hazard,
            rollouts=rollouts,
            proposal=proposal,
            mover_gap_m=self._mover_gap_m(tracks, arm),
            summary=summary,
        )
        if 0.0 < period_s < 1.0:
            situation = replace(situation, period_s=period_s)
        return self._parts.decider.step(situation)

    def _mover_gap_m(self, tracks: Tracks, arm: Optional[ArmState]) -> float:
        pair = self._parts.decider.pair
        if pair is None or arm is None or not _are_alive(tracks, pair):
            return float("inf")
        row = int(np.flatnonzero(tracks.track_id == pair[0])[0])
        flat_m = float(np.hypot(*(tracks.pos_m[row, :2] - arm.tip_m[:2])))
        return flat_m - float(tracks.radius_m[row]) - self._parts.tip_radius_m

    def _act(self, decision: Decision) -> Tuple[Optional[ArmCommand], Optional[ArmAck]]:
        """Carry out a decision on a fresh picture, and tell the decider when the arm refuses.

        Raises
        ------
        LinkLost : the arm can no longer be commanded.
        """
        actuator = self._parts.actuator
        if actuator is None:
            return None, None
        actuator.check()
        if decision.action in MOVES and self._clock() - decision.t_s > MAX_AGE_S:
            log.warning("no move on a picture that is %.2f s old", self._clock() - decision.t_s)
            self._parts.decider.refuse()
            return None, None
        command, ack = actuator.execute(decision, decision.seq, decision.t_s)
        if ack is not None and not ack.is_accepted:
            self._parts.decider.refuse()
        return command, ack

    def _ask(
        self,
        decision: Decision,
        hazard: Optional[OpenHazard],
        rollouts: Optional[Rollouts],
        tracks: Tracks,
    ) -> None:
        """Ask the planner once a hazard, after the reflex is ready and never before."""
        decider, planner = self._parts.decider, self._parts.planner
        if decider.pair is None and planner.is_pending:
            planner.cancel()
        if hazard is None or rollouts is None or not len(rollouts.best):
            return
        if self._asked == decider.snapshot:
            return
        self._asked = decider.snapshot
        deadline_s = decision.deadline_s
        if decision.action in ("intervene", "redirect") or not np.isfinite(deadline_s):
            deadline_s = decision.t_s + hazard.ttc_early_s
        planner.ask(
            PlanRequest(
                snapshot=decider.snapshot,
                t_s=decision.t_s,
                deadline_s=deadline_s,
                mode=self._parts.mode,
                summary=decision.summary,
                tracks=tracks,
                rollouts=rollouts,
            )
        )


def _are_alive(tracks: Tracks, pair: Tuple[int, int]) -> bool:
    """Say whether both ends of a pair are on the table, not lost, with a position."""
    alive = (tracks.status != int(TrackStatus.LOST)) & np.isfinite(tracks.pos_m).all(axis=1)
    present = set(int(i) for i in tracks.track_id[alive])
    return pair[0] in present and pair[1] in present


def run(
    agent: Agent,
    camera: Camera,
    on_step: Callable[[Step], None],
    is_over: Callable[[], bool],
    stall_s: float = 2.0,
    stale_s: float = STALE_S,
) -> None:
    """Run an agent on an open camera until the source ends or ``is_over`` says so.

    Parameters
    ----------
    on_step : gets every Step (recorder, narrator, page); must not block.
    stall_s : a camera that stays away for this long is a fault.
    stale_s : the arm holds when no frame has come for this long.

    Raises
    ------
    Whatever a stage or the camera raised, after the arm was stopped.
    """
    try:
        while not is_over():
            frame = _next_frame(agent, camera, stall_s, stale_s)
            if frame is None:
                return
            on_step(agent.step(frame))
    except Exception:
        log.error("stopping the arm: the loop failed")
        raise
    finally:
        agent.close()


def _next_frame(agent: Agent, camera: Camera, stall_s: float, stale_s: float) -> Optional[Frame]:
    """Read a frame; hold the arm while none comes, and give up after ``stall_s``."""
    n_tries = max(1, round(stall_s / stale_s))
    for n_left in reversed(range(n_tries)):
        try:
            return camera.read(stale_s)
        except CameraError as error:
            if n_left == 0:
                raise
            log.warning("no frame: holding the arm (%s)", error)
            agent.hold()
    return None
