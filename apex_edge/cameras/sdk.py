"""Camera makers' packages: imported when a camera is opened; a missing one says what to install."""

import importlib
import platform
import struct
import sys
from typing import Any, NamedTuple, Tuple

from apex_edge.errors import CameraError

ARM32 = "armv7l"


class Sdk(NamedTuple):
    """A maker's Python package.

    ``module`` is imported; ``install`` is for pip, or a whole command; there are wheels for
    ``machines`` from Python ``least_python`` on, and where there are none ``otherwise`` says what
    to do. ``library`` is what to install when a shared library is missing.
    """

    module: str
    install: str
    machines: Tuple[str, ...]
    least_python: Tuple[int, int]
    otherwise: str
    library: str = ""


def load(sdk: Sdk, camera_type: str) -> Any:
    """Import a maker's package.

    Raises
    ------
    CameraError : it is not there or cannot be loaded; the message says what to install here.
    """
    try:
        return importlib.import_module(sdk.module)
    except ImportError as error:
        is_missing = isinstance(error, ModuleNotFoundError) and error.name == sdk.module
        why = f"needs the Python package {sdk.module}" if is_missing else f"cannot start: {error}"
        cure = sdk.library
        if is_missing or not cure:
            cure = how_to_install(sdk, sys.version_info[:2], machine())
        raise CameraError(f"camera type {camera_type!r} {why}; {cure}") from error


def how_to_install(sdk: Sdk, python: Tuple[int, ...], machine_name: str) -> str:
    """Say what to do on a machine (as ``platform.machine``) with a Python version."""
    if machine_name not in sdk.machines or python[:2] < sdk.least_python:
        version = ".".join(str(part) for part in python[:2])
        return f"there is none for Python {version} on {machine_name}: {sdk.otherwise}"
    if " " in sdk.install:
        return f"install it with: {sdk.install}"
    return f"install it with: {sys.executable} -m pip install '{sdk.install}'"


def machine() -> str:
    """Return the machine that wheels must be for; a 32-bit Python may run on a 64-bit kernel."""
    name = platform.machine()
    is_arm32 = struct.calcsize("P") == 4 and name.startswith(("arm", "aarch64"))
    return ARM32 if is_arm32 else name
