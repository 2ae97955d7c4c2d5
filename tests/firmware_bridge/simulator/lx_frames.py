"""Frames of the LX-16A bus as the tests write and read them, by hand, and a bus to talk to."""

from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.faults import parse_script
from firmware_bridge.simulator.faulty import FaultyFirmware
from firmware_bridge.simulator.servo import SimServo


def frame(servo_id, command, *params):
    body = bytes((servo_id, len(params) + 3, command, *params))
    return b"\x55\x55" + body + bytes((~sum(body) & 0xFF,))


def move(servo_id, ticks, duration_ms):
    return frame(servo_id, 1, *ticks.to_bytes(2, "little"), *duration_ms.to_bytes(2, "little"))


def ask(servo_id):
    return frame(servo_id, 28)


def positions(data):
    """Return (id, ticks) of all whole position answers in a row of bytes."""
    found = []
    for at in range(len(data) - 7):
        one = data[at : at + 8]
        if (
            one[:2] == b"\x55\x55"
            and one[3:5] == b"\x05\x1c"
            and frame(*one[2:3], *one[4:7]) == one
        ):
            found.append((one[2], int.from_bytes(one[5:7], "little")))
    return found


class Bus(Firmware):
    def __init__(self, ids):
        self.baud, self.t_s = 115200, 0.0
        self.servos = [SimServo(one, 100 * one, (0, 1000), 1560.0) for one in ids]
        self._in, self._out = bytearray(), bytearray()

    def feed(self, data):
        self._in += data
        while True:
            at = self._in.find(b"\x55\x55")
            if at < 0 or len(self._in) < at + 4 or len(self._in) < at + self._in[at + 3] + 3:
                return
            one = bytes(self._in[at : at + self._in[at + 3] + 3])
            if len(one) < 6 or frame(one[2], *one[4:-1]) != one:
                del self._in[: at + 1]
                continue
            del self._in[: at + len(one)]
            for servo in self.servos:
                if servo.servo_id == one[2] and servo.is_answering:
                    self._obey(servo, one)

    def _obey(self, servo, one):
        if one[4] == 1:
            servo.command(
                int.from_bytes(one[5:7], "little"), int.from_bytes(one[7:9], "little") / 1000
            )
        elif one[4] == 28:
            self._out += frame(servo.servo_id, 28, *servo.measured.to_bytes(2, "little"))

    def replies(self):
        data = bytes(self._out)
        self._out.clear()
        return data

    def step(self, dt_s):
        self.t_s += dt_s
        for servo in self.servos:
            servo.step(dt_s)


def faulty(line=(), devices=(), ids=(1, 2, 3), seed=0):
    script = parse_script({"version": 1, "line": list(line), "devices": list(devices)})
    return FaultyFirmware(Bus(ids), "lx16a", script, seed)


def question(firmware, servo_id, wait_s=0.0):
    """Ask a servo for its position and return the bytes that come within the time."""
    firmware.feed(ask(servo_id))
    data = firmware.replies()
    for _ in range(round(wait_s / 0.001)):
        firmware.step(0.001)
        data += firmware.replies()
    return data


def run(firmware, seconds, dt_s=0.005):
    for _ in range(round(seconds / dt_s)):
        firmware.step(dt_s)
