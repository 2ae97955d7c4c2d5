"""``apex run``: the agent on a camera and an arm, real ones or the twin's."""

import argparse
import os
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Callable

from apex_edge import __version__, plugins
from apex_edge.agent import STALE_S
from apex_edge.agent import run as run_agent
from apex_edge.assemble import ApexConfig, Kit, load_config, open_camera, twin_scene
from apex_edge.closed_loop import ScenePlayer
from apex_edge.errors import CalibrationError, ConfigError
from apex_edge.narrate import Narrator, planner_line
from apex_edge.outputs import RunOutputs
from apex_edge.planners.build import build_planner
from apex_edge.rate import Pacer
from apex_edge.sink import Sink
from apex_edge.types import Step
from firmware_bridge.ready import ReadyArm

HELP = "run the agent on a real camera and arm, or on a scene of the twin"
EXAMPLE = "apex run --config table.toml --seconds 60 --out out/table"
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
    if config.arm.port and not is_twin:
        _check_real_arm(config, args.config)
    if is_twin and args.seconds is not None:
        raise ConfigError("--seconds: a twin's scene has its own length; leave it out")
    kit = Kit.from_config(config)
    unknown = set(config.agent.protected) - set(kit.colours.names)
    if unknown:
        raise ConfigError(
            f"{args.config} [agent]: protected {sorted(unknown)[0]!r} is no known colour; "
            f"known: {', '.join(kit.colours.names)}"
        )
    print(planner_line(config.planner, os.environ))
    narrator = Narrator(print)
    outputs = None
    with ExitStack() as stack:
        write: OnStep = _ignore
        if args.out is not None:
            metadata = {"apex_edge": __version__, "camera": config.camera.type}
            outputs = stack.enter_context(RunOutputs(args.out, _fps(config), metadata, ".webm"))
            write = outputs.write

        def told(step: Step) -> None:
            narrator.see(step)
            write(step)

        # neither the disk nor the terminal may hold up the loop
        on_step = told if args.fast else stack.enter_context(Sink(told)).put
        if is_twin:
            scene = twin_scene(config.camera.path)
            outcome = ScenePlayer(kit, os.environ).play(scene, on_step, not args.fast)
            print(f"scene over: {'collision' if outcome.is_collision else 'no collision'}")
        else:
            _run_live(kit, on_step, args.seconds)
    if outputs is not None:
        outputs.report(f"Run with {args.config.name}")
    return 0


def _check_real_arm(config: ApexConfig, path: Path) -> None:
    """Refuse settings with which a real arm would move for what is not there, or never move.

    Raises
    ------
    ConfigError : a recorded source, no colours of one's own, or the twin's board.
    """
    if not getattr(plugins.load("cameras", config.camera.type), "is_live", False):
        raise ConfigError(
            f"{path}: a real arm moves only for a live camera, found camera.type = "
            f"{config.camera.type!r}; use apex replay, or leave arm.port out"
        )
    if config.arm.port == "sim":
        raise ConfigError(f"{path}: arm.port = 'sim' goes with camera.type = 'twin'")
    if not config.colours.files:
        raise ConfigError(
            f"{path} [colours]: name the files of your own colours; the twin's do not fit a table"
        )


def _run_live(kit: Kit, on_step: OnStep, seconds: float) -> None:
    """Run on a live camera; with an arm where the settings name a port, else watch only."""
    clock = time.monotonic
    config = kit.config
    planner = build_planner(config.planner, os.environ, clock, 0)
    with ExitStack() as stack:
        # nothing moves before the camera has shown a picture
        camera = stack.enter_context(open_camera(config, clock))
        first = camera.read(config.camera.timeout_s)
        actuator = None
        if config.arm.port:
            if first is not None and first.camera is None:
                raise CalibrationError(
                    f"camera {config.camera.path!r} has no calibration, so no hazard can be seen; "
                    "set camera.calibration, or leave arm.port out to watch only"
                )
            session = stack.enter_context(ReadyArm(kit.arm, config.arm.port, clock)).session
            actuator = kit.actuator(session)
            stack.enter_context(Pacer(session.tick, session.rhythm.tick_s))
        end_s = clock() + seconds if seconds is not None else float("inf")
        agent = kit.agent(clock, planner, actuator)
        stale_s = max(STALE_S, 3.0 / config.camera.fps)
        patience_s = config.camera.timeout_s
        run_agent(agent, camera, on_step, lambda: clock() >= end_s, patience_s, stale_s)


def _fps(config: ApexConfig) -> float:
    return config.twin.fps if config.camera.type == "twin" else config.camera.fps


def _ignore(_: Step) -> None:
    """Keep nothing."""
