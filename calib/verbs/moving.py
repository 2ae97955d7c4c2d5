"""Ask before an arm moves: what is going to happen is said first, and only a plain yes counts."""

import sys

from apex_edge.errors import InputError


def confirm(what: str, is_yes: bool) -> None:
    """Announce a motion and wait for the word yes, unless it was given on the command line.

    Raises
    ------
    InputError : any other answer, or nobody there to answer; nothing has moved.
    """
    sys.stderr.write(f"{what}\nKeep hands and cables away; Ctrl-C stops the arm.\n")
    if is_yes:
        return
    sys.stderr.write("Type yes to let it move: ")
    sys.stderr.flush()
    answer = sys.stdin.readline().strip().lower()
    if answer != "yes":
        raise InputError(f"answered {answer!r} instead of yes: nothing was moved (or give --yes)")
