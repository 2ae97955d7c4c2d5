"""The I2C board of the Raspberry Pi 4 ArmPi mini, and a bus to reach it, all in this process.

``FakeI2cBus`` takes the calls that smbus2.SMBus takes, with smbus2's messages or with ``Message``.
Seeded faults: garbled voltages, transactions not acknowledged, a bus that is gone.
Source: vendor library; the garbled values and error 121 from a public test of it.
"""

import errno
import os
import random
from typing import Any, Dict, Iterator, List, NamedTuple, Sequence, Tuple, Union

from firmware_bridge.codec import i2c
from firmware_bridge.errors import ProtocolError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.servo import SimServo

GARBLED_MV = (65470, 231)
_READ = 1  # the flag of a message that reads
_PULSES, _DURATION_MS = (500, 2500), 30000
_US_PER_DEG = 2000.0 / 180.0


class I2cBoard(Firmware):
    """The board's firmware: one ``feed`` is one write transaction.

    It does what the real one does: moves the servos it has, keeps pulses within 500..2500 us and
    durations up to 30 s, checks nothing else and never speaks by itself. ``commanded`` is the last
    pulse per servo. Counts: ``n_frames``, ``n_rejected``, ``n_clamped``.
    """

    def __init__(self, servos: Sequence[SimServo], battery_mv: int = 7400) -> None:
        self.servos = list(servos)
        self.battery_mv = battery_mv
        self.baud = i2c.I2cPwm.baud
        self.t_s = 0.0
        self.motors: Dict[int, int] = {}
        self.commanded: Dict[int, int] = {}
        self.n_frames = self.n_rejected = self.n_clamped = 0
        self._answer = b""

    def feed(self, data: bytes) -> None:
        """Take one write transaction."""
        try:
            message = i2c.decode_to_board(data)
        except ProtocolError:
            self.n_rejected += 1
            return
        self.n_frames += 1
        if isinstance(message, i2c.Move):
            for servo_id, pulse_us in message.targets:
                self._go(servo_id, pulse_us, min(message.duration_ms, _DURATION_MS))
        elif isinstance(message, i2c.Angle):
            pulse_us = int(round(_PULSES[0] + message.angle_deg * _US_PER_DEG))
            self._go(message.servo_id, pulse_us, 0)
        elif isinstance(message, i2c.Motor):
            self.motors[message.motor_id] = min(max(message.percent, -100), 100)
        else:
            self._answer = i2c.encode(i2c.Battery(self.battery_mv))

    def replies(self) -> bytes:
        """Return and forget what a read would fetch."""
        data, self._answer = self._answer, b""
        return data

    def step(self, dt_s: float) -> None:
        """Let ``dt_s`` seconds pass."""
        self.t_s += dt_s
        for servo in self.servos:
            servo.step(dt_s)

    def _go(self, servo_id: int, pulse_us: int, duration_ms: int) -> None:
        low, high = _PULSES
        kept_us = min(max(pulse_us, low), high)
        self.n_clamped += kept_us != pulse_us
        for servo in self.servos:
            if servo.servo_id == servo_id:
                servo.command(kept_us, duration_ms / 1000.0)
                self.commanded[servo_id] = kept_us


class Message:
    """A message as smbus2's ``i2c_msg``: made by ``write`` or ``read``, iterates over its bytes."""

    def __init__(self, addr: int, flags: int, data: Sequence[int]) -> None:
        self.addr, self.flags, self.len = addr, flags, len(data)
        self.buf: List[int] = list(data)

    @classmethod
    def write(cls, address: int, buf: Sequence[int]) -> "Message":
        """Make a message that writes."""
        return cls(address, 0, buf)

    @classmethod
    def read(cls, address: int, length: int) -> "Message":
        """Make a message that reads."""
        return cls(address, _READ, [0] * length)

    def __iter__(self) -> Iterator[int]:
        return iter(self.buf)


class I2cFaults(NamedTuple):
    """How likely a transaction fails: voltage garbled, not acknowledged, broken off."""

    garbled: float = 0.0
    no_acknowledge: float = 0.0
    broken_off: float = 0.0


class FakeI2cBus:
    """One bus with one board. ``is_gone`` takes the whole bus away, ``is_unplugged`` the board.

    Parameters
    ----------
    board : its firmware; simulated time passes by ``board.step`` alone.
    faults : how likely what fails.
    seed : of all chance.
    number : of the bus; another one is not there.
    """

    def __init__(
        self,
        board: I2cBoard,
        faults: I2cFaults = I2cFaults(),  # noqa: B008 - a value that cannot change
        seed: int = 0,
        number: int = 1,
    ) -> None:
        self.board = board
        self.faults = faults
        self.number = number
        self.is_gone = self.is_unplugged = False
        self.is_open = False
        self.n_transfers = 0
        self._rng = random.Random(seed)
        self._answer = b""

    def opener(self, bus: Union[int, str]) -> Tuple["FakeI2cBus", Any]:
        """Open it as an ``I2cLink`` asks for.

        Raises
        ------
        OSError : no such bus (2).
        """
        if self.is_gone or bus not in (self.number, f"/dev/i2c-{self.number}"):
            raise _os_error(errno.ENOENT)
        self.is_open = True
        return self, Message

    def i2c_rdwr(self, *messages: Any) -> None:
        """Carry out messages, smbus2's or ``Message``, in one transaction.

        Raises
        ------
        OSError : bus gone (19), not acknowledged (121), broken off (5), closed (9).
        """
        if not self.is_open:
            raise _os_error(errno.EBADF)
        for message in messages:
            self._transfer(message)

    def close(self) -> None:
        """Close it."""
        self.is_open = False

    def _transfer(self, message: Any) -> None:
        self.n_transfers += 1
        if self.is_gone:
            raise _os_error(errno.ENODEV)
        chance = self._rng.random()
        if self.is_unplugged or message.addr != i2c.ADDRESS or chance < self.faults.no_acknowledge:
            raise _os_error(errno.EREMOTEIO)
        if chance < self.faults.no_acknowledge + self.faults.broken_off:
            raise _os_error(errno.EIO)
        if not message.flags & _READ:
            self.board.feed(bytes(list(message)))  # a ctypes structure is no buffer of its bytes
            self._answer = self.board.replies() or self._answer
            return
        data = self._answer
        if data and self._rng.random() < self.faults.garbled:
            data = i2c.encode(i2c.Battery(self._rng.choice(GARBLED_MV)))
        for at in range(message.len):  # a board that has nothing to say leaves the line high
            message.buf[at] = data[at] if at < len(data) else 0xFF


def _os_error(number: int) -> OSError:
    return OSError(number, os.strerror(number))
