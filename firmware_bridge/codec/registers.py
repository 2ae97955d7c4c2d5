"""Servos that are a table of registers (Feetech, Dynamixel): the host's side they have in common.

A dialect brings its table and its frames; questions and answers are the same for both. All writes
are sync-writes: no servo acknowledges those, so nothing collides with the host's next frame on a
half-duplex line. Source: ours.
"""

from abc import abstractmethod
from typing import ClassVar, FrozenSet, List, Mapping, NamedTuple, Sequence, Tuple

from firmware_bridge.codec.protocol import (
    Quantity,
    Query,
    Reply,
    ServoFlag,
    ServoProtocol,
    ServoTarget,
)
from firmware_bridge.codec.ranges import require
from firmware_bridge.errors import ProtocolError

TWOS = -1  # Register.sign_bit of a two's complement


class Register(NamedTuple):
    """One entry of a register table, little endian.

    ``sign_bit`` is 0 for an unsigned value, the number of the sign's bit for a sign-magnitude one
    and ``TWOS`` for a two's complement.
    """

    address: int
    n_bytes: int
    sign_bit: int = 0
    default: int = 0
    is_writable: bool = True

    @property
    def end(self) -> int:
        """Address behind it."""
        return self.address + self.n_bytes

    def pack(self, value: int) -> bytes:
        """Return the bytes of a value.

        Raises
        ------
        ProtocolError : the register cannot hold it.
        """
        low, high = self.range
        require(f"register {self.address}", value, low, high)
        if self.sign_bit == TWOS:
            return value.to_bytes(self.n_bytes, "little", signed=True)
        if value < 0:
            value = -value | 1 << self.sign_bit
        return value.to_bytes(self.n_bytes, "little")

    def unpack(self, data: bytes) -> int:
        """Return the value of its ``n_bytes`` bytes."""
        if self.sign_bit == TWOS:
            return int.from_bytes(data, "little", signed=True)
        value = int.from_bytes(data, "little")
        if self.sign_bit and value >> self.sign_bit & 1:
            return -(value & ~(1 << self.sign_bit))
        return value

    @property
    def range(self) -> Tuple[int, int]:
        """Lowest and highest value it holds."""
        n_bits = 8 * self.n_bytes
        if self.sign_bit == TWOS:
            return -(1 << (n_bits - 1)), (1 << (n_bits - 1)) - 1
        if self.sign_bit:
            return 1 - (1 << self.sign_bit), (1 << self.sign_bit) - 1
        return 0, (1 << n_bits) - 1


class Ask(NamedTuple):
    """Which registers tell a quantity, in the order of its values, and the unit of one step."""

    registers: Tuple[Register, ...]
    scale: float = 1.0

    @property
    def address(self) -> int:
        """Where to start reading."""
        return min(register.address for register in self.registers)

    @property
    def n_bytes(self) -> int:
        """How many bytes to read."""
        return max(register.end for register in self.registers) - self.address

    def values(self, data: bytes) -> Tuple[int, ...]:
        """Return the values that ``n_bytes`` bytes from ``address`` on say."""
        found = []
        for register in self.registers:
            at = register.address - self.address
            raw = register.unpack(data[at : at + register.n_bytes])
            found.append(int(round(raw * self.scale)))
        return tuple(found)


class Answer(NamedTuple):
    """What a status frame says, whatever the dialect; ``is_ok`` false: the servo refused."""

    servo_id: int
    data: bytes
    flags: ServoFlag
    is_ok: bool


