"""``apex bench firmware``: every promise of the firmware bridge, measured on simulated devices.

The short form takes part of the counts and under a minute; ``--full`` takes them all. Figures in
seconds are those of this machine at this moment; ratios are taken side by side in one run. The exit
code is 1 when a line misses its goal. Source: ours; formats and goals are in docs/benchmarks.md.
"""

import argparse
import importlib
from typing import List

from offline_train.benchmarks.lines import Line
from offline_train.benchmarks.suites import add_suite_arguments, run_suites

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
    add_suite_arguments(parser, SUITES)


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return 1 when a line misses its goal.

    Raises
    ------
    ConfigError : an option that makes no sense.
    """

    def measure(name: str) -> List[Line]:
        share = 1.0 if args.full else SHORTER.get(name, SHORT)
        suite = importlib.import_module(f"{__package__}.{name}")
        lines: List[Line] = suite.measure(share, args.seed)
        return lines

    head = {"format": "apex-bench-firmware", "is_full": args.full}
    return run_suites(args, SUITES, measure, head)
