"""A line of the bench: what was measured, what it must be, and whether it is."""

import math
from dataclasses import dataclass, field
from typing import Dict, List, Mapping, Optional, Sequence


@dataclass(frozen=True)
class Line:
    """One figure; ``is_ok`` is None where nothing is promised and the figure only informs."""

    suite: str
    what: str
    measured: str
    goal: str = ""
    is_ok: Optional[bool] = None
    figures: Mapping[str, float] = field(default_factory=dict)

    def plain(self) -> Dict[str, object]:
        """Return the line as JSON values; a figure that is not finite becomes None."""
        figures = {key: float(v) if math.isfinite(v) else None for key, v in self.figures.items()}
        return {
            "suite": self.suite,
            "what": self.what,
            "measured": self.measured,
            "goal": self.goal,
            "is_ok": self.is_ok,
            "figures": figures,
        }


def at_most(suite: str, what: str, value: float, limit: float, text: str = "{:.3g}") -> Line:
    """Return a line that is right up to ``limit``; NaN is wrong."""
    return _line(suite, what, value, "<= " + text.format(limit), bool(value <= limit), text)


def at_least(suite: str, what: str, value: float, limit: float, text: str = "{:.3g}") -> Line:
    """Return a line that is right from ``limit`` on; NaN is wrong."""
    return _line(suite, what, value, ">= " + text.format(limit), bool(value >= limit), text)


def note(suite: str, what: str, value: float, text: str = "{:.3g}") -> Line:
    """Return a line that promises nothing."""
    return _line(suite, what, value, "", None, text)


def _line(suite: str, what: str, value: float, goal: str, is_ok: Optional[bool], text: str) -> Line:
    return Line(suite, what, text.format(value), goal, is_ok, {"value": value})


def are_all_ok(lines: Sequence[Line]) -> bool:
    """Say whether something was promised and every promise was kept."""
    kept = [line.is_ok for line in lines if line.is_ok is not None]
    return bool(kept) and all(kept)


def table(lines: Sequence[Line]) -> str:
    """Return the lines as text, one below the other."""
    rows = [("suite", "what", "measured", "goal", "ok")]
    words = {True: "yes", False: "NO", None: ""}
    rows += [(ln.suite, ln.what, ln.measured, ln.goal, words[ln.is_ok]) for ln in lines]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    out: List[str] = []
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths)]
        out.append("  ".join(cells).rstrip())
    return "\n".join(out)
