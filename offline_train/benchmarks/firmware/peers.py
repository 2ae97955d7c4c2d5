"""The independent servo libraries beside ours, each imported from a folder of its own."""

import importlib
import sys
from pathlib import Path
from types import ModuleType
from typing import Iterator, List, Optional

FOLDER = Path(sys.prefix) / "peers"


def load(package: str, module: str) -> Optional[ModuleType]:
    """Return a module of a peer, or None where ``scripts/setup_peers.py`` has not put it.

    Two peers bring a module of the same name (``scservo_sdk``), so what was imported before under
    that name is forgotten first; what a caller holds goes on working.

    Parameters
    ----------
    package : its name on the package index, e.g. ``feetech-servo-sdk``.
    module : what to import of it.
    """
    folder = next(iter(sorted(FOLDER.glob(f"{package}-*"))), None)
    if folder is None:
        return None
    top = module.split(".")[0]
    for name in _loaded(top):
        del sys.modules[name]
    sys.path.insert(0, str(folder))
    try:
        return importlib.import_module(module)
    finally:
        sys.path.remove(str(folder))


def _loaded(top: str) -> List[str]:
    return list(_names(top))


def _names(top: str) -> Iterator[str]:
    for name in list(sys.modules):
        if name == top or name.startswith(top + "."):
            yield name
