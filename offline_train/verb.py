"""``apex train``: one step of training a trigger, found by name in ``apex_edge.trainings``."""

import argparse

from apex_edge.verbs.group import add_sub_verbs, run_sub_verb

HELP = "train, distil, certify and export hazard triggers"
EXAMPLE = "apex train trigger --seed 1 --out trigger-linear.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare one sub-command per registered step."""
    add_sub_verbs(parser, "trainings", "STEP")


def run(args: argparse.Namespace) -> int:
    """Run the chosen step and return its exit code."""
    return run_sub_verb(args, "trainings")
