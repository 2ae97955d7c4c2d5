"""A verb made of sub-verbs that register under an entry-point group of their own.

Each is a module with ``HELP``, ``EXAMPLE``, ``add_arguments(parser)`` and ``run(args)``, as a verb
is. One that cannot be imported (a missing extra) is listed and says so when it is asked for.
"""

import argparse
from typing import Any

from apex_edge import plugins
from apex_edge.errors import PluginError


def add_sub_verbs(parser: argparse.ArgumentParser, group: str, metavar: str) -> None:
    """Declare one sub-command per name registered in ``apex_edge.<group>``."""
    which = parser.add_subparsers(dest=group, metavar=metavar)
    which.required = True
    for name in plugins.names(group):
        try:
            part = plugins.load(group, name)
        except PluginError as error:
            which.add_parser(name, help=f"(not usable: {error})")
            continue
        sub = which.add_parser(
            name,
            help=part.HELP,
            description=part.HELP,
            epilog=f"example: {part.EXAMPLE}",
        )
        part.add_arguments(sub)


def run_sub_verb(args: argparse.Namespace, group: str) -> int:
    """Run the chosen sub-command and return its exit code.

    Raises
    ------
    PluginError : it cannot be imported.
    """
    name: Any = getattr(args, group)
    code: int = plugins.load(group, name).run(args)
    return code
