"""Import what needs PyTorch late, and say what to install when it is not there."""

import importlib
from typing import Any

from offline_train.trigger.fit import MissingExtraError

_PACKAGES = ("torch", "torch_geometric")


def graph_module(name: str) -> Any:
    """Import a module that needs PyTorch or PyTorch Geometric.

    Raises
    ------
    MissingExtraError : they are not installed; says what to type.
    """
    try:
        return importlib.import_module(name)
    except ImportError as error:
        if (error.name or "").split(".")[0] not in _PACKAGES:
            raise
        raise MissingExtraError(
            f"graph models need PyTorch and PyTorch Geometric, which are not here ({error}); "
            "install them on a workstation with: pip install 'apex-edge[graph]'"
        ) from error
