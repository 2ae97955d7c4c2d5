"""What every simulated firmware offers the pseudo-terminal that carries its bytes."""

from abc import ABC, abstractmethod


class Firmware(ABC):
    """A board or a bus of servos: bytes in, bytes out, time passes by ``step`` alone.

    Pure: no clock, no I/O. ``t_s`` is the simulated time; ``baud`` paces the bytes.
    """

    baud: int
    t_s: float

    @abstractmethod
    def feed(self, data: bytes) -> None:
        """Take bytes from the wire, in any chunks."""

    @abstractmethod
    def replies(self) -> bytes:
        """Return and forget the bytes that have been sent."""

    @abstractmethod
    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass."""
