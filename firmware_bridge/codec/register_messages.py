"""What is said to servos that are tables of registers: the same words in STS and Dynamixel 2.0."""

from typing import NamedTuple, Tuple

BROADCAST = 0xFE


class Ping(NamedTuple):
    """Ask a servo (Dynamixel: or all) to answer."""

    servo_id: int


class Read(NamedTuple):
    """Read ``n_bytes`` registers from ``address`` on."""

    servo_id: int
    address: int
    n_bytes: int


class Write(NamedTuple):
    """Write registers of one servo, or of all (0xFE)."""

    servo_id: int
    address: int
    data: bytes


class RegWrite(NamedTuple):
    """Write registers when the next ``Action`` comes."""

    servo_id: int
    address: int
    data: bytes


class Action(NamedTuple):
    """Carry out what was prepared."""

    servo_id: int = BROADCAST


class SyncRead(NamedTuple):
    """Read the same registers of several servos; they answer in turn."""

    address: int
    n_bytes: int
    servo_ids: Tuple[int, ...]


class SyncWrite(NamedTuple):
    """Write the same registers of several servos: (id, bytes), all of one length."""

    address: int
    items: Tuple[Tuple[int, bytes], ...]


class Status(NamedTuple):
    """What a servo answers: its error bits or number, and the registers asked for."""

    servo_id: int
    error: int
    data: bytes = b""
