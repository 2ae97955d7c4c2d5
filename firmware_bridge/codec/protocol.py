"""What every wire protocol offers the bus: frames out of intents, readings out of frames.

Positions are ticks, the protocol's own unit (pulses in us, or steps of a turn); radians live above
the bus. Everything here is a pure value or a pure function.
"""

import enum
from abc import ABC, abstractmethod
from typing import ClassVar, FrozenSet, NamedTuple, Sequence, Tuple

from firmware_bridge.codec.parser import Parser


class Quantity(enum.Enum):
    """What can be asked of a servo or a board, and the unit of the answer."""

    MODEL = "model"  # does it answer at all; model number, 0 where the protocol has none
    POSITION = "position"  # ticks, measured
    TARGET = "target"  # ticks, last commanded
    SPEED = "speed"  # ticks/s, signed
    LOAD = "load"  # per mille of the largest torque, signed
    CURRENT = "current"  # mA
    TEMPERATURE = "temperature"  # deg C
    VOLTAGE = "voltage"  # mV
    FLAGS = "flags"  # ServoFlag bits
    TORQUE = "torque"  # 1 on, 0 off
    LIMITS = "limits"  # ticks, lowest and highest that the servo itself allows
    OFFSET = "offset"  # ticks, kept in the servo


class ServoFlag(enum.IntFlag):
    """What a servo reports of its own state, the same bits for every protocol."""

    NONE = 0
    VOLTAGE = 1
    ANGLE = 2
    OVERHEAT = 4
    OVERCURRENT = 8
    STALL = 16  # overload: it cannot get where it should
    HARDWARE = 32


class ServoTarget(NamedTuple):
    """Where one servo shall go; ``ticks_s`` is the speed that arrives in time (0: not limited)."""

    servo_id: int
    ticks: int
    ticks_s: int = 0


class Query(NamedTuple):
    """One question on the wire: ``servo_ids`` must all answer; () asks the board itself.

    ``n_reply`` is how many bytes an undisturbed answer has in all.
    """

    frame: bytes
    quantity: Quantity
    servo_ids: Tuple[int, ...]
    n_reply: int


class Reply(NamedTuple):
    """One servo's answer: ``values`` in the unit of the quantity; ``flags`` it sent along.

    ``is_ok`` is false when a board answered that the servo did not.
    """

    servo_id: int
    values: Tuple[int, ...]
    flags: ServoFlag = ServoFlag.NONE
    is_ok: bool = True


class ServoProtocol(ABC):
    """One dialect. Stateless: parsers hold the state of a stream."""

    name: ClassVar[str]
    baud: ClassVar[int]
    ticks: ClassVar[Tuple[int, int]]  # lowest and highest position that can be commanded
    is_checked: ClassVar[bool]  # frames carry a checksum
    has_feedback: ClassVar[bool]  # positions can be measured
    acks_writes: ClassVar[bool] = False
    is_half_duplex: ClassVar[bool] = True  # an answer and a write at once destroy each other
    max_duration_ms: ClassVar[int] = 30000
    quantities: ClassVar[FrozenSet[Quantity]]

    @abstractmethod
    def parser(self) -> Parser:
        """Return a new parser of what servos or board send to the host."""

    @abstractmethod
    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return the frames that move all targets together.

        Raises
        ------
        ProtocolError : an id, position, speed or duration that no well-formed frame can carry.
        """

    @abstractmethod
    def stop(self, at: Sequence[ServoTarget]) -> Tuple[bytes, ...]:
        """Return the frames that stop the servos; ``at`` is where they stand now.

        Protocols with a stop command ignore the positions, the others command them.
        """

    @abstractmethod
    def torque(self, servo_ids: Sequence[int], is_on: bool) -> Tuple[bytes, ...]:
        """Return the frames that switch the torque; () where the protocol cannot."""

    @abstractmethod
    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return the frames that store position limits in a servo; () where it has none."""

    @abstractmethod
    def query(self, quantity: Quantity, servo_ids: Sequence[int]) -> Tuple[Query, ...]:
        """Return the questions that together ask for a quantity of all servos.

        Raises
        ------
        ProtocolError : the protocol does not know the quantity, or an id out of range.
        """

    @abstractmethod
    def match(self, query: Query, frame: bytes) -> Tuple[Reply, ...]:
        """Return what a frame says in answer to a query; () when it is no answer to it.

        Id, command and length must all fit; a stale or foreign frame is no answer.
        """

    def report(self, frame: bytes) -> Tuple[Tuple[Quantity, Reply], ...]:
        """Return what an unsolicited frame reports; () when it reports nothing known."""
        return ()
