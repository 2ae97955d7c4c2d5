"""Packages of an extra, imported when the work asks for them."""

import importlib
from typing import Any

from offline_train.trigger.fit import MissingExtraError


def module(name: str, extra: str) -> Any:
    """Import a module of an extra late, so that nothing else needs it.

    Raises
    ------
    MissingExtraError : it is not installed; says what to type.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError(
            f"this needs {name.split('.')[0]}, which is not here ({error}); "
            f"install it on a workstation with: pip install 'apex-edge[{extra}]'"
        ) from error
