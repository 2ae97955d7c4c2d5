"""Packages of an extra, imported when the work asks for them."""

import importlib
from typing import Any

from apex_edge.cli import EXTRA_OF
from apex_edge.errors import ApexError


class MissingExtraError(ApexError):
    """Name the extra to install for work that is done off the device."""

    slug = "missing-extra"


def module(name: str) -> Any:
    """Import a module that needs a package of an extra, late, so that nothing else needs it.

    Raises
    ------
    MissingExtraError : the package is not installed; says what to type.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        package = (error.name or name).split(".")[0]
        if package not in EXTRA_OF:
            raise
        raise MissingExtraError(
            f"this needs {package}, which is not here ({error}); install it on a workstation "
            f"with: pip install 'apex-edge[{EXTRA_OF[package]}]'"
        ) from error
