"""Take a host's own bytes back out of what it receives.

Cheap half-duplex adapters loop every sent byte back. Whether one does is learned from the first
frames after connecting: nothing a servo answers repeats the question.
Source: ours.
"""

from typing import Optional

_N_SILENT = 2  # frames in a row whose bytes did not come back, until the adapter counts as quiet

_MOST_AWAITED = 4096


class EchoFilter:
    """Strip own bytes by content; ``has_echo`` is None until that is known."""

    def __init__(self) -> None:
        self.has_echo: Optional[bool] = None
        self._awaited = bytearray()
        self._held = bytearray()  # received, equal to the start of what is awaited
        self._n_silent = 0

    def sent(self, data: bytes) -> None:
        """Note a frame that was written."""
        if len(self._awaited) > _MOST_AWAITED:  # nobody reads, and the system's buffer ran over
            self._awaited.clear()
            self._held.clear()
        if self.has_echo is not False:
            self._awaited += data

    def strip(self, data: bytes) -> bytes:
        """Return what of the received bytes is not an echo.

        The start of an answer that looks like an echo is held back until it differs.
        """
        if self.has_echo is False or not self._awaited or not data:
            return data
        received = bytes(self._held + data)
        self._held.clear()
        n_same = _n_common(received, self._awaited)
        if n_same == len(self._awaited):
            self.has_echo = True
            self._awaited.clear()
            return received[n_same:]
        if n_same == len(received):
            self._held += received
            return b""
        return self._differs(received)

    def _differs(self, received: bytes) -> bytes:
        """Find a whole echo behind stray bytes; else let everything through."""
        at = received.find(bytes(self._awaited))
        if at >= 0 and self.has_echo:
            received = received[:at] + received[at + len(self._awaited) :]
            self._awaited.clear()
            return received
        if self.has_echo is None:
            self._n_silent += 1
            if self._n_silent >= _N_SILENT:
                self.has_echo = False
        self._awaited.clear()
        return received


def _n_common(one: bytes, other: bytes) -> int:
    n_most = min(len(one), len(other))
    for at in range(n_most):
        if one[at] != other[at]:
            return at
    return n_most
