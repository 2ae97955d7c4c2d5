"""Benches made of suites: choose some, run them in order, print and write their lines."""

import argparse
import json
import platform
import sys
import time
from pathlib import Path
from typing import Any, Callable, Dict, List, Mapping, Sequence

from apex_edge.errors import ConfigError
from apex_edge.record.whole import write_whole_text
from offline_train.benchmarks.lines import Line, are_all_ok, table


def add_suite_arguments(parser: argparse.ArgumentParser, suites: Sequence[str]) -> None:
    """Declare the options that all such benches have."""
    parser.add_argument(
        "--suite",
        action="append",
        choices=suites,
        metavar="NAME",
        help=f"only this one, may be repeated: {', '.join(suites)}",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of all random numbers (1)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the lines here")


def run_suites(
    args: argparse.Namespace,
    suites: Sequence[str],
    measure: Callable[[str], List[Line]],
    head: Mapping[str, Any],
) -> int:
    """Measure, print and write; return 1 when a line misses its goal.

    Parameters
    ----------
    measure : returns the lines of a suite by its name.
    head : fields of the JSON file besides those all benches have; ``format`` among them.

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
    for name in args.suite or suites:
        print(f"{name} ...", file=sys.stderr, flush=True)
        begin_s = time.monotonic()
        lines += measure(name)
        took_s[name] = round(time.monotonic() - begin_s, 1)
    print(table(lines))
    print("seconds: " + ", ".join(f"{name} {s:g}" for name, s in took_s.items()))
    if args.json is not None:
        report = {
            **head,
            "format_version": 1,
            "seed": args.seed,
            "is_ok": are_all_ok(lines),
            "machine": {"python": platform.python_version(), "processor": platform.machine()},
            "took_s": took_s,
            "lines": [line.plain() for line in lines],
        }
        write_whole_text(args.json, json.dumps(report, indent=1) + "\n")
    return 0 if are_all_ok(lines) else 1
