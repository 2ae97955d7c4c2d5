"""``apex bench trigger``: every promise of the hazard trigger, on seeds no training has used.

Each suite takes under a minute. Scores are those of the scenes drawn from ``--seed``; times are
ratios or CPU time on this machine. The exit code is 1 when a line misses its goal. ``cost`` runs
on Python 3.7 with nothing but the device's packages. Source: ours; goals in docs/benchmarks.md.
"""

import argparse
import importlib
from typing import List

from offline_train.benchmarks.lines import Line
from offline_train.benchmarks.suites import add_suite_arguments, run_suites

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
    add_suite_arguments(parser, SUITES)


def run(args: argparse.Namespace) -> int:
    """Measure, print and write; return 1 when a line misses its goal.

    Raises
    ------
    ConfigError : an option that makes no sense.
    MissingExtraError : a suite needs packages that are not here.
    """

    def measure(name: str) -> List[Line]:
        lines: List[Line] = importlib.import_module(f"{__package__}.{name}").measure(args.seed)
        return lines

    return run_suites(args, SUITES, measure, {"format": "apex-bench-trigger"})
