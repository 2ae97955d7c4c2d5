"""``apex run``: the agent on a camera and an arm, real ones or the twin's."""

import argparse
import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Callable

from apex_edge import __version__
from apex_edge.act import Actuator
from apex_edge.agent import run as run_agent
from apex_edge.assemble import Kit, load_config, open_camera, twin_scene
from apex_edge.closed_loop import ScenePlayer
from apex_edge.errors import ArmError, ConfigError
from apex_edge.narrate import Narrator
from apex_edge.outputs import RunOutputs
from apex_edge.planners.build import build_planner
from apex_edge.rate import Pacer
from apex_edge.rig import TICK_S
from apex_edge.sink import Sink
from apex_edge.types import Step
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.link import SerialLink
from firmware_bridge.session import ArmSession, SessionState

HELP = "run the agent on a real camera and arm, or on a scene of the twin"
EXAMPLE = "apex run --config table.toml --seconds 60 --out out/table"
ARMING_S = 6.0
OnStep = Callable[[Step], None]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare settings, length and outputs."""
    parser.add_argument("--config", type=Path, required=True, help="settings file (TOML)")
    parser.add_argument("--seconds", type=float, help="stop after this long; default: Ctrl-C")
    parser.add_argument("--out", type=Path, help="folder for decisions, tracks, video, recording")
    parser.add_argument(
        "--fast", action="store_true", help="twin only: simulated time, as fast as possible"
    )


def run(args: argparse.Namespace) -> int:
    """Run until the time is up or Ctrl-C; the arm is left stopped and the files whole.

    Raises
    ------
    ConfigError, CameraError, ArmError, RecordingError : the arm was stopped first.
    """
    config = load_config(args.config)
    is_twin = config.camera.type == "twin"
    if args.fast and not is_twin:
        raise ConfigError(f"{args.config}: --fast needs camera.type = 'twin'")
    if is_twin and config.arm.port not in ("", "sim"):
        raise ConfigError(
            f"{args.config}: a twin's camera cannot see the arm on {config.arm.port}; "
            "use arm.port = 'sim'"
        )
    kit = Kit.from_config(config)
    narrator = Narrator(print)
    with ExitStack() as stack:
        write: OnStep = _ignore
        if args.out is not None:
            metadata = {"apex_edge": __version__, "camera": config.camera.type}
            outputs = stack.enter_context(RunOutputs(args.out, config.twin.fps, metadata))
            write = outputs.write if args.fast else stack.enter_context(Sink(outputs.write)).put

        def on_step(step: Step) -> None:
            narrator.see(step)
            write(step)

        if is_twin:
            scene = twin_scene(config.camera.path)
            outcome = ScenePlayer(kit, os.environ).play(scene, on_step, not args.fast)
            print(f"scene over: {'collision' if outcome.is_collision else 'no collision'}")
        else:
            _run_live(kit, on_step, args.seconds)
    return 0


def _run_live(kit: Kit, on_step: OnStep, seconds: float) -> None:
    """Run on a live camera; with an arm where the settings name a port, else watch only."""
    clock = time.monotonic
    config = kit.config
    planner = build_planner(config.planner, os.environ, clock, 0)
    with ExitStack() as stack:
        actuator = None
        if config.arm.port:
            session = stack.enter_context(ReadyArm(kit.arm, config.arm.port, clock)).session
            actuator = Actuator(session, kit.arm, kit.candidates)
            stack.enter_context(Pacer(session.tick, TICK_S))
        camera = stack.enter_context(open_camera(config, clock))
        end_s = clock() + seconds if seconds is not None else float("inf")
        agent = kit.agent(clock, planner, actuator)
        run_agent(agent, camera, on_step, lambda: clock() >= end_s, config.camera.timeout_s)


class ReadyArm:
    """Open an arm and bring it home; leave it stopped. A context manager.

    Raises
    ------
    ArmError : the port cannot be opened, or the arm does not get ready.
    """

    def __init__(self, arm: ArmModel, port: str, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.session = ArmSession(arm, SerialLink(port), clock)

    def __enter__(self) -> "ReadyArm":
        """Open, arm, and wait until the arm is home."""
        self.session.open()
        try:
            self._go_home()
        except BaseException:
            self.session.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the arm and let go of the port."""
        self.session.close()

    def _go_home(self) -> None:
        self.session.arm()
        give_up_s = self._clock() + ARMING_S
        while self.session.state is not SessionState.ARMED:
            time.sleep(TICK_S)
            self.session.tick()
            if self._clock() > give_up_s:
                raise ArmError(
                    f"the arm did not get ready in {ARMING_S} s: {self.session.state.value} "
                    f"{self.session.reason}"
                )


def _ignore(_: Step) -> None:
    """Keep nothing."""
