"""Where a calibration came from: date, hash of the data, versions of what computed it."""

import hashlib
import platform
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Dict, Iterable

import cv2
import numpy as np

from calib.verdict import Verdict


def data_digest(parts: Iterable[bytes]) -> str:
    """Return one SHA-256 over all raw data, in order."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return total.hexdigest()


def files_digest(paths: Iterable[Path]) -> str:
    """Return one SHA-256 over the contents of several files, in order."""
    return data_digest(path.read_bytes() for path in paths)


def made(data_sha256: str, verdict: Verdict, **figures: Any) -> Dict[str, Any]:
    """Return the ``made`` section of a document.

    Parameters
    ----------
    data_sha256 : hash of the raw data (``data_digest``).
    verdict : grade and reasons.
    figures : errors per view, coverage, uncertainty, ...; plain values.
    """
    return {
        "date": datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "data_sha256": data_sha256,
        "versions": {
            "python": platform.python_version(),
            "opencv": cv2.__version__,
            "numpy": np.__version__,
        },
        **verdict.plain(),
        **figures,
    }
