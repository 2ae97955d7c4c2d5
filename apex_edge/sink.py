"""Write what a run leaves behind, off the control path.

Steps are handed over in memory and written by one thread: decisions.jsonl, tracks.csv, the
recording and the annotated video. When writing falls behind, pictures are left out and counted;
decisions never are.
"""

import queue
import threading
from dataclasses import replace
from typing import Callable, Optional, Sequence

import numpy as np

from apex_edge.errors import ApexError
from apex_edge.types import Step

Writer = Callable[[Step], None]


class Sink:
    """Feed steps to writers from a thread of its own; a context manager.

    Parameters
    ----------
    logs : called with every step, whatever happens.
    pictures : called with every step whose picture is still there.
    max_waiting : steps that may wait with their pictures (a 640x480 step holds 1.5 MB).
    """

    def __init__(
        self, logs: Sequence[Writer], pictures: Sequence[Writer], max_waiting: int = 60
    ) -> None:
        self._logs = tuple(logs)
        self._pictures = tuple(pictures)
        self._max_waiting = max_waiting
        self._steps: "queue.Queue[Optional[Step]]" = queue.Queue()
        self._thread = threading.Thread(target=self._work, name="apex-sink", daemon=True)
        self._error: Optional[Exception] = None
        self.n_pictures_left_out = 0

    def __enter__(self) -> "Sink":
        """Start the thread."""
        self._thread.start()
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Write all that waits; raise what a writer raised, unless something else is under way."""
        self._steps.put(None)
        self._thread.join()
        if self._error is not None and kind is None:
            raise self._error

    def put(self, step: Step) -> None:
        """Hand over a step; never blocks."""
        if self._steps.qsize() >= self._max_waiting:
            self.n_pictures_left_out += 1
            step = replace(step, frame=replace(step.frame, colour_bgr=_NO_PICTURE, depth_mm=None))
        self._steps.put(step)

    def _work(self) -> None:
        while True:
            step = self._steps.get()
            if step is None:
                return
            if self._error is not None:
                continue
            try:
                for log in self._logs:
                    log(step)
                for picture in self._pictures if step.frame.colour_bgr.size else ():
                    picture(step)
            except (ApexError, OSError, ValueError) as error:
                self._error = error


_NO_PICTURE = np.zeros((0, 0, 3), dtype=np.uint8)
