"""Registries by name: built-in and third-party parts come in through the same door.

A part is a class published under an entry-point group ``apex_edge.<kind>`` (cameras, triggers,
simulators, planners, verbs). ``setup.py`` lists the built-in ones.
"""

import difflib
from typing import Any, List

import importlib_metadata

from apex_edge.errors import PluginError


def names(kind: str) -> List[str]:
    """Return the registered names of one kind, sorted."""
    return sorted({entry.name for entry in importlib_metadata.entry_points(group=_group(kind))})


def load(kind: str, name: str) -> Any:
    """Return the object published as ``name`` in the group ``apex_edge.<kind>``.

    Raises
    ------
    PluginError : no such name (the message lists what there is), or the part cannot be imported.
    """
    found = [e for e in importlib_metadata.entry_points(group=_group(kind)) if e.name == name]
    if not found:
        known = names(kind)
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
        hint = f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known) or 'none'}"
        raise PluginError(f"no {kind} plug-in is named {name!r}; {hint}")
    try:
        return found[0].load()
    except (ImportError, AttributeError) as error:
        raise PluginError(f"{kind} plug-in {name!r} cannot be loaded: {error}") from error


def _group(kind: str) -> str:
    return f"apex_edge.{kind}"
