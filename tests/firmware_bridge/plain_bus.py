"""A small complete protocol of the tests' own, its simulated servos, and a line in between."""

from typing import Callable, List, Optional

from firmware_bridge.codec.parser import Parser
from firmware_bridge.codec.protocol import (
    Quantity,
    Query,
    Reply,
    ServoFlag,
    ServoProtocol,
)
from firmware_bridge.errors import ProtocolError
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.direct_link import DirectLink
from firmware_bridge.simulator.servo import SimServo

POSITION, TARGET, MOVE, STOP, TEMPERATURE, BATTERY, LED = 1, 2, 3, 4, 5, 6, 7
_CODES = {
    Quantity.POSITION: POSITION,
    Quantity.TARGET: TARGET,
    Quantity.TEMPERATURE: TEMPERATURE,
    Quantity.VOLTAGE: BATTERY,
}
_REPLY = 0x80  # added to the command in an answer
BOARD_ID = 0


def frame(servo_id: int, command: int, data: bytes = b"") -> bytes:
    body = bytes((servo_id, len(data), command)) + data
    return b"\xa5" + body + bytes((~sum(body) & 0xFF,))


def number(value: int) -> bytes:
    return value.to_bytes(2, "little", signed=True)


def parser() -> Parser:
    def measure(buffer: bytearray, start: int) -> int:
        if start + 3 > len(buffer):
            return 0
        return 5 + buffer[start + 2] if buffer[start + 2] <= 8 else -1

    return Parser(b"\xa5", measure, lambda whole: ~sum(whole[1:-1]) & 0xFF == whole[-1])


class Plain(ServoProtocol):
    """``A5 ID LEN CMD P.. SUM``: with read-back of targets, and a battery that reports itself."""

    name = "plain"
    baud = 115200
    ticks = (0, 1000)
    is_checked = True
    has_feedback = True
    quantities = frozenset(_CODES)

    def parser(self):
        return parser()

    def move(self, targets, duration_ms):
        return tuple(
            frame(t.servo_id, MOVE, number(t.ticks) + number(duration_ms)) for t in targets
        )

    def stop(self, at):
        return tuple(frame(t.servo_id, STOP) for t in at)

    def torque(self, servo_ids, is_on):
        return ()

    def set_limits(self, servo_id, low, high):
        return ()

    def query(self, quantity, servo_ids):
        if quantity not in self.quantities:
            raise ProtocolError(f"{quantity} is not known")
        code = _CODES[quantity]
        ids = [(i, (i,)) for i in servo_ids] or [(BOARD_ID, ())]
        return tuple(Query(frame(i, code), quantity, asked, 7) for i, asked in ids)

    def match(self, query, frame):
        asked = query.servo_ids[0] if query.servo_ids else BOARD_ID
        if len(frame) != 7 or frame[1] != asked or frame[3] != _CODES[query.quantity] | _REPLY:
            return ()
        value = int.from_bytes(frame[4:6], "little", signed=True)
        return (Reply(frame[1], (value,), ServoFlag.NONE),)

    def report(self, frame):
        if len(frame) != 7 or frame[3] != BATTERY | _REPLY:
            return ()
        return ((Quantity.VOLTAGE, Reply(BOARD_ID, (int.from_bytes(frame[4:6], "little"),))),)


class PlainNoTarget(Plain):
    """The same without a read-back of targets."""

    quantities = frozenset({Quantity.POSITION})


class PlainBlind(Plain):
    """The same with nothing to read at all."""

    has_feedback = False
    quantities = frozenset({Quantity.VOLTAGE})


class PlainServos(Firmware):
    """Servos 1..n on one line; ``log`` holds each frame that came in whole."""

    def __init__(self, n_servos: int = 3) -> None:
        self.baud = 115200
        self.t_s = 0.0
        self.log: List[bytes] = []
        self.servos = {i: SimServo(i, 500, (0, 1000), 3000.0) for i in range(1, n_servos + 1)}
        self._parser = parser()
        self._out = bytearray()

    def say(self, data: bytes) -> None:
        self._out += data

    def feed(self, data: bytes) -> None:
        for whole in self._parser.feed(data) + self._parser.flush():
            self.log.append(whole)
            self._obey(whole[1], whole[3], whole[4:-1])

    def _obey(self, servo_id: int, command: int, data: bytes) -> None:
        if command == BATTERY:
            self.say(frame(BOARD_ID, BATTERY | _REPLY, number(7400)))
        servo = self.servos.get(servo_id)
        if servo is None:
            return
        if command == MOVE and len(data) == 4:
            servo.command(
                int.from_bytes(data[:2], "little"), int.from_bytes(data[2:], "little") / 1e3
            )
        elif command == STOP:
            servo.stop()
        elif command in (POSITION, TARGET, TEMPERATURE):
            values = {
                POSITION: servo.measured,
                TARGET: int(servo.target),
                TEMPERATURE: int(servo.temperature_c),
            }
            self.say(frame(servo_id, command | _REPLY, number(values[command])))

    def replies(self) -> bytes:
        out = bytes(self._out)
        self._out.clear()
        return out

    def step(self, dt_s: float) -> None:
        self.t_s += dt_s
        for servo in self.servos.values():
            servo.step(dt_s)


Answer = Callable[[bytes], Optional[bytes]]


class Line(DirectLink):
    """A direct link whose answers a test can change: ``answers`` are used up one by one.

    Each takes the true answer and returns what arrives; None in the list lets one through.
    """

    def __init__(self, servos: PlainServos) -> None:
        super().__init__(servos, self._inward, self._outward)
        self.servos = servos
        self.answers: List[Optional[Callable[[bytes], bytes]]] = []
        self.commands: List[Optional[Callable[[bytes], bytes]]] = []
        self.written: List[bytes] = []
        self.on_write: Callable[[bytes], None] = lambda data: None

    def write(self, data: bytes, n_reply: int = 0) -> None:
        super().write(data, n_reply)
        self.written.append(data)
        self.on_write(data)

    def clock(self) -> float:
        return self.servos.t_s

    def _inward(self, data: bytes) -> bytes:
        change = self.commands.pop(0) if self.commands else None
        return data if change is None else change(data)

    def _outward(self, data: bytes) -> bytes:
        change = self.answers.pop(0) if self.answers else None
        return data if change is None else change(data)
