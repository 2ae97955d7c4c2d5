"""``apex demo``: the whole loop on a simulated table; no hardware, no key, no network."""

import argparse
import json
import os
import platform
from dataclasses import asdict
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence

import cv2
import numpy as np

from apex_edge import __version__
from apex_edge.assemble import Kit, load_config
from apex_edge.closed_loop import SceneOutcome, ScenePlayer
from apex_edge.errors import ConfigError
from apex_edge.fast_demo import as_json, count, play_all, tasks
from apex_edge.narrate import Narrator, planner_line
from apex_edge.outputs import RunOutputs
from apex_edge.record.report import write_report
from apex_edge.record.summary import RunSummary, SceneNotes, SceneResult
from apex_edge.record.whole import write_whole_text
from apex_edge.sink import Sink
from apex_edge.twin.scenarios import KINDS, make
from apex_edge.types import Step
from apex_edge.verbs.progress import Progress

HELP = "a collision, a quiet and an implicit scene; no hardware needed"
EXAMPLE = "apex demo --fast --scenarios 50 --seed 1 --json demo.json"
SHOWN_KINDS = ("collision", "no-moving", "implicit")
WHAT_COMES = {
    "collision": "something green heads for the red block",
    "no-moving": "nothing moves, and nothing should be done",
    "implicit": "a green car nears a child in a red T-shirt; nobody says that this is a hazard",
    "near-miss": "something passes close by the red block",
    "late-start": "something at rest starts so late that the arm may not get there",
    "many": "many objects, several of them moving",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is shown and how fast."""
    parser.add_argument("--out", type=Path, default=Path("out/demo"), help="folder (out/demo)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the scenes (1)")
    parser.add_argument("--config", type=Path, help="settings file (TOML)")
    parser.add_argument("--fast", action="store_true", help="simulated time, no pictures, counts")
    parser.add_argument("--scenarios", type=int, help="--fast: scenes of each kind (10)")
    parser.add_argument("--kinds", help=f"--fast: kinds of scenes ({','.join(KINDS)})")
    parser.add_argument("--jobs", type=int, help="--fast: processes (one per core)")
    parser.add_argument("--json", type=Path, help="--fast: file for counts and scenes")


def run(args: argparse.Namespace) -> int:
    """Show three scenes in real time, or count many as fast as possible.

    Raises
    ------
    ApexError : whatever stopped a scene; the arm was stopped first.
    """
    if args.fast:
        return _run_fast(args)
    given = [
        name for name in ("scenarios", "kinds", "jobs", "json") if getattr(args, name) is not None
    ]
    if given:
        raise ConfigError(f"--{given[0]} goes with --fast")
    return _run_shown(args)


def _run_fast(args: argparse.Namespace) -> int:
    kinds = [kind.strip() for kind in (args.kinds or ",".join(KINDS)).split(",")]
    n_scenes = 10 if args.scenarios is None else args.scenarios
    unknown = [kind for kind in kinds if kind not in KINDS]
    if unknown:
        raise ConfigError(f"--kinds: {unknown[0]!r} is not one of {', '.join(KINDS)}")
    n_jobs = (os.cpu_count() or 1) if args.jobs is None else args.jobs
    if n_scenes < 1 or args.seed < 0 or n_jobs < 1:
        raise ConfigError("--scenarios and --jobs must be 1 or more and --seed 0 or more")
    config = load_config(args.config)
    print(planner_line(config.planner, os.environ))
    todo = tasks(kinds, n_scenes, args.seed)
    with Progress("scenes", len(todo)) as progress:
        outcomes = play_all(config, todo, n_jobs, lambda _: progress.advance())
    if args.json is not None:
        text = json.dumps(as_json(outcomes, args.seed), indent=1, sort_keys=True)
        write_whole_text(args.json, text + "\n")
    for kind in kinds:
        _print_counts(kind, [o for o in outcomes if o.kind == kind])
    return 0


def _print_counts(kind: str, outcomes: Sequence[SceneOutcome]) -> None:
    counts = count(outcomes)
    line = (
        f"{kind:10s} {counts.n_scenes} scenes, {counts.n_interventions} interventions, "
        f"{counts.n_collisions} collisions, {counts.n_false_interventions} false interventions, "
        f"{counts.n_target_touched} protected objects touched by the arm"
    )
    if counts.n_would_collide:
        n_late = counts.n_would_collide - counts.n_eligible
        n_late_prevented = counts.n_prevented - counts.n_prevented_eligible
        line += (
            f"; prevented {counts.n_prevented_eligible} of {counts.n_eligible} with the mover "
            f"visible for 1.5 s, {n_late_prevented} of {n_late} later ones"
        )
    print(line)


def _run_shown(args: argparse.Namespace) -> int:
    kit = Kit.from_config(load_config(args.config))
    print(planner_line(kit.config.planner, os.environ))
    results = []
    for number, kind in enumerate(SHOWN_KINDS, 1):
        print(f"\nscene {number} of {len(SHOWN_KINDS)}, {kind}: {WHAT_COMES[kind]}", flush=True)
        results.append(_show_scene(kit, kind, args.seed, args.out))
    summary = RunSummary(
        title="APEX Edge demo",
        scenes=tuple(results),
        command=f"apex demo --seed {args.seed}",
        about={
            "apex-edge": __version__,
            "Python": platform.python_version(),
            "numpy": np.__version__,
            "OpenCV": cv2.__version__,
            "machine": platform.machine(),
        },
    )
    report = args.out / "report.html"
    write_report(report, summary)
    print(f"\nsummary: {'; '.join(f'{r.kind}: {r.verdict}' for r in results)}")
    print(_latency_line(results))
    print(f"report: {report}")
    return 0


def _show_scene(kit: Kit, kind: str, seed: int, out: Path) -> SceneResult:
    scene = make(kind, seed)
    narrator = Narrator(_say)
    metadata = {"apex_edge": __version__, "scene": f"{kind}:{seed}"}
    outputs = RunOutputs(out / kind, kit.config.twin.fps, metadata, ".webm", draws_later=True)
    with outputs:
        with Sink(_both(narrator.see, outputs.write)) as sink:
            outcome = ScenePlayer(kit, os.environ).play(scene, sink.put, True)
        _say(_ending(outcome))
    assert outputs.notes is not None
    return _result(outcome, outputs.notes, outputs.video.path)


def _say(line: str) -> None:
    print(line, flush=True)


def _both(first: Callable[[Step], None], second: Callable[[Step], None]) -> Callable[[Step], None]:
    def call(step: Step) -> None:
        first(step)
        second(step)

    return call


def _ending(outcome: SceneOutcome) -> str:
    if outcome.is_collision:
        return "  they touched: NOT prevented"
    if outcome.is_intervention and outcome.would_collide:
        free_s = outcome.free.t_contact_s
        return f"  prevented: with no arm they would have touched at {free_s:.2f} s"
    if outcome.is_intervention:
        return "  the arm moved although nothing would have happened"
    return "  nothing happened and the arm stayed home"


def _result(outcome: SceneOutcome, notes: SceneNotes, video: Optional[Path]) -> SceneResult:
    return SceneResult(
        kind=outcome.kind,
        notes=notes,
        seed=outcome.seed,
        is_collision=outcome.is_collision,
        is_intervention=outcome.is_intervention,
        source=outcome.source,
        t_free_contact_s=outcome.free.t_contact_s,
        visible_s=outcome.free.visible_s,
        t_trigger_s=outcome.times.trigger_s,
        t_reflex_s=outcome.times.reflex_s,
        t_command_s=outcome.times.command_s,
        t_arrived_s=outcome.times.arrived_s,
        video=video,
        counters=_counters(outcome),
    )


def _counters(outcome: SceneOutcome) -> Dict[str, int]:
    return {str(name): int(value) for name, value in asdict(outcome.camera).items()}


def _latency_line(results: Sequence[SceneResult]) -> str:
    sent_s: List[float] = [s for result in results for s in result.notes.frame_to_command_s]
    if not sent_s:
        return "no command was sent"
    return (
        f"capture to command sent: median {1000.0 * float(np.median(sent_s)):.1f} ms "
        f"over {len(sent_s)} commands (a frame lasts 33.3 ms)"
    )
