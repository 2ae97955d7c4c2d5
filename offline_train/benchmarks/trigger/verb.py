"""``apex bench trigger``: every promise of the hazard trigger, on seeds no training has used.

Each suite takes under a minute. Scores are those of the scenes drawn from ``--seed``; times are
ratios or CPU time on this machine. The exit code is 1 when a line misses its goal. ``cost`` runs
on Python 3.7 with nothing but the device's packages. Source: ours; goals in docs/benchmarks.md.
"""

import argparse
import importlib
import json
import platform
import sys
import time
from pathlib import Path
from typing import Any, Dict, List

from apex_edge.errors import ConfigError
from apex_edge.record.whole import write_whole_text
from offline_train.benchmarks.lines import Line, are_all_ok, table

HELP = "labels, graph models, distillation, certificate, cost and scale of the hazard trigger"
EXAMPLE = "apex bench trigger --suite cost --json trigger.json"
SUITES = (
    "reproduction",
    "leak_free",
    "tabletop",
    "committed",
    "events",
    "soft_labels",
    "certificate",
    "cost",
    "parity",
    "scale",
    "files",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--suite",
        action="append",
        choices=SUITES,
        metavar="NAME",
        help=f"only this one, may be repeated: {', '.join(SUITES)}",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the scenes (1)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the lines here")


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return 1 when a line misses its goal.

    Raises
    ------
    ConfigError : an option that makes no sense.
    MissingExtraError : a suite needs packages that are not here.
    """
    if args.seed < 0:
        raise ConfigError(f"--seed {args.seed}: expected 0 or more")
    if args.json is not None and not args.json.parent.is_dir():
        raise ConfigError(f"--json {args.json}: the folder {args.json.parent} does not exist")
    lines: List[Line] = []
    took_s: Dict[str, float] = {}
    for name in args.suite or SUITES:
        print(f"{name} ...", file=sys.stderr, flush=True)
        suite = importlib.import_module(f"{__package__}.{name}")
        begin_s = time.monotonic()
        lines += suite.measure(args.seed)
        took_s[name] = round(time.monotonic() - begin_s, 1)
    print(table(lines))
    print("seconds: " + ", ".join(f"{name} {s:g}" for name, s in took_s.items()))
    if args.json is not None:
        report: Dict[str, Any] = {
            "format": "apex-bench-trigger",
            "format_version": 1,
            "seed": args.seed,
            "is_ok": are_all_ok(lines),
            "machine": {"python": platform.python_version(), "processor": platform.machine()},
            "took_s": took_s,
            "lines": [line.plain() for line in lines],
        }
        write_whole_text(args.json, json.dumps(report, indent=1) + "\n")
    return 0 if are_all_ok(lines) else 1
