"""The loop around the agent: it holds when blind, and stops the arm whatever fails."""

from typing import List, Optional

import pytest

from apex_edge.act import Actuator
from apex_edge.agent import run
from apex_edge.assemble import ApexConfig, Kit
from apex_edge.cameras.base import Camera
from apex_edge.cameras.twin import TwinCamera, TwinConfig
from apex_edge.errors import CameraError
from apex_edge.planners.base import PlannerConfig
from apex_edge.planners.none import NoPlanner
from apex_edge.rig import SimulatedArm
from apex_edge.twin.scenarios import make
from apex_edge.twin.world import TwinWorld
from apex_edge.types import Frame, Step
from firmware_bridge.session import SessionState


class StallingCamera(Camera):
    """Deliver frames of a scene, then nothing for a while, then frames again."""

    type = "stalling"

    def __init__(self, inner: TwinCamera, stall_at_s: float, n_stalls: int) -> None:
        super().__init__()
        self.inner = inner
        self._stall_at_s = stall_at_s
        self._n_stalls = n_stalls

    def open(self) -> None:
        self.inner.open()

    def read(self, timeout_s: float) -> Optional[Frame]:
        if self.inner.now_s() > self._stall_at_s and self._n_stalls > 0:
            self._n_stalls -= 1
            raise CameraError("no frame")
        return self.inner.read(timeout_s)

    def close(self) -> None:
        self.inner.close()


class Rig:
    """An agent on the twin with a simulated arm, in simulated time."""

    def __init__(self, n_stalls: int, stall_at_s: float = 1.5) -> None:
        self.kit = Kit.from_config(ApexConfig())
        self.world = TwinWorld(make("collision", 1))
        inner = TwinCamera(TwinConfig(), self.world, self._on_world)
        self.camera = StallingCamera(inner, stall_at_s, n_stalls)
        self.arm = SimulatedArm(self.kit.arm, inner.now_s)
        self.states: List[SessionState] = []
        self.steps: List[Step] = []

    def _on_world(self, world: TwinWorld, dt_s: float) -> None:
        world.set_arm(self.arm.drive(dt_s))

    def on_step(self, step: Step) -> None:
        self.steps.append(step)
        self.states.append(self.arm.session.state)

    def run(self, until_s: float) -> None:
        with self.arm as arm, self.camera as camera:
            actuator = Actuator(arm.session, self.kit.arm, self.kit.candidates)
            now_s = self.camera.inner.now_s
            planner = NoPlanner(PlannerConfig(), {}, now_s, 0)
            agent = self.kit.agent(now_s, planner, actuator)
            try:
                run(agent, camera, self.on_step, lambda: self.world.t_s > until_s)
            finally:
                self.states.append(arm.session.state)


def test_a_blind_arm_holds_and_acts_anew_when_it_sees_again() -> None:
    rig = Rig(n_stalls=2)
    rig.run(until_s=4.8)
    moves = [s.frame.t_s for s in rig.steps if s.decision.action == "intervene"]
    assert len(moves) == 2
    assert moves[0] < 1.5 < moves[1]
    # the stall comes after the first frame beyond 1.5 s; the next one finds the arm holding
    last_seen = next(i for i, s in enumerate(rig.steps) if s.frame.t_s > 1.5)
    arms = [step.arm for step in rig.steps[last_seen : last_seen + 2]]
    assert [arm is not None and arm.is_moving for arm in arms] == [True, False]
    assert frozenset(("green ball", "red block")) not in rig.world.contacts


def test_a_camera_that_stays_away_is_a_fault_and_leaves_the_arm_stopped() -> None:
    rig = Rig(n_stalls=1000)
    with pytest.raises(CameraError):
        rig.run(until_s=4.8)
    assert SessionState.MOVING in rig.states
    assert rig.states[-1] is SessionState.ARMED


def test_a_stage_that_fails_leaves_the_arm_stopped() -> None:
    rig = Rig(n_stalls=0)

    see = rig.on_step

    def broken(step: Step) -> None:
        see(step)
        if rig.arm.session.state is SessionState.MOVING:
            raise ZeroDivisionError("a bug in a consumer")

    rig.on_step = broken  # type: ignore[method-assign]
    with pytest.raises(ZeroDivisionError):
        rig.run(until_s=4.8)
    assert rig.states[-1] is SessionState.ARMED
