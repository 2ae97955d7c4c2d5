"""The two dialects of the RRC board for the bus: its PWM servos, and its bus servos."""

from typing import ClassVar, Dict, FrozenSet, Sequence, Tuple

from firmware_bridge.codec import rrc
from firmware_bridge.codec.parser import Parser
from firmware_bridge.codec.protocol import Quantity, Query, Reply, ServoProtocol, ServoTarget
from firmware_bridge.codec.ranges import require
from firmware_bridge.codec.rrc_frames import BAUD, host_parser
from firmware_bridge.errors import ProtocolError

_PULSE_MS = 20  # one PWM period: the shortest move there is


class _Rrc(ServoProtocol):
    """What both share: the line, the parser and the pushed battery voltage."""

    baud = BAUD
    is_checked = True
    is_half_duplex = False  # a line for each way

    def parser(self) -> Parser:
        """Return a new parser of what the board sends."""
        return host_parser()

    def report(self, frame: bytes) -> Tuple[Tuple[Quantity, Reply], ...]:
        """Return the battery voltage that the board pushes, as of servo 0, the board."""
        try:
            message = rrc.decode_from_board(frame)
        except ProtocolError:
            return ()
        if isinstance(message, rrc.Battery):
            return ((Quantity.VOLTAGE, Reply(0, (message.millivolt,))),)
        return ()

    def _targets(self, targets: Sequence[ServoTarget]) -> rrc.Targets:
        for target in targets:
            require("position", target.ticks, *self.ticks)
        return tuple((target.servo_id, target.ticks) for target in targets)


class RrcPwm(_Rrc):
    """PWM servos: pulses in us. The board tells what it last commanded; nothing is measured.

    The battery voltage comes by ``report``; the board cannot be asked for it.
    """

    name = "rrc"
    ticks = (500, 2500)
    has_feedback = False
    quantities: ClassVar[FrozenSet[Quantity]] = frozenset(
        (Quantity.MODEL, Quantity.TARGET, Quantity.OFFSET)
    )

    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return the one frame that moves all.

        Raises
        ------
        ProtocolError : an id, pulse or duration out of range.
        """
        return (rrc.encode(rrc.PwmMove(duration_ms, self._targets(targets))),)

    def stop(self, at: Sequence[ServoTarget]) -> Tuple[bytes, ...]:
        """Return the frame that holds every servo where it is believed to stand."""
        low, high = self.ticks
        held = [t._replace(ticks=min(max(t.ticks, low), high)) for t in at]
        return self.move(held, _PULSE_MS) if held else ()

    def torque(self, servo_ids: Sequence[int], is_on: bool) -> Tuple[bytes, ...]:
        """Return nothing: PWM servos hold while they get pulses."""
        return ()

    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return nothing: PWM servos have no limits."""
        return ()

    def query(self, quantity: Quantity, servo_ids: Sequence[int]) -> Tuple[Query, ...]:
        """Return one question per servo.

        Raises
        ------
        ProtocolError : a quantity that the board does not tell, or an id out of range.
        """
        if quantity not in self.quantities:
            raise ProtocolError(f"an RRC board does not tell the {quantity.value} of PWM servos")
        if quantity is Quantity.OFFSET:
            frames = [rrc.encode(rrc.PwmOffsetRequest(i)) for i in servo_ids]
            return tuple(Query(f, quantity, (i,), 8) for i, f in zip(servo_ids, frames))
        frames = [rrc.encode(rrc.PwmPositionRequest(i)) for i in servo_ids]
        return tuple(Query(f, quantity, (i,), 9) for i, f in zip(servo_ids, frames))

    def match(self, query: Query, frame: bytes) -> Tuple[Reply, ...]:
        """Return the answer when id, sub-command and length fit."""
        try:
            message = rrc.decode_from_board(frame)
        except ProtocolError:
            return ()
        if isinstance(message, rrc.PwmOffsetReply) and query.quantity is Quantity.OFFSET:
            value = message.offset_us
        elif isinstance(message, rrc.PwmPosition) and query.quantity is not Quantity.OFFSET:
            value = message.pulse_us if query.quantity is Quantity.TARGET else 0
        else:
            return ()
        return (
            (Reply(message.servo_id, (value,)),) if query.servo_ids == (message.servo_id,) else ()
        )


