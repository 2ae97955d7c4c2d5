"""``apex bench perception``: what perception costs, how right it is, and what it does with rubbish.

Suites: ``cost`` against LAB ranges and the paper's pipeline; ``motion`` against the paper's windows
and the Cramer-Rao limit; ``nis``, whether the stated covariance is honest; ``clips`` with labels
(the twin's own, or yours with --clips); ``malformed`` inputs. Every ratio is taken side by side in
one run; the exit code is 1 when a line misses its goal. Source: ours.
"""

import argparse
import json
import platform
import tempfile
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.errors import ColourError, ConfigError
from apex_edge.perception import PerceptionConfig
from apex_edge.record.whole import write_whole_text
from offline_train.benchmarks.lines import Line, are_all_ok, table
from offline_train.benchmarks.perception import (
    clips,
    cost,
    honesty,
    malformed,
    motion,
    truth,
    twin_clips,
)
from offline_train.benchmarks.perception.truth import ClipTruth

HELP = "cost, motion, honesty, labelled clips and malformed inputs of perception"
EXAMPLE = "apex bench perception --clips my_clips --json perception.json"
SUITES = ("cost", "motion", "nis", "clips", "malformed")
N_NIS_SEEDS = 2

Clips = List[Tuple[str, ClipTruth]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--suite",
        choices=(*SUITES, "all"),
        help="what to measure (all; with --clips: clips)",
    )
    parser.add_argument(
        "--clips", type=Path, metavar="DIR", help="labelled clips, see docs/labelled-clips.md"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers (1)")
    parser.add_argument("--n", type=int, default=malformed.N_CASES, help="malformed inputs (10000)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the lines here")
    parser.add_argument("--part", help=argparse.SUPPRESS)
    parser.add_argument("--results", type=Path, help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return 1 when a line misses its goal.

    Raises
    ------
    ConfigError : an option that makes no sense.
    InputError : clips or truth files that cannot be used.
    """
    if args.part is not None:
        first, last = (int(number) for number in args.part.split(":"))
        malformed.run_part(args.seed, range(first, last), args.results)
        return 0
    if args.n < 1 or args.seed < 0:
        raise ConfigError(f"--n {args.n} --seed {args.seed}: expected --n >= 1, --seed >= 0")
    if args.json is not None and not args.json.parent.is_dir():
        raise ConfigError(f"--json {args.json}: the folder {args.json.parent} does not exist")
    suite = args.suite or ("clips" if args.clips is not None else "all")
    lines: List[Line] = []
    with tempfile.TemporaryDirectory() as folder:
        found = _clips(args.clips, Path(folder)) if suite in ("clips", "nis", "all") else []
        for name in SUITES if suite == "all" else (suite,):
            lines += _measure(name, args, found)
    print(table(lines))
    if args.json is not None:
        write_whole_text(args.json, json.dumps(_report(args, suite, lines), indent=1) + "\n")
    return 0 if are_all_ok(lines) else 1


def _clips(folder: Optional[Path], own: Path) -> Clips:
    """Return the labelled clips of a folder, or the twin's own, written into ``own``."""
    files = truth.find_clips(folder) if folder is not None else twin_clips.write_all(own)
    return [(path.parent.name, truth.load(path)) for path in files]


def _measure(suite: str, args: argparse.Namespace, found: Clips) -> List[Line]:
    config = PerceptionConfig()
    if suite == "cost":
        return cost.measure()
    if suite == "motion":
        return motion.measure(args.seed)
    if suite == "malformed":
        return malformed.measure(args.seed, args.n)
    if suite == "clips":
        return clips.measure(found, config)
    seeds = range(args.seed, args.seed + N_NIS_SEEDS)
    return [*_clip_honesty(found, config), *honesty.measure_twin(config, seeds)]


def _clip_honesty(found: Clips, config: PerceptionConfig) -> List[Line]:
    lines: List[Line] = []
    for name, clip in found:
        try:
            run_of_clip = clips.play(clip, clips.colours_of(clip), config)
        except ColourError as error:
            lines.append(Line("nis", f"{name}: colours", str(error), "usable", False))
            continue
        lines += honesty.measure_clip(name, clip, run_of_clip)
    return lines


def _report(args: argparse.Namespace, suite: str, lines: Sequence[Line]) -> Dict[str, Any]:
    return {
        "format": "apex-bench-perception",
        "format_version": 1,
        "suite": suite,
        "seed": args.seed,
        "is_ok": are_all_ok(lines),
        "machine": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
            "processor": platform.machine(),
        },
        "lines": [line.plain() for line in lines],
    }
