"""The loop around the agent: it holds when blind, and stops the arm whatever fails."""

from typing import List, Optional, Tuple

import numpy as np
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
from apex_edge.types import Frame, HazardScores, Step, Tracks
from firmware_bridge.errors import LinkLost
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

    def __init__(self, n_stalls: int, stall_at_s: float = 2.2) -> None:
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
    assert moves[0] < 2.2 < moves[1]
    # the stall comes after the first frame delivered beyond 2.2 s; the next finds the arm holding
    delay_s = TwinConfig().delay_s
    last_seen = next(i for i, s in enumerate(rig.steps) if s.frame.t_s + delay_s > 2.2)
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


def test_a_lost_link_ends_the_run() -> None:
    rig = Rig(n_stalls=0)
    see = rig.on_step

    def unplugging(step: Step) -> None:
        see(step)
        if step.decision.action == "intervene":
            rig.arm.unplug()

    rig.on_step = unplugging  # type: ignore[method-assign]
    with pytest.raises(LinkLost):
        rig.run(until_s=4.8)
    assert rig.states[-1] is SessionState.FAULT
    assert rig.steps[-1].frame.t_s < 3.0


@pytest.mark.parametrize("names", [("red", "green"), ("green", "red")])
def test_a_protected_object_is_guarded_whichever_of_the_two_is_faster(
    names: Tuple[str, str],
) -> None:
    kit = Kit.from_config(ApexConfig())
    agent = kit.agent(lambda: 0.0, NoPlanner(PlannerConfig(), {}, lambda: 0.0, 0))
    scores, tracks = head_on(names)
    alarm = agent._most_urgent(scores, tracks)
    assert alarm is not None
    assert tracks.name[list(tracks.track_id).index(alarm.target_id)] == "red"


def head_on(names: Tuple[str, str]) -> Tuple[HazardScores, Tracks]:
    """Two objects that run into each other, the first the faster."""
    nothing = np.zeros(2)
    tracks = Tracks(
        seq=0,
        t_s=0.0,
        name=names,
        track_id=np.array([1, 2]),
        pos_m=np.array([[0.1, 0.1, 0.0], [0.1, -0.1, 0.0]]),
        vel_m_s=np.array([[0.0, -0.10, 0.0], [0.0, 0.08, 0.0]]),
        acc_m_s2=np.zeros((2, 3)),
        cov=np.zeros((2, 6, 6)),
        radius_m=nothing + 0.015,
        n_samples=np.array([20, 20]),
        status=np.array([0, 0]),
        age_s=nothing,
        centre_px=np.zeros((2, 2)),
        area_px2=nothing,
        is_manoeuvre=np.array([False, False]),
        is_blurred=np.array([False, False]),
        smooth_m=np.zeros((2, 3)),
        seen_m=np.zeros((2, 3)),
        seen_sd_m=np.full(2, 0.001),
    )
    one = np.array([1.0])
    scores = HazardScores(
        seq=0,
        t_s=0.0,
        mover_id=np.array([1]),
        target_id=np.array([2]),
        probability=one,
        dca_m=one,
        tca_s=one,
        ttc_s=one,
        ttc_early_s=one,
        sigma_m=one,
        is_fired=np.array([True]),
        is_fallback=np.array([False]),
    )
    return scores, tracks