_READS: Dict[Quantity, int] = {
    Quantity.MODEL: rrc.BUS_ID,
    Quantity.POSITION: rrc.BUS_POSITION,
    Quantity.VOLTAGE: rrc.BUS_VIN,
    Quantity.TEMPERATURE: rrc.BUS_TEMPERATURE,
    Quantity.TORQUE: rrc.BUS_TORQUE,
    Quantity.LIMITS: rrc.BUS_LIMITS,
    Quantity.OFFSET: rrc.BUS_OFFSET,
}
_N_REPLY = {what: 8 + {"<h": 2, "<H": 2, "<HH": 4}.get(c, 1) for what, c in rrc.BUS_READS.items()}
_RANGES: Dict[Quantity, Tuple[int, int]] = {
    Quantity.POSITION: (-500, 1500),  # the shaft can be turned beyond what can be commanded
    Quantity.VOLTAGE: (0, 20000),
    Quantity.TEMPERATURE: (0, 150),
    Quantity.TORQUE: (0, 1),
    Quantity.LIMITS: (0, 1000),
    Quantity.OFFSET: (-125, 125),
}


class RrcBus(_Rrc):
    """LX servos behind an RRC board: positions 0..1000 of 240 degrees, measured.

    ``Reply.is_ok`` is false when the servo did not answer the board.
    """

    name = "rrc-bus"
    ticks = (0, 1000)
    has_feedback = True
    quantities: ClassVar[FrozenSet[Quantity]] = frozenset(_READS)

    def move(self, targets: Sequence[ServoTarget], duration_ms: int) -> Tuple[bytes, ...]:
        """Return the one frame that moves all.

        Raises
        ------
        ProtocolError : an id, position or duration out of range.
        """
        return (rrc.encode(rrc.BusMove(duration_ms, self._targets(targets))),)

    def stop(self, at: Sequence[ServoTarget]) -> Tuple[bytes, ...]:
        """Return the frame that stops the servos; where they stand does not matter."""
        return (rrc.encode(rrc.BusStop(tuple(t.servo_id for t in at))),) if at else ()

    def torque(self, servo_ids: Sequence[int], is_on: bool) -> Tuple[bytes, ...]:
        """Return one frame per servo."""
        return tuple(rrc.encode(rrc.BusTorque(i, is_on)) for i in servo_ids)

    def set_limits(self, servo_id: int, low: int, high: int) -> Tuple[bytes, ...]:
        """Return the frame that stores position limits in a servo."""
        return (rrc.encode(rrc.BusLimits(servo_id, low, high)),)

    def query(self, quantity: Quantity, servo_ids: Sequence[int]) -> Tuple[Query, ...]:
        """Return one question per servo.

        Raises
        ------
        ProtocolError : a quantity that the board does not tell, or an id out of range.
        """
        what = _READS.get(quantity)
        if what is None:
            raise ProtocolError(f"an RRC board does not tell the {quantity.value} of bus servos")
        frames = [rrc.encode(rrc.BusRead(i, what)) for i in servo_ids]
        return tuple(Query(f, quantity, (i,), _N_REPLY[what]) for i, f in zip(servo_ids, frames))

    def match(self, query: Query, frame: bytes) -> Tuple[Reply, ...]:
        """Return the answer when id, sub-command, length and range all fit."""
        try:
            message = rrc.decode_from_board(frame)
        except ProtocolError:
            return ()
        if not isinstance(message, rrc.BusReply) or message.what != _READS[query.quantity]:
            return ()
        servo_id, _, is_ok, values = message
        if (servo_id,) != query.servo_ids:
            return ()
        if not is_ok:
            return (Reply(servo_id, values, is_ok=False),)
        if query.quantity is Quantity.MODEL:
            return (Reply(servo_id, (0,)),) if values == query.servo_ids else ()
        low, high = _RANGES[query.quantity]
        return (Reply(servo_id, values),) if low <= min(values) and max(values) <= high else ()
