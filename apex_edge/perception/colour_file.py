"""The colour file: a signed document, its ranges checked before anything is built from it.

::

    {"format": "apex-edge-colours", "version": 1, "sha256": "...",
     "colours": [{"name", "chroma", "chroma_cov", "log_luma", "log_luma_sd", "gate", "floor"}
                 or {"name", "lab_min", "lab_max"}],
     "made": {...}}
"""

import math
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

from apex_edge import documents
from apex_edge.errors import ColourError
from apex_edge.perception.colour_model import ColourModel
from apex_edge.perception.lab_range import LabRange
from apex_edge.perception.regions import Region

FORMAT = "apex-edge-colours"
VERSION = 1
_RANGES = {
    "log_luma": (0.0, 6.0),
    "log_luma_sd": (0.01, 3.0),
    "gate": (0.1, 200.0),
    "floor": (0.0, 1.0),
}


def compose(colours: Sequence[Mapping[str, Any]], made: Mapping[str, Any]) -> Dict[str, Any]:
    """Return a complete document for colours given as plain mappings."""
    content = {"colours": [dict(colour) for colour in colours]}
    return documents.compose(FORMAT, VERSION, content, made)


def read(path: Path) -> List[Region]:
    """Return the checked colours of a file.

    Raises
    ------
    ColourError : unreadable, not JSON, wrong format, version, hash, key or range.
    """
    document = documents.read(path, FORMAT, VERSION, ColourError)
    colours = document.get("colours")
    if not isinstance(colours, list) or not colours:
        raise ColourError(f"{path}: no colours in the file")
    return [_checked(colour, path) for colour in colours]


def _checked(colour: Any, path: Path) -> Region:
    if not isinstance(colour, dict) or not isinstance(colour.get("name"), str):
        raise ColourError(f"{path}: a colour without a name")
    name = colour["name"]
    if not name.strip() or len(name) > 64:
        raise ColourError(f"{path}: colour name {name!r} must have 1 to 64 characters")
    if "lab_min" in colour:
        return _checked_range(colour, f"{path}: colour {name!r}")
    chroma = _numbers(colour.get("chroma"), 2, f"{path}: colour {name!r}: chroma")
    rows = colour.get("chroma_cov")
    if not isinstance(rows, list) or len(rows) != 2:
        raise ColourError(f"{path}: colour {name!r}: chroma_cov must be 2 rows of 2 numbers")
    (a, b), (c, d) = (_numbers(row, 2, f"{path}: colour {name!r}: chroma_cov") for row in rows)
    if not (a > 0.0 and d > 0.0 and b == c and a * d - b * b > 1e-12):
        raise ColourError(f"{path}: colour {name!r}: chroma_cov is not a covariance")
    if not 1e-3 <= math.hypot(*chroma) <= 2.0:
        raise ColourError(f"{path}: colour {name!r}: chroma {chroma} is outside [0.001, 2]")
    result: Dict[str, Any] = {
        "name": name,
        "chroma": (chroma[0], chroma[1]),
        "chroma_cov": ((a, b), (c, d)),
    }
    for key, (low, high) in _RANGES.items():
        (value,) = _numbers([colour.get(key)], 1, f"{path}: colour {name!r}: {key}")
        if not low <= value <= high:
            raise ColourError(
                f"{path}: colour {name!r}: {key} = {value} is outside [{low}, {high}]"
            )
        result[key] = value
    return ColourModel(**result)


def _checked_range(colour: Mapping[str, Any], where: str) -> LabRange:
    low = _numbers(colour.get("lab_min"), 3, f"{where}: lab_min")
    high = _numbers(colour.get("lab_max"), 3, f"{where}: lab_max")
    if not all(0.0 <= a <= b <= 255.0 for a, b in zip(low, high)):
        raise ColourError(f"{where}: LAB {low} to {high} is not a range within 0..255")
    return LabRange(colour["name"], (low[0], low[1], low[2]), (high[0], high[1], high[2]))


def _numbers(values: Any, count: int, where: str) -> List[float]:
    if not isinstance(values, list) or len(values) != count:
        raise ColourError(f"{where} must be {count} numbers, found {values!r}")
    for value in values:
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            raise ColourError(f"{where} must be finite numbers, found {value!r}")
    return [float(value) for value in values]
