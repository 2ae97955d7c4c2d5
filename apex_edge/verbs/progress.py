"""A progress line on the terminal; silent where nobody looks."""

import sys
import time
from types import TracebackType
from typing import Optional, Type

REFRESH_S = 0.2


class Progress:
    """Count up on one line of standard error; a context manager.

    Parameters
    ----------
    unit : what is counted.
    n_total : how many there will be; None when that is not known.
    is_quiet : say nothing; it is also silent when standard error is not a terminal.
    """

    def __init__(self, unit: str, n_total: Optional[int] = None, is_quiet: bool = False) -> None:
        self._unit = unit
        self._n_total = n_total
        self._is_shown = not is_quiet and sys.stderr.isatty()
        self._shown_s = 0.0
        self.n_done = 0

    def __enter__(self) -> "Progress":
        """Start counting."""
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """Wipe the line."""
        if self._is_shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def advance(self) -> None:
        """Count one more and show it when the last look is old enough."""
        self.n_done += 1
        now_s = time.monotonic()
        if not self._is_shown or now_s - self._shown_s < REFRESH_S:
            return
        self._shown_s = now_s
        total = f" of {self._n_total}" if self._n_total is not None else ""
        sys.stderr.write(f"\r\x1b[K{self.n_done}{total} {self._unit}")
        sys.stderr.flush()
