"""Latency files, and the lines for the settings."""

from typing import Any, Dict, List, Mapping, Sequence

from apex_edge import documents
from calib.latency import LatencyResult

FORMAT = "apex-latency"
VERSION = 1


def latency_document(
    result: LatencyResult, includes: Sequence[str], made: Mapping[str, Any]
) -> Dict[str, Any]:
    """Return the document; ``includes`` names what else is in the figure, e.g. a display."""
    content = {
        "latency_s": round(max(result.latency_s, 0.0), 6),
        "sd_s": result.sd_s,
        "includes": list(includes),
    }
    return documents.compose(FORMAT, VERSION, content, made)


def settings_lines(result: LatencyResult) -> List[str]:
    """Return the lines for the settings file."""
    return ["[camera]", f"latency_s = {max(result.latency_s, 0.0):.4f}"]
