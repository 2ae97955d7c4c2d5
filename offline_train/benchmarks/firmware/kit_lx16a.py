"""LX bus servos under test, beside lewansoul-lx16a and pylx16a."""

import random
from typing import Any, Dict, List, Optional, Sequence, Tuple

from firmware_bridge.codec import lx
from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.lx_bus import LxBus
from firmware_bridge.simulator.servo import SimServo
from offline_train.benchmarks.firmware import peers
from offline_train.benchmarks.firmware.kit import Kit, Vector

LIMITS = (200, 800)
_M = lx.Message
_COMMANDS: Tuple[Tuple[str, lx.Message, str], ...] = (
    ("id 1 to 500 in 1000 ms", _M(1, 1, (500, 1000)), "55 55 01 07 01 F4 01 E8 03 16"),
    ("id 6 to 1000 in 30000 ms", _M(6, 1, (1000, 30000)), "55 55 06 07 01 E8 03 30 75 61"),
    ("prepare id 2", _M(2, 7, (250, 500)), "55 55 02 07 07 FA 00 F4 01 00"),
    ("start all", _M(254, 11), "55 55 FE 03 0B F3"),
    ("stop id 3", _M(3, 12), "55 55 03 03 0C ED"),
    ("offset id 4 -10", _M(4, 17, (-10,)), "55 55 04 04 11 F6 F0"),
    ("limits id 5 100..900", _M(5, 20, (100, 900)), "55 55 05 07 14 64 00 84 03 F4"),
    ("id 1 becomes 7", _M(1, 13, (7,)), "55 55 01 04 0D 07 E6"),
    ("torque off id 1", _M(1, 31, (0,)), "55 55 01 04 1F 00 DB"),
    ("torque on id 1", _M(1, 31, (1,)), "55 55 01 04 1F 01 DA"),
    ("ask position", _M(1, 28), "55 55 01 03 1C DF"),
    ("ask temperature", _M(1, 26), "55 55 01 03 1A E1"),
    ("ask supply", _M(1, 27), "55 55 01 03 1B E0"),
)
_REPLIES: Tuple[Tuple[str, lx.Message, str], ...] = (
    ("position 500", _M(1, 28, (500,)), "55 55 01 05 1C F4 01 E8"),
    ("position -12", _M(1, 28, (-12,)), "55 55 01 05 1C F4 FF EA"),
    ("35 C", _M(1, 26, (35,)), "55 55 01 04 1A 23 BD"),
    ("7400 mV", _M(1, 27, (7400,)), "55 55 01 05 1B E8 1C DA"),
)
# command -> the call of lewansoul-lx16a that sends it
_CALLS = {
    lx.MOVE_TIME_WRITE: "move",
    lx.MOVE_TIME_WAIT_WRITE: "move_prepare",
    lx.MOVE_START: "move_start",
    lx.MOVE_STOP: "move_stop",
    lx.ID_WRITE: "set_servo_id",
    lx.OFFSET_ADJUST: "set_position_offset",
    lx.OFFSET_WRITE: "save_position_offset",
    lx.ANGLE_LIMIT_WRITE: "set_position_limits",
    lx.VIN_LIMIT_WRITE: "set_voltage_limits",
    lx.TEMP_MAX_WRITE: "set_max_temperature_limit",
    lx.LED_ERROR_WRITE: "set_led_errors",
}
_PAIRS = (lx.ANGLE_LIMIT_WRITE, lx.ANGLE_LIMIT_READ, lx.VIN_LIMIT_WRITE, lx.VIN_LIMIT_READ)


class _Line:
    """Keep what a library writes."""

    def __init__(self) -> None:
        self.sent = b""

    def write(self, data: bytes) -> None:
        self.sent += bytes(data)

    def taken(self) -> bytes:
        sent, self.sent = self.sent, b""
        return sent


