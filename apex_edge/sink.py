"""Hand steps to a writer off the control path.

Steps wait in memory and one thread writes them. When writing falls behind, pictures are left out
and counted; the steps themselves, and so the decisions, never are.
"""

import logging
import queue
import threading
from dataclasses import replace
from typing import Callable, Optional

import numpy as np

from apex_edge.types import Step

log = logging.getLogger(__name__)

MAX_WAITING = 60
NO_PICTURE = np.zeros((0, 0, 3), dtype=np.uint8)


class Sink:
    """Feed steps to ``write`` from a thread of its own; a context manager.

    Parameters
    ----------
    write : gets every step; the frame of one whose picture was left out has an empty
        ``colour_bgr``.
    max_waiting : steps that may wait with their pictures (a 640x480 step holds 1.5 MB).
    """

    def __init__(self, write: Callable[[Step], None], max_waiting: int = MAX_WAITING) -> None:
        self._write = write
        self._max_waiting = max_waiting
        self._steps: queue.Queue[Optional[Step]] = queue.Queue()
        self._thread = threading.Thread(target=self._work, name="apex-sink", daemon=True)
        self._error: Optional[Exception] = None
        self.n_pictures_left_out = 0

    def __enter__(self) -> "Sink":
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Write all that waits; raise what the writer raised, unless an error is under way."""
        self._steps.put(None)
        self._thread.join()
        if self.n_pictures_left_out:
            log.warning("pictures left out as writing was too slow: %d", self.n_pictures_left_out)
        is_asked_to_end = kind in (None, KeyboardInterrupt, SystemExit)
        if self._error is not None and is_asked_to_end:
            raise self._error

    def put(self, step: Step) -> None:
        """Hand over a step; never blocks."""
        if self._steps.qsize() >= self._max_waiting:
            self.n_pictures_left_out += 1
            step = replace(step, frame=replace(step.frame, colour_bgr=NO_PICTURE, depth_mm=None))
        self._steps.put(step)

    def _work(self) -> None:
        while True:
            step = self._steps.get()
            if step is None:
                return
            if self._error is not None:
                continue
            try:
                self._write(step)
            except Exception as error:  # thread boundary: raised again by whoever leaves
                log.error("writing stopped: %s", error)
                self._error = error
