"""What every link offers the bus: bytes out, bytes in, and one error for a link that is gone."""

from abc import ABC, abstractmethod


class Link(ABC):
    """A way to servos. ``n_bytes_out`` and ``n_bytes_in`` count what went over it.

    ``baud`` is 0 where the link does not take time per byte that the host has to know about.
    """

    def __init__(self, port: str, baud: int) -> None:
        self.port = port
        self.baud = baud
        self.n_bytes_out = 0
        self.n_bytes_in = 0

    @property
    @abstractmethod
    def is_open(self) -> bool:
        """Say whether the link is open; a lost one is closed."""

    @property
    def descriptor(self) -> int:
        """The open file behind the link, which another process can share; -1: there is none."""
        return -1

    def set_baud(self, baud: int) -> bool:
        """Go on at another baud rate; say whether this link can."""
        return False

    @abstractmethod
    def open(self) -> None:
        """Open it, for this program alone where the system can do that.

        Raises
        ------
        NoSuchPort, PortBusy, PortError : it cannot be opened, and why.
        """

    @abstractmethod
    def close(self) -> None:
        """Close it; safe to call at any time."""

    @abstractmethod
    def write(self, data: bytes, n_reply: int = 0) -> None:
        """Send one frame; ``n_reply`` bytes are expected back (a link that must ask needs that).

        Raises
        ------
        LinkLost : the link is closed, went away, or took no byte within the time-out.
        """

    def idle_in_s(self) -> float:
        """Return how long the bytes written so far still need to leave, 0 when the line is free.

        Who waits for 0 before a write never has more than one frame in the system's buffer.
        """
        return 0.0

    def mark_idle(self) -> None:
        """Say that all bytes written have arrived, as an answer to them proves."""
        return

    @abstractmethod
    def read_available(self) -> bytes:
        """Return the bytes that wait, without blocking.

        Raises
        ------
        LinkLost : the link is closed or went away.
        """

    @abstractmethod
    def wait_readable(self, timeout_s: float) -> None:
        """Return when bytes may wait or the time is over, whichever is first.

        Raises
        ------
        LinkLost : the link is closed or went away.
        """
