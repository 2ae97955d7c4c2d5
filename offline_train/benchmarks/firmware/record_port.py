"""A port for the vendors' libraries that keeps what they send and never answers."""

from typing import Iterable, List


class RecordPort:
    """Take the calls of a ``PortHandler``; ``taken`` returns what was sent since."""

    def __init__(self) -> None:
        self.is_using = False
        self.baudrate = 1_000_000
        self._sent: List[int] = []

    def taken(self) -> bytes:
        """Return and forget the bytes sent."""
        data = bytes(self._sent)
        self._sent.clear()
        return data

    def writePort(self, packet: Iterable[int]) -> int:  # noqa: N802 - the name they call
        """Keep the bytes of one packet."""
        before = len(self._sent)
        self._sent.extend(packet)
        return len(self._sent) - before

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Return nothing: there is no servo."""
        return b""

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """Say that the time is over, so that nobody waits."""
        return True

    def clearPort(self) -> None:  # noqa: N802
        """Have nothing to clear."""

    def setPacketTimeout(self, n_bytes: int) -> None:  # noqa: N802
        """Have no time-out."""

    def setPacketTimeoutMillis(self, msec: float) -> None:  # noqa: N802
        """Have no time-out."""

    def getBaudRate(self) -> int:  # noqa: N802
        """Return a baud rate."""
        return self.baudrate