class RegisterProtocol(ServoProtocol):
    """Questions and answers of a servo that is a table of registers."""

    asks: ClassVar[Mapping[Quantity, Ask]]
    flag_bits: ClassVar[Mapping[int, ServoFlag]]  # bit value of the state register -> flag
    torque_register: ClassVar[Register]
    max_id: ClassVar[int]
    n_status: ClassVar[int]  # bytes of a status frame around its data
    max_sync: ClassVar[int] = 30  # servos in one sync frame
    has_feedback = True
    is_checked = True
    acks_writes = False  # see the module: sync-writes only

    @abstractmethod
    def read_frame(self, servo_ids: Sequence[int], address: int, n_bytes: int) -> bytes:
        """Return the frame that reads registers of one servo, or of several in turn."""

    @abstractmethod
    def write_frame(self, address: int, items: Sequence[Tuple[int, bytes]]) -> bytes:
        """Return the sync-write of (id, bytes) items, all of one length."""

    @abstractmethod
    def answer(self, frame: bytes) -> Answer:
        """Read a checked status frame.

        Raises
        ------
        ProtocolError : it is none.
        """

    @classmethod
    def flags_of(cls, bits: int) -> ServoFlag:
        """Return the flags of a state register; unknown bits become HARDWARE."""
        flags = ServoFlag.NONE
        for value in (1, 2, 4, 8, 16, 32, 64, 128):
            if bits & value:
                flags |= cls.flag_bits.get(value, ServoFlag.HARDWARE)
        return flags

    def write_frames(self, address: int, items: Sequence[Tuple[int, bytes]]) -> Tuple[bytes, ...]:
        """Return as few sync-writes as the items need.

        Raises
        ------
        ProtocolError : no item, an id twice or out of range.
        """
        self.check_ids([servo_id for servo_id, _ in items])
        parts = range(0, len(items), self.max_sync)
        return tuple(self.write_frame(address, items[at : at + self.max_sync]) for at in parts)

    def stop(self, at: Sequence[ServoTarget]) -> Tuple[bytes, ...]:
        """Return the sync-write that makes the given positions the goals, at full speed.

        A servo may stand outside what can be commanded; the nearest goal is sent then.
        """
        low, high = self.ticks
        held = [ServoTarget(one.servo_id, min(max(one.ticks, low), high)) for one in at]
        return self.move(held, 0)

    def torque(self, servo_ids: Sequence[int], is_on: bool) -> Tuple[bytes, ...]:
        """Return the sync-write that switches the torque."""
        items = [(servo_id, bytes((bool(is_on),))) for servo_id in servo_ids]
        return self.write_frames(self.torque_register.address, items)

    def query(self, quantity: Quantity, servo_ids: Sequence[int]) -> Tuple[Query, ...]:
        """Return a read for one servo, sync-reads for several.

        Raises
        ------
        ProtocolError : the protocol does not know the quantity, or an id twice or out of range.
        """
        if quantity not in self.asks:
            raise ProtocolError(f"{self.name} cannot be asked for {quantity.value}")
        self.check_ids(servo_ids)
        ask = self.asks[quantity]
        queries: List[Query] = []
        for at in range(0, len(servo_ids), self.max_sync):
            ids = tuple(servo_ids[at : at + self.max_sync])
            frame = self.read_frame(ids, ask.address, ask.n_bytes)
            queries.append(Query(frame, quantity, ids, len(ids) * (self.n_status + ask.n_bytes)))
        return tuple(queries)

    def match(self, query: Query, frame: bytes) -> Tuple[Reply, ...]:
        """Return the answer of one servo; () for a foreign id or a length that does not fit."""
        try:
            answer = self.answer(frame)
        except ProtocolError:
            return ()
        ask = self.asks[query.quantity]
        if answer.servo_id not in query.servo_ids:
            return ()
        if not answer.is_ok and not answer.data:
            return (Reply(answer.servo_id, (), answer.flags, False),)
        if not answer.is_ok or len(answer.data) != ask.n_bytes:
            return ()
        values = ask.values(answer.data)
        if query.quantity is Quantity.FLAGS:
            values = (int(self.flags_of(values[0])),)
        return (Reply(answer.servo_id, values, answer.flags),)

    @classmethod
    def check_ids(cls, servo_ids: Sequence[int]) -> None:
        """Refuse an empty list, an id twice or out of range.

        Raises
        ------
        ProtocolError : what is wrong with it.
        """
        check_ids(servo_ids, cls.max_id)


def quantities(asks: Mapping[Quantity, Ask]) -> FrozenSet[Quantity]:
    """Return what a table of questions can ask."""
    return frozenset(asks)


def check_ids(servo_ids: Sequence[int], max_id: int) -> None:
    """Refuse an empty list, an id twice or out of range.

    Raises
    ------
    ProtocolError : what is wrong with it.
    """
    if not servo_ids:
        raise ProtocolError("no servo is named")
    for servo_id in servo_ids:
        require("servo id", servo_id, 0, max_id)
    if len(set(servo_ids)) != len(servo_ids):
        raise ProtocolError(f"a servo is named twice: {list(servo_ids)}")
