"""Where a calibration came from: date, its data and their hash, versions of what computed it."""

import hashlib
import platform
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Dict, Iterable, Mapping, NamedTuple, Sequence, Tuple

import cv2
import numpy as np


class Data(NamedTuple):
    """The raw data of a calibration: one SHA-256 over all of it, and the files it came from."""

    sha256: str
    files: Tuple[str, ...] = ()


def raw_data(parts: Iterable[bytes]) -> Data:
    """Return data that is in no file, in order."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return Data(total.hexdigest())


def file_data(paths: Sequence[Path]) -> Data:
    """Return the contents of several files, in order."""
    whole = raw_data(path.read_bytes() for path in paths)
    return whole._replace(files=tuple(path.name for path in paths))


def made(data: Data, figures: Mapping[str, Any]) -> Dict[str, Any]:
    """Return the ``made`` section of a document.

    Parameters
    ----------
    data : what it was made from.
    figures : verdict, reasons, errors per view, coverage, uncertainty, ...; plain values.
    """
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "data_sha256": data.sha256,
        "files": list(data.files),
        "versions": {
            "python": platform.python_version(),
            "opencv": cv2.__version__,
            "numpy": np.__version__,
        },
        **figures,
    }
