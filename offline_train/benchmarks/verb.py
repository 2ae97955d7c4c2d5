"""``apex bench``: one benchmark, found by name in the entry-point group ``apex_edge.benches``."""

import argparse

from apex_edge.verbs.group import add_sub_verbs, run_sub_verb

HELP = "measure this machine, one benchmark at a time"
EXAMPLE = "apex bench rollout --json rollout.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare one sub-command per registered benchmark."""
    add_sub_verbs(parser, "benches", "BENCH")


def run(args: argparse.Namespace) -> int:
    """Run the chosen benchmark and return its exit code."""
    return run_sub_verb(args, "benches")
