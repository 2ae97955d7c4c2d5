"""``apex bench``: run one benchmark, found by name in the entry-point group ``apex_edge.benches``.

A benchmark is a module with ``HELP``, ``EXAMPLE``, ``add_arguments(parser)`` and ``run(args)``, as
a verb is. One that cannot be imported (a missing extra) is listed and says so when it is asked for.
"""

import argparse

from apex_edge import plugins
from apex_edge.errors import PluginError

HELP = "measure this machine, one benchmark at a time"
EXAMPLE = "apex bench rollout --json rollout.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare one sub-command per registered benchmark."""
    which = parser.add_subparsers(dest="bench", metavar="BENCH")
    which.required = True
    for name in plugins.names("benches"):
        try:
            bench = plugins.load("benches", name)
        except PluginError as error:
            which.add_parser(name, help=f"(not usable: {error})")
            continue
        sub = which.add_parser(
            name,
            help=bench.HELP,
            description=bench.HELP,
            epilog=f"example: {bench.EXAMPLE}",
        )
        bench.add_arguments(sub)


def run(args: argparse.Namespace) -> int:
    """Run the chosen benchmark and return its exit code.

    Raises
    ------
    PluginError : it cannot be imported.
    """
    code: int = plugins.load("benches", args.bench).run(args)
    return code
