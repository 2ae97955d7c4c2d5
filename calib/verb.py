"""The verb ``apex calibrate``: measure once what the agent must know of lens, table and arm.

The kinds are found by name in the entry-point group ``apex_edge.calibrations``.
"""

import argparse

from apex_edge.verbs.group import add_sub_verbs, run_sub_verb

HELP = "measure lens, table, hand-eye, colours, servos and latency"
EXAMPLE = "apex calibrate colour --image table.png --sample red:320,240,12 --out colours.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare one sub-command per registered calibration."""
    add_sub_verbs(parser, "calibrations", "KIND")


def run(args: argparse.Namespace) -> int:
    """Run the chosen calibration and return its exit code."""
    return run_sub_verb(args, "calibrations")
