"""``apex arm``: one action on one arm, found by name in the group ``apex_edge.arm_actions``."""

import argparse

from apex_edge.verbs.group import add_sub_verbs, run_sub_verb

HELP = "find an arm, ask it, move it within its limits, stop it"
EXAMPLE = "apex arm ping --arm so-101 --port /dev/ttyACM0"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare one sub-command per registered action."""
    add_sub_verbs(parser, "arm_actions", "ACTION")


def run(args: argparse.Namespace) -> int:
    """Run the chosen action and return its exit code."""
    return run_sub_verb(args, "arm_actions")
