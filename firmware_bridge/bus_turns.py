"""Whose turn it is on the line: the urgent before the rest, and first come first served."""

import contextlib
import enum
import heapq
import threading
from typing import Iterator, List, Tuple


class Priority(enum.IntEnum):
    """What goes first when several callers want the line; the lowest value does."""

    ESTOP = 0
    STOP = 1
    MOVE = 2
    READ = 3


class Turns:
    """A lock that serves those who wait by priority, fairly within one."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: List[Tuple[int, int]] = []
        self._n_tickets = 0
        self._is_taken = False

    @contextlib.contextmanager
    def turn(self, priority: Priority) -> Iterator[None]:
        """Wait for the line, hold it for the block, and hand it on."""
        self._acquire(priority)
        try:
            yield
        finally:
            self._release()

    @contextlib.contextmanager
    def turn_if_free(self) -> Iterator[bool]:
        """Hold the line for the block if nobody has or wants it; gives whether it does."""
        with self._changed:
            is_mine = not self._is_taken and not self._waiting
            self._is_taken = self._is_taken or is_mine
        try:
            yield is_mine
        finally:
            if is_mine:
                self._release()

    def is_wanted_above(self, priority: Priority) -> bool:
        """Say whether somebody more urgent waits."""
        with self._changed:
            return bool(self._waiting) and self._waiting[0][0] < priority

    def _acquire(self, priority: Priority) -> None:
        with self._changed:
            if not self._is_taken and not self._waiting:
                self._is_taken = True
                return
            self._n_tickets += 1
            ticket = (int(priority), self._n_tickets)
            heapq.heappush(self._waiting, ticket)
            try:
                while self._is_taken or self._waiting[0] != ticket:
                    self._changed.wait()
                self._is_taken = True
            finally:  # Ctrl-C while waiting must not leave a ticket that nobody comes for
                self._waiting.remove(ticket)
                heapq.heapify(self._waiting)
                self._changed.notify_all()

    def _release(self) -> None:
        with self._changed:
            self._is_taken = False
            self._changed.notify_all()
