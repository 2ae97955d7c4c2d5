"""``apex bench firmware``: every promise of the firmware bridge, measured on simulated devices.

The short form takes part of the counts and under a minute; ``--full`` takes them all. Figures in
seconds are those of this machine at this moment; ratios are taken side by side in one run. The exit
code is 1 when a line misses its goal. Source: ours; formats and goals are in docs/benchmarks.md.
"""

import argparse
import importlib
import json
import platform
import time
from pathlib import Path
from typing import Any, Dict, List, Sequence

from apex_edge.errors import ConfigError
from apex_edge.record.whole import write_whole_text
from offline_train.benchmarks.lines import Line, are_all_ok, table

HELP = "codecs, noise, faults, e-stop, unplugging, dead hosts and kinematics of the arm side"
EXAMPLE = "apex bench firmware --json firmware.json"
SUITES = (
    "vectors",
    "fuzz",
    "resync",
    "parser_speed",
    "corruption",
    "reads",
    "noisy_moves",
    "hostile",
    "unplug",
    "host_death",
    "estop",
    "servo_faults",
    "throughput",
    "kinematics",
    "guard_cases",
)
SHORT = 0.01
SHORTER = {"hostile": 0.003, "noisy_moves": 0.004}
"""Share of the full counts that the short form takes."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--full", action="store_true", help="the full counts (about an hour)")
    parser.add_argument(
        "--suite",
        action="append",
        choices=SUITES,
        metavar="NAME",
        help=f"only this one, may be repeated: {', '.join(SUITES)}",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers (1)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the lines here")


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return 1 when a line misses its goal.

    Raises
    ------
    ConfigError : an option that makes no sense.
    """
    if args.seed < 0:
        raise ConfigError(f"--seed {args.seed}: expected 0 or more")
    if args.json is not None and not args.json.parent.is_dir():
        raise ConfigError(f"--json {args.json}: the folder {args.json.parent} does not exist")
    lines: List[Line] = []
    took_s: Dict[str, float] = {}
    for name in args.suite or SUITES:
        suite = importlib.import_module(f"{__package__}.{name}")
        begin_s = time.monotonic()
        lines += suite.measure(1.0 if args.full else SHORTER.get(name, SHORT), args.seed)
        took_s[name] = round(time.monotonic() - begin_s, 1)
    print(table(lines))
    print("seconds: " + ", ".join(f"{name} {s:g}" for name, s in took_s.items()))
    if args.json is not None:
        write_whole_text(args.json, json.dumps(_report(args, lines, took_s), indent=1) + "\n")
    return 0 if are_all_ok(lines) else 1


def _report(
    args: argparse.Namespace, lines: Sequence[Line], took_s: Dict[str, float]
) -> Dict[str, Any]:
    return {
        "format": "apex-bench-firmware",
        "format_version": 1,
        "is_full": args.full,
        "seed": args.seed,
        "is_ok": are_all_ok(lines),
        "machine": {"python": platform.python_version(), "processor": platform.machine()},
        "took_s": took_s,
        "lines": [line.plain() for line in lines],
    }
