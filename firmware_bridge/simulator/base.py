"""What every simulated firmware offers the pseudo-terminal that carries its bytes."""

from abc import ABC, abstractmethod


class Firmware(ABC):
    """A board or a bus of servos: bytes in, bytes out, time passes by ``step`` alone.

    Pure: no clock, no I/O. ``t_s`` is the simulated time; ``baud`` paces the bytes; faults clear
    ``is_plugged`` while the plug is out.
    """

    baud: int
    t_s: float
    is_plugged: bool = True

    @abstractmethod
    def feed(self, data: bytes) -> None:
        """Take bytes from the wire, in any chunks."""

    @abstractmethod
    def replies(self) -> bytes:
        """Return and forget the bytes that have been sent."""

    @abstractmethod
    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass."""

    def listen(self, baud: int) -> bool:
        """Take the line to be at ``baud`` from now on; say whether anything here understands it."""
        return baud == self.baud
