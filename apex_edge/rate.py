"""Call something at a steady rate from its own thread, by absolute deadlines (no drift)."""

import logging
import threading
import time
from types import TracebackType
from typing import Callable, Optional, Type

log = logging.getLogger(__name__)


class Pacer:
    """Call ``task`` every ``period_s`` until left; a context manager.

    A task that raises ends the pacing; the error is raised again on leaving the context. ``n_late``
    counts calls that started more than a period behind; missed turns are skipped, not made up.
    Source: the rate keeper of openpilot, re-thought for one thread.
    """

    def __init__(
        self,
        task: Callable[[], None],
        period_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._task = task
        self._period_s = period_s
        self._clock = clock
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="apex-pacer", daemon=True)
        self.error: Optional[Exception] = None
        self.n_late = 0

    def __enter__(self) -> "Pacer":
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: Optional[Type[BaseException]],
        error: Optional[BaseException],
        trace: Optional[TracebackType],
    ) -> None:
        """Stop the thread and raise what ended it, unless something else is under way."""
        self._stop.set()
        self._thread.join()
        if self.error is not None and kind is None:
            raise self.error

    def _loop(self) -> None:
        due_s = self._clock() + self._period_s
        while not self._stop.wait(max(0.0, due_s - self._clock())):
            try:
                self._task()
            except Exception as error:  # thread boundary: handed over to whoever leaves the context
                log.error("a paced task failed: %s", error)
                self.error = error
                return
            due_s += self._period_s
            behind_s = self._clock() - due_s
            if behind_s > self._period_s:
                self.n_late += 1
                due_s += self._period_s * int(behind_s / self._period_s)
