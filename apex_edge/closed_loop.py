"""Run one scene of the twin to its end, the arm driven by real bytes; in simulated or real time."""

import math
import time
from dataclasses import dataclass
from typing import Callable, Mapping, Optional

import numpy as np

from apex_edge.agent import run
from apex_edge.assemble import ApexConfig, Kit, with_mode
from apex_edge.cameras.base import CameraStats
from apex_edge.cameras.twin import TwinCamera
from apex_edge.planners.base import Planner, PlannerConfig, PlanRequest
from apex_edge.planners.build import build_planner
from apex_edge.rate import Pacer
from apex_edge.rig import TICK_S, SimulatedArm
from apex_edge.twin.scene import Scenario
from apex_edge.twin.truth import FreeRun, free_run
from apex_edge.twin.world import TwinWorld
from apex_edge.types import Array, Proposal, Step

ARRIVED_M = 0.003
SETTLE_S = 0.5
MIN_SCENE_S = 4.0
# The paper's runs count as fair when the mover can be seen to move for this long.
ELIGIBLE_S = 1.5

OnStep = Callable[[Step], None]


@dataclass
class SceneTimes:
    """When things first happened, s on the scene's clock (NaN: never).

    ``trigger_s`` is the capture time of the frame that fired; the others are when it was done.
    """

    trigger_s: float = math.nan
    reflex_s: float = math.nan
    command_s: float = math.nan
    arrived_s: float = math.nan


@dataclass(frozen=True)
class SceneOutcome:
    """How one scene went.

    ``is_collision`` the mover touched the protected object; ``is_target_touched`` the arm did;
    ``free`` what would have happened with no arm; ``n_moves`` interventions and redirections;
    ``source`` of the first one.
    ``frame_to_command_s`` from capture to the last servo byte of the first command.
    """

    kind: str
    seed: int
    mode: str
    free: FreeRun
    is_collision: bool
    is_target_touched: bool
    is_intervention: bool
    n_moves: int
    source: str
    times: SceneTimes
    frame_to_command_s: float
    duration_s: float
    camera: CameraStats

    @property
    def would_collide(self) -> bool:
        """Say whether the mover touches the protected object when left alone."""
        return math.isfinite(self.free.t_contact_s)

    @property
    def is_eligible(self) -> bool:
        """Say whether the mover was visibly in motion for long enough before the contact."""
        return self.would_collide and self.free.visible_s >= ELIGIBLE_S

    @property
    def is_false_intervention(self) -> bool:
        """Say whether the arm moved although nothing would have happened."""
        return self.is_intervention and not self.would_collide


class SceneWatch:
    """Note when a scene's events happen; looks on, changes nothing."""

    def __init__(self) -> None:
        self.times = SceneTimes()
        self.n_moves = 0
        self.source = "none"
        self.frame_to_command_s = math.nan
        self._target_m: Optional[Array] = None

    def see_step(self, step: Step, now_s: float) -> None:
        """Note what the agent did by ``now_s`` on the scene's clock."""
        times = self.times
        if step.hazards is not None and step.hazards.is_fired.any() and math.isnan(times.trigger_s):
            times.trigger_s = step.frame.t_s
        has_reflex = step.rollouts is not None and len(step.rollouts.best) > 0
        if has_reflex and math.isnan(times.reflex_s):
            times.reflex_s = now_s if step.ack is None else min(now_s, step.ack.t_sent_s)
        if step.ack is None or not step.ack.is_accepted:
            return
        if step.decision.action in ("intervene", "redirect"):
            self._see_move(step)

    def _see_move(self, step: Step) -> None:
        assert step.ack is not None
        self.n_moves += 1
        self._target_m = np.asarray(step.decision.target_m)
        if self.n_moves == 1:
            self.source = step.decision.source
            self.times.command_s = step.ack.t_sent_s
            self.frame_to_command_s = step.ack.t_sent_s - step.frame.t_s

    def see_tip(self, t_s: float, tip_m: Array) -> None:
        """Note when the true tip first stands where it was sent."""
        target = self._target_m
        if target is None or not math.isnan(self.times.arrived_s):
            return
        if float(np.linalg.norm(tip_m - target)) <= ARRIVED_M:
            self.times.arrived_s = t_s


class ChargedPlanner(Planner):
    """Wait for an answer in wall time and charge that time to a clock that stood still.

    Used when a scene runs as fast as possible: the answer becomes visible only once the scene's
    clock has moved on by as much as the endpoint took.
    """

    def __init__(self, inner: Planner, clock: Callable[[], float]) -> None:
        self._inner = inner
        self._clock = clock
        self._answer: Optional[Proposal] = None
        self._due_s = math.inf

    def ask(self, request: PlanRequest) -> None:
        """Ask, wait until the deadline at most, and hold the answer back."""
        self._inner.ask(request)
        started_s = time.monotonic()
        self._answer = self._inner.wait(max(0.0, request.deadline_s - self._clock()))
        self._due_s = self._clock() + time.monotonic() - started_s

    def poll(self, now_s: float) -> Optional[Proposal]:
        """Return the answer once its time has come."""
        if self._answer is None or now_s < self._due_s:
            return None
        answer, self._answer = self._answer, None
        return answer

    def wait(self, timeout_s: float) -> Optional[Proposal]:
        """Return the answer at once."""
        return self.poll(math.inf)

    def cancel(self) -> None:
        """Forget the answer."""
        self._answer = None
        self._inner.cancel()

    def close(self) -> None:
        """Close the planner behind."""
        self._inner.close()

    @property
    def is_pending(self) -> bool:
        """Say whether an answer waits for its time."""
        return self._answer is not None


