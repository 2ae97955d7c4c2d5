"""Read the LAB ranges that HiWonder's tools write (``lab_config.yaml``).

::

    red:                  or the same below ``color_range_list:`` (ROS)
      max: [255, 255, 255]
      min: [0, 166, 135]
"""

from pathlib import Path
from typing import Any, Dict, Optional, Tuple

from apex_edge.errors import ColourError
from apex_edge.perception.lab_range import LabRange

_MAX_DEPTH = 5
_MAX_BYTES = 1_000_000


def read_ranges(path: Path) -> Dict[str, LabRange]:
    """Return the ranges of a file by colour name.

    Raises
    ------
    ImportError : PyYAML is not installed (the extra ``hiwonder`` brings it).
    ColourError : unreadable, not YAML, no range in it, or a range outside 0..255.
    """
    import yaml  # only who imports ranges needs it

    try:
        text = path.read_text(encoding="utf-8")
        if len(text) > _MAX_BYTES:
            raise ColourError(f"{path}: {len(text)} characters are no list of ranges")
        # aliases could make a small file expand without end, and no such file has any
        if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text)):
            raise ColourError(f"{path}: YAML aliases are not allowed in a list of ranges")
        document = yaml.safe_load(text)
    except OSError as error:
        raise ColourError(f"{path}: cannot read: {error}") from error
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise ColourError(f"{path}: not a YAML file: {error}") from error
    found = _find(document, _MAX_DEPTH)
    if not found:
        raise ColourError(f"{path}: holds no colour with min and max of three numbers each")
    return {name: _range(name, entry, path) for name, entry in found.items()}


def _find(node: Any, depth: int) -> Dict[str, Dict[str, Any]]:
    """Return the first mapping, from outside in, whose values have min and max."""
    if not isinstance(node, dict) or depth == 0:
        return {}
    here = {
        str(key): value
        for key, value in node.items()
        if isinstance(value, dict) and {"min", "max"} <= set(value)
    }
    if here:
        return here
    for value in node.values():
        deeper = _find(value, depth - 1)
        if deeper:
            return deeper
    return {}


def _range(name: str, entry: Dict[str, Any], path: Path) -> LabRange:
    low, high = _triple(entry["min"]), _triple(entry["max"])
    if low is None or high is None or any(a > b for a, b in zip(low, high)):
        raise ColourError(
            f"{path}: {name}: min {entry['min']!r} and max {entry['max']!r} must be three numbers "
            "of 0..255 each, min not above max"
        )
    return LabRange(name, low, high)


def _triple(values: Any) -> Optional[Tuple[float, float, float]]:
    if not isinstance(values, (list, tuple)) or len(values) != 3:
        return None
    for value in values:
        is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not is_number or not 0 <= value <= 255:
            return None
    return float(values[0]), float(values[1]), float(values[2])
