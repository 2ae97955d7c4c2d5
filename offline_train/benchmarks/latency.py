"""``apex bench latency``: from capture to the last servo byte, in real time on this machine.

Plays collision scenes of the twin by the wall clock, the arm driven by real bytes through a pty. A
frame is stamped before it is drawn, so drawing the twin's picture is part of the figure, as
exposure and transfer are of a real camera's; the stages of the agent are listed apart.
Source: ours; the paper gives 1.66 s from hazard to response with its language model.
"""

import argparse
import json
import os
import platform
from pathlib import Path
from typing import Any, Dict, List

import numpy as np

from apex_edge.assemble import Kit, load_config
from apex_edge.closed_loop import ScenePlayer
from apex_edge.errors import ConfigError
from apex_edge.record.whole import write_whole_text
from apex_edge.twin.scenarios import make
from apex_edge.types import Step
from apex_edge.verbs.progress import Progress

HELP = "capture to servo byte in real time, scene by scene"
EXAMPLE = "apex bench latency --scenes 12 --json latency.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare how many scenes are played."""
    parser.add_argument("--scenes", type=int, default=12, help="scenes of about 5 s each (12)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first scene (1)")
    parser.add_argument("--json", type=Path, help="file for the figures")


def run(args: argparse.Namespace) -> int:
    """Play the scenes and print medians and 95th percentiles; 1 when no command was sent.

    Raises
    ------
    ApexError : whatever stopped a scene.
    """
    if args.scenes < 1:
        raise ConfigError(f"--scenes must be 1 or more, found {args.scenes}")
    player = ScenePlayer(Kit.from_config(load_config(None)), os.environ)
    sent_s: List[float] = []
    stages_s: Dict[str, List[float]] = {}

    def on_step(step: Step) -> None:
        if step.rollouts is not None:
            for stage, took_s in step.timing_s.items():
                stages_s.setdefault(stage, []).append(took_s)

    with Progress("scenes", args.scenes) as progress:
        for seed in range(args.seed, args.seed + args.scenes):
            outcome = player.play(make("collision", seed), on_step, is_real_time=True)
            if outcome.is_intervention:
                sent_s.append(outcome.frame_to_command_s)
            progress.advance()
    if not sent_s:
        print("no command was sent")
        return 1
    figures = _figures(sent_s, stages_s, 1.0 / player.fps)
    if args.json is not None:
        write_whole_text(args.json, json.dumps(figures, indent=1, sort_keys=True) + "\n")
    _print(figures)
    return 0


def _figures(
    sent_s: List[float], stages_s: Dict[str, List[float]], period_s: float
) -> Dict[str, Any]:
    return {
        "format": "apex-edge-latency",
        "format_version": 1,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "n_commands": len(sent_s),
        "frame_period_ms": 1000.0 * period_s,
        "frame_to_command_ms": _spread_ms(sent_s),
        "stages_ms": {stage: _spread_ms(took) for stage, took in stages_s.items()},
    }


def _spread_ms(values_s: List[float]) -> Dict[str, float]:
    median, p95 = (1000.0 * float(v) for v in np.percentile(values_s, [50, 95]))
    return {"median": round(median, 3), "p95": round(p95, 3)}


def _print(figures: Dict[str, Any]) -> None:
    total = figures["frame_to_command_ms"]
    print(
        f"capture to command sent: median {total['median']:.1f} ms, 95 % {total['p95']:.1f} ms "
        f"over {figures['n_commands']} first commands; a frame lasts "
        f"{figures['frame_period_ms']:.1f} ms"
    )
    for stage, spread in figures["stages_ms"].items():
        print(f"  {stage:10s} median {spread['median']:6.2f} ms, 95 % {spread['p95']:6.2f} ms")
