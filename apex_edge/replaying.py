"""Run the agent over a recording: hardware in the loop with recorded frames and simulated servos.

The recording's capture times are the only clock, so the same recording, settings and seed give
the same decisions byte for byte.
"""

from typing import Callable, Dict, Optional

from apex_edge.agent import run
from apex_edge.assemble import Kit
from apex_edge.cameras.base import Camera
from apex_edge.cameras.mcap import McapCamera
from apex_edge.planners.base import Planner, PlanRequest
from apex_edge.rig import SimulatedArm
from apex_edge.types import Frame, Proposal, Step

STEP_S = 0.005
# A jump in the stamps longer than this is a cut, not time in which an arm could move.
MAX_GAP_S = 1.0


class RecordedPlanner(Planner):
    """Answer what was answered when the recording was made, with the same frame.

    Parameters
    ----------
    camera : the recording that is played; None or one without answers gives none.
    """

    def __init__(self, camera: Optional[McapCamera]) -> None:
        self._camera = camera
        self._told_seq = -1

    def ask(self, request: PlanRequest) -> None:
        """Ask nobody: the answer, if there was one, is in the recording."""

    def poll(self, now_s: float) -> Optional[Proposal]:
        """Return the proposal recorded beside the newest frame, once."""
        recorded = self._camera.recorded if self._camera is not None else None
        if recorded is None or recorded.frame.seq == self._told_seq:
            return None
        self._told_seq = recorded.frame.seq
        return recorded.proposal

    def wait(self, timeout_s: float) -> Optional[Proposal]:
        """Return at once: there is nothing to wait for."""
        return None

    def cancel(self) -> None:
        """Have nothing in flight."""

    def close(self) -> None:
        """Hold nothing open."""

    @property
    def is_pending(self) -> bool:
        """Say that nothing is in flight."""
        return False


class FrameClock(Camera):
    """Let time follow the frames of another camera, and a simulated arm follow the time.

    Parameters
    ----------
    camera : the source whose capture times are the clock.
    """

    type = "frame-clock"

    def __init__(self, camera: Camera) -> None:
        super().__init__()
        self._camera = camera
        self._stats = camera.stats
        self.t_s = 0.0
        self.drive: Callable[[float], object] = lambda _: None

    def open(self) -> None:
        """Open the source."""
        self._camera.open()

    def read(self, timeout_s: float) -> Optional[Frame]:
        """Return the next frame after letting its time come."""
        frame = self._camera.read(timeout_s)
        if frame is None:
            return None
        if not 0.0 <= frame.t_s - self.t_s <= MAX_GAP_S:
            self.t_s = frame.t_s
        while self.t_s < frame.t_s - 1e-9:
            dt_s = min(STEP_S, frame.t_s - self.t_s)
            self.t_s += dt_s
            self.drive(dt_s)
        return frame

    def close(self) -> None:
        """Close the source."""
        self._camera.close()

    def now_s(self) -> float:
        """Return the capture time of the newest frame."""
        return self.t_s


def replay(kit: Kit, camera: Camera, on_step: Callable[[Step], None]) -> Dict[str, float]:
    """Play a source to its end; return how much of its tolerance each colour used at the end.

    Parameters
    ----------
    kit : settings, arm, candidates, colours.
    camera : not yet opened.
    on_step : gets every step.

    Raises
    ------
    RecordingError, CalibrationError : the source cannot be used.
    """
    clock = FrameClock(camera)
    planner = RecordedPlanner(camera if isinstance(camera, McapCamera) else None)
    with clock, SimulatedArm(kit.arm, clock.now_s) as rig:
        clock.drive = rig.drive
        agent = kit.agent(clock.now_s, planner, kit.actuator(rig.session))
        run(agent, clock, on_step, lambda: False)
    return agent.colour_use
