"""Build an agent from settings: the one place that knows every stage by name."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Callable, Optional, Tuple, Union

from apex_edge import config as settings
from apex_edge import plugins
from apex_edge.act import ActConfig, Actuator
from apex_edge.agent import Agent, AgentConfig, Parts
from apex_edge.cameras.base import Camera, CameraConfig
from apex_edge.cameras.twin import TwinCamera, TwinConfig
from apex_edge.config import setting
from apex_edge.decide import DecideConfig, Decider
from apex_edge.errors import ConfigError
from apex_edge.perception import ColourTable, Perception, PerceptionConfig
from apex_edge.planners.base import Planner, PlannerConfig
from apex_edge.simulate.base import PhysicsSim, SimulateConfig
from apex_edge.simulate.candidates import candidate_grid
from apex_edge.triggers.base import Trigger, TriggerConfig
from apex_edge.twin.scenarios import make
from apex_edge.twin.scene import Scenario
from apex_edge.twin.world import TwinWorld
from apex_edge.types import Candidates
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.ready import ArmConfig
from firmware_bridge.session import ArmSession


@dataclass(frozen=True)
class ColoursConfig:
    """Section ``[colours]``: what the objects look like."""

    files: Tuple[str, ...] = setting((), "files of `apex calibrate colour`; none: the twin's")


@dataclass(frozen=True)
class ApexConfig:
    """The whole settings file, a section each."""

    agent: AgentConfig = field(default_factory=AgentConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    twin: TwinConfig = field(default_factory=TwinConfig)
    colours: ColoursConfig = field(default_factory=ColoursConfig)
    perception: PerceptionConfig = field(default_factory=PerceptionConfig)
    trigger: TriggerConfig = field(default_factory=TriggerConfig)
    simulate: SimulateConfig = field(default_factory=SimulateConfig)
    planner: PlannerConfig = field(default_factory=PlannerConfig)
    decide: DecideConfig = field(default_factory=DecideConfig)
    act: ActConfig = field(default_factory=ActConfig)
    arm: ArmConfig = field(default_factory=ArmConfig)


def load_config(path: Union[str, Path, None]) -> ApexConfig:
    """Read a settings file; None gives all defaults.

    Raises
    ------
    ConfigError : unreadable file, unknown section or key, wrong type, value out of range.
    """
    if path is None:
        return ApexConfig()
    return settings.structure(ApexConfig, settings.read_toml(path), str(path))


def with_mode(config: ApexConfig, mode: str) -> ApexConfig:
    """Return the same settings with another decision mode."""
    return replace(config, decide=replace(config.decide, mode=mode))


def load_colours(config: ColoursConfig) -> ColourTable:
    """Load the colour files, or the twin's colours when none is named."""
    if not config.files:
        return ColourTable.builtin()
    return ColourTable.load(*config.files)


def twin_scene(path: str) -> Scenario:
    """Make the scene that ``KIND:SEED`` names; an empty text is ``collision:1``.

    Raises
    ------
    ConfigError : not of that form. InputError : no such kind.
    """
    kind, _, seed = (path or "collision:1").partition(":")
    if not seed.isdecimal():
        raise ConfigError(f"camera.path = {path!r}: a twin's scene is KIND:SEED, as collision:1")
    return make(kind, int(seed))


def open_camera(config: ApexConfig, clock: Callable[[], float]) -> Camera:
    """Make the camera that the settings name; a twin's runs in real time, with no arm in sight."""
    if config.camera.type == "twin":
        return TwinCamera(config.twin, TwinWorld(twin_scene(config.camera.path)), clock=clock)
    camera: Camera = plugins.load("cameras", config.camera.type)(config.camera)
    return camera


@dataclass(frozen=True)
class Kit:
    """What every run of one settings file shares: arm data, candidates, colours."""

    config: ApexConfig
    arm: ArmModel
    candidates: Candidates
    colours: ColourTable

    @classmethod
    def from_config(cls, config: ApexConfig) -> "Kit":
        """Load arm data and colours and lay the grid of candidates."""
        arm = ArmModel.load(config.arm.type)
        laid = config.simulate
        grid = candidate_grid(arm, laid.n_candidates, config=laid.candidates)
        return cls(config, arm, grid, load_colours(config.colours))

    def actuator(self, session: ArmSession) -> Actuator:
        """Put the arm's last stage on a session."""
        return Actuator(session, self.arm, self.candidates, self.config.act)

    def agent(
        self,
        clock: Callable[[], float],
        planner: Planner,
        actuator: Optional[Actuator] = None,
    ) -> Agent:
        """Wire a fresh agent; it shares nothing that changes with another one."""
        config = self.config
        trigger: Trigger = plugins.load("triggers", config.trigger.type)(config.trigger)
        simulator: PhysicsSim = plugins.load("simulators", config.simulate.type)()
        parts = Parts(
            perception=Perception(config.perception, self.colours),
            trigger=trigger,
            simulator=simulator,
            simulate=config.simulate,
            decider=Decider(config.decide),
            planner=planner,
            candidates=self.candidates,
            tip_radius_m=self.arm.tip_radius_m,
            mode=config.decide.mode,
            actuator=actuator,
        )
        return Agent(config.agent, parts, clock)