class _Peers:
    """The two libraries, each on a line that only listens."""

    def __init__(self) -> None:
        self.line = _Line()
        self.controller: Any = None
        self.pylx: Any = None
        lewansoul = peers.load("lewansoul-lx16a", "lewansoul_lx16a")
        if lewansoul is not None:
            self.controller = lewansoul.ServoController(self.line)
        found = peers.load("pylx16a", "pylx16a.lx16a")
        if found is not None:
            self.pylx = found.LX16A

    def sends(self, message: lx.Message) -> Optional[bytes]:
        """Return what lewansoul-lx16a sends for a message."""
        if self.controller is None:
            return None
        servo_id, command, values = message
        if command in _CALLS:
            getattr(self.controller, _CALLS[command])(servo_id, *values)
        elif command == lx.TORQUE_WRITE:
            (self.controller.motor_on if values[0] else self.controller.motor_off)(servo_id)
        elif command == lx.LED_WRITE:
            (self.controller.led_off if values[0] else self.controller.led_on)(servo_id)
        elif command == lx.MODE_WRITE and values[0]:
            self.controller.set_motor_mode(servo_id, values[2])
        elif command == lx.MODE_WRITE:
            self.controller.set_servo_mode(servo_id)
        else:  # its questions wait for an answer, so only what they send first
            self.controller._command(servo_id, command)
        return self.line.taken()

    def frames(self, frame: bytes) -> Optional[bytes]:
        """Return the frame that pylx16a makes of the same id, length, command and parameters."""
        if self.pylx is None:
            return None
        self.pylx._controller = self.line
        self.pylx._send_packet(list(frame[2:-1]))
        self.pylx._controller = None
        return self.line.taken()


_LOADED: List[_Peers] = []


def _peers() -> _Peers:
    if not _LOADED:
        _LOADED.append(_Peers())
    return _LOADED[0]


def vectors() -> Sequence[Vector]:
    """Return the published frames beside ours, and pylx16a's beside both."""
    cases = [Vector(w, lx.encode_command(m), bytes.fromhex(t)) for w, m, t in _COMMANDS]
    cases += [Vector(w, lx.encode_reply(m), bytes.fromhex(t)) for w, m, t in _REPLIES]
    for case in tuple(cases):
        framed = _peers().frames(case.expected)
        if framed is not None:
            cases.append(Vector(f"{case.what}, pylx16a", case.ours, framed))
    return cases


def random_command(rng: random.Random) -> Tuple[bytes, Optional[bytes]]:
    """Return our bytes of any command and those of one of the libraries."""
    message = _random(rng, lx.COMMANDS, lx.BROADCAST)
    if message.command == lx.MODE_WRITE and not message.values[0]:
        message = message._replace(values=(0, 0, 0))  # the peer knows no speed without the mode
    ours = lx.encode_command(message)
    if _peers().pylx is not None and rng.random() < 0.2:
        return ours, _peers().frames(ours)
    return ours, _peers().sends(message)


def round_trip(rng: random.Random) -> bool:
    """Say whether a random message of either direction comes back as it was."""
    if rng.random() < 0.5:
        message = _random(rng, lx.COMMANDS, lx.BROADCAST)
        frames = lx.device_parser().feed(lx.encode_command(message))
        return [lx.decode_command(frame) for frame in frames] == [message]
    message = _random(rng, lx.REPLIES, lx.MAX_ID)
    frames = lx.host_parser().feed(lx.encode_reply(message))
    return [lx.decode_reply(frame) for frame in frames] == [message]


def random_reply(rng: random.Random) -> bytes:
    """Return a well-formed frame to the host."""
    return lx.encode_reply(_random(rng, lx.REPLIES, lx.MAX_ID))


def device() -> Firmware:
    """Make six servos with limits."""
    bus = LxBus([SimServo(one, 500, (0, 1000), 3000.0) for one in range(1, 7)])
    for member in bus.members:
        member.set_limits(*LIMITS)
    return bus


def executed(firmware: Firmware) -> Dict[int, int]:
    """Return the target each servo last set out for."""
    assert isinstance(firmware, LxBus)
    return firmware.commanded


def _random(rng: random.Random, table: Dict[int, "lx.Layout"], max_id: int) -> lx.Message:
    command = rng.choice(list(table))
    values = [rng.randint(field.low, field.high) for field in table[command].fields]
    if command in _PAIRS and values:
        low, high = sorted(values)
        values = [low, high] if low < high else [low - 1, high] if low > 0 else [low, high + 1]
    if command in (lx.VIN_LIMIT_WRITE, lx.VIN_LIMIT_READ) and values and values[0] < 4500:
        values = [4500, 4501]
    return lx.Message(rng.randint(0, max_id), command, tuple(values))


KIT = Kit(
    name="lx16a",
    peer="lewansoul-lx16a, pylx16a",
    vectors=vectors,
    random_command=random_command,
    round_trip=round_trip,
    random_reply=random_reply,
    host_parser=lx.host_parser,
    device_parser=lx.device_parser,
    move_frame=lx.encode_command(lx.Message(1, lx.MOVE_TIME_WRITE, (500, 1000))),
    device=device,
    executed=executed,
)