class ScenePlayer:
    """Play scenes of the twin closed-loop with one kit.

    Parameters
    ----------
    kit : settings, arm, candidates, colours.
    env : where APEX_LLM_* is looked up.
    """

    def __init__(self, kit: Kit, env: Mapping[str, str]) -> None:
        self._kit = kit
        self._env = env

    @property
    def fps(self) -> float:
        """Return the frame rate of the twin's camera, Hz."""
        return self._kit.config.twin.fps

    def play(self, scenario: Scenario, on_step: OnStep, is_real_time: bool) -> SceneOutcome:
        """Play one scene and judge it against what would have happened with no arm.

        Raises
        ------
        ApexError : whatever a stage raised; the arm was stopped.
        """
        watch = SceneWatch()
        world = TwinWorld(scenario)
        if is_real_time:
            camera = self._play_live(world, watch, on_step)
        else:
            camera = self._play_fast(world, watch, on_step)
        return self._outcome(world, camera, watch)

    def _kit_for(self, scenario: Scenario) -> Kit:
        config: ApexConfig = with_mode(self._kit.config, scenario.mode)
        return Kit(config, self._kit.arm, self._kit.candidates, self._kit.colours)

    def _planner(self, clock: Callable[[], float], seed: int) -> Planner:
        config: PlannerConfig = self._kit.config.planner
        return build_planner(config, self._env, clock, seed)

    def _play_fast(self, world: TwinWorld, watch: SceneWatch, on_step: OnStep) -> TwinCamera:
        """Step the world from capture to capture; nothing depends on the wall clock."""

        def on_world(_: TwinWorld, dt_s: float) -> None:
            points_m = rig.drive(dt_s)
            world.set_arm(points_m)
            watch.see_tip(world.t_s, points_m[-1])

        kit = self._kit_for(world.scenario)
        camera = TwinCamera(kit.config.twin, world, on_world)
        inner = self._planner(camera.now_s, world.scenario.seed)
        with SimulatedArm(kit.arm, camera.now_s) as rig:
            planner = ChargedPlanner(inner, camera.now_s)
            self._watch_over(kit, rig, camera, watch, planner, on_step)
        return camera

    def _play_live(self, world: TwinWorld, watch: SceneWatch, on_step: OnStep) -> TwinCamera:
        """Let the world run by the wall clock in threads of its own."""

        def on_world(_: TwinWorld, dt_s: float) -> None:
            points_m = rig.advance(dt_s)
            world.set_arm(points_m)
            watch.see_tip(world.t_s, points_m[-1])

        kit = self._kit_for(world.scenario)
        camera = TwinCamera(kit.config.twin, world, on_world, time.monotonic)
        planner = self._planner(camera.now_s, world.scenario.seed)
        with SimulatedArm(kit.arm, camera.now_s) as rig, Pacer(rig.session.tick, TICK_S):
            self._watch_over(kit, rig, camera, watch, planner, on_step)
        return camera

    def _watch_over(
        self,
        kit: Kit,
        rig: SimulatedArm,
        camera: TwinCamera,
        watch: SceneWatch,
        planner: Planner,
        on_step: OnStep,
    ) -> None:
        """Run the agent on a camera until the scene is over."""

        def seen(step: Step) -> None:
            watch.see_step(step, camera.now_s())
            on_step(step)

        camera.world.set_arm(rig.points_m())
        agent = kit.agent(camera.now_s, planner, kit.actuator(rig.session))
        with camera:
            run(agent, camera, seen, self._is_over(camera.world))

    def _is_over(self, world: TwinWorld) -> Callable[[], bool]:
        """Return a test for the end: the time is up, or all has been at rest for a while."""
        moved_s = [0.0]

        def is_over() -> bool:
            if not world.is_at_rest:
                moved_s[0] = world.t_s
            is_quiet = world.t_s > max(MIN_SCENE_S, moved_s[0] + SETTLE_S)
            return is_quiet or world.t_s >= world.scenario.duration_s

        return is_over

    def _outcome(self, world: TwinWorld, camera: TwinCamera, watch: SceneWatch) -> SceneOutcome:
        scenario = world.scenario
        pair = frozenset((scenario.mover, scenario.target))
        return SceneOutcome(
            kind=scenario.kind,
            seed=scenario.seed,
            mode=scenario.mode,
            free=free_run(scenario),
            is_collision=pair in world.contacts,
            is_target_touched=scenario.target in world.arm_contacts,
            is_intervention=watch.n_moves > 0,
            n_moves=watch.n_moves,
            source=watch.source,
            times=watch.times,
            frame_to_command_s=watch.frame_to_command_s,
            duration_s=world.t_s,
            camera=camera.stats,
        )
