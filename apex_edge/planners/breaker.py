"""Circuit breaker: stop asking an endpoint that keeps failing. Pure; time is passed in."""

import math

OPEN_AFTER_FAILURES = 3
HALF_OPEN_AFTER_S = 10.0


class Breaker:
    """Count failures in a row; open after three, let one probe through every ten seconds.

    While it is open a call costs nothing, so a dead endpoint never delays an alarm.
    """

    def __init__(self) -> None:
        self._n_failures = 0
        self._retry_at_s = -math.inf
        self._is_probing = False
        self._is_locked = False

    @property
    def is_closed(self) -> bool:
        """Say whether calls pass freely."""
        return not self._is_locked and self._n_failures < OPEN_AFTER_FAILURES

    def allows(self, now_s: float) -> bool:
        """Say whether a call may start now, and count it as the probe when half open."""
        if self.is_closed:
            return True
        if self._is_locked or self._is_probing or now_s < self._retry_at_s:
            return False
        self._is_probing = True
        return True

    def succeed(self) -> None:
        """Note a call that reached the endpoint and came back whole."""
        self._n_failures = 0
        self._is_probing = False

    def fail(self, now_s: float) -> None:
        """Note a call that failed."""
        self._n_failures += 1
        self._is_probing = False
        self._retry_at_s = now_s + HALF_OPEN_AFTER_S

    def forget(self) -> None:
        """Note a call that was cancelled: it says nothing about the endpoint."""
        self._is_probing = False

    def lock(self) -> None:
        """Open for good: the key or the account is refused, only new settings can help."""
        self._is_locked = True
