"""Bytes on the simulated wire, on a clock that the tests move by hand."""

import pytest

from firmware_bridge.simulator.base import Firmware
from firmware_bridge.simulator.wire import Tap, Wire, WireOptions

BAUD = 10_000  # a byte takes 1 ms
ASK = 0x3F


class Answering(Firmware):
    """Answers each ASK byte with the same bytes, and remembers what it was fed and when."""

    def __init__(self, answer=b"", chatter=b""):
        self.baud, self.t_s = BAUD, 0.0
        self.fed = []
        self._answer, self._chatter, self._out = answer, chatter, bytearray()

    def feed(self, data):
        for value in data:
            self.fed.append((round(self.t_s, 6), value))
            if value == ASK:
                self._out += self._answer

    def replies(self):
        data = bytes(self._out)
        self._out.clear()
        return data

    def step(self, dt_s):
        before = int(self.t_s + 1e-9)
        self.t_s += dt_s
        if int(self.t_s + 1e-9) > before:
            self._out += self._chatter


def bytes_fed(firmware):
    return bytes(value for _, value in firmware.fed)


def arrivals(wire, until_s, step_s=0.0005):
    """Return (time, bytes) of all that reaches the host, looking every half millisecond."""
    found = []
    for number in range(1, round(until_s / step_s) + 1):
        data = wire.advance(number * step_s)
        if data:
            found.append((round(number * step_s, 6), data))
    return found


def started(firmware, **options):
    wire = Wire(firmware, WireOptions(**options))
    wire.advance(0.0)
    return wire


def test_each_byte_arrives_when_its_stop_bit_ends():
    firmware = Answering()
    wire = started(firmware)
    wire.host_sent(b"abc", 0.0)
    for n_ms, n_bytes in ((0.9, 0), (1.0, 1), (1.9, 1), (2.0, 2), (3.0, 3)):
        wire.advance(n_ms / 1000.0)
        assert len(firmware.fed) == n_bytes
    assert bytes_fed(firmware) == b"abc"


def test_second_write_queues_behind_the_first():
    firmware = Answering()
    wire = started(firmware)
    wire.host_sent(b"abcd", 0.0)
    wire.host_sent(b"e", 0.001)
    wire.advance(0.0045)
    assert bytes_fed(firmware) == b"abcd"
    wire.advance(0.005)
    assert bytes_fed(firmware) == b"abcde"


def test_answer_starts_when_the_question_is_complete_and_takes_its_time():
    wire = started(Answering(b"xyz"))
    wire.host_sent(bytes((1, 2, ASK)), 0.0)
    assert arrivals(wire, 0.01) == [(0.004, b"x"), (0.005, b"y"), (0.006, b"z")]


def test_a_late_look_does_not_shift_the_wire():
    wire = started(Answering(b"xyz"))
    wire.host_sent(bytes((ASK,)), 0.0)
    assert wire.advance(0.0035) == b"xy"  # due at 2, 3 and 4 ms
    assert wire.advance(0.004) == b"z"


def test_bytes_per_second_are_those_of_the_baud_rate():
    wire = started(Answering(b"0123456789"))
    for number in range(200):
        wire.host_sent(bytes((ASK,)), number * 0.010)
    arrived = b"".join(data for _, data in arrivals(wire, 1.0))
    # ten bytes for every question of one, on two wires: the answers fill theirs
    assert len(arrived) == 999  # the first is complete after 2 ms, then one each millisecond


def test_without_pacing_everything_is_there_at_once():
    wire = started(Answering(b"xyz"), is_paced=False)
    wire.host_sent(bytes((1, ASK)), 0.0)
    assert wire.advance(0.0) == b"xyz"


def test_next_time_is_that_of_the_bytes_under_way():
    wire = started(Answering(b"x"), grain_s=0.01)
    assert wire.next_s() == float("inf")
    wire.host_sent(bytes((1, ASK)), 0.0)
    assert wire.next_s() == pytest.approx(0.002)
    wire.advance(0.002)
    assert wire.next_s() == pytest.approx(0.003)


def test_after_a_byte_every_step_may_bring_a_slow_answer_and_later_none():
    wire = started(Answering())
    wire.host_sent(b"a", 0.0)
    wire.advance(0.0205)
    assert wire.next_s() == pytest.approx(0.021)
    wire.advance(0.2)
    assert wire.next_s() == float("inf")


def test_long_run_is_handed_over_in_grains():
    wire = started(Answering(), grain_s=0.002)
    wire.host_sent(bytes(50), 0.0)
    assert wire.next_s() == pytest.approx(0.003)  # one byte and the grain


def test_echo_returns_each_byte_when_it_is_complete():
    wire = started(Answering(b"x"), is_echo=True, is_half_duplex=True)
    wire.host_sent(bytes((1, ASK)), 0.0)
    assert arrivals(wire, 0.005) == [(0.001, b"\x01"), (0.002, b"?"), (0.003, b"x")]


def test_talking_into_an_answer_garbles_both_on_one_wire():
    firmware = Answering(b"xyz")
    wire = started(firmware, is_half_duplex=True)
    wire.host_sent(bytes((ASK,)), 0.0)
    wire.advance(0.0015)
    wire.host_sent(b"\x07", 0.0022)  # over y (2..3 ms) and z (3..4 ms)
    got = b"".join(data for _, data in arrivals(wire, 0.006))
    assert got[:1] == b"x"
    assert got[1] != ord("y")
    assert got[2] != ord("z")
    assert firmware.fed[1][1] != 7
    assert wire.n_collisions == 2


def test_answer_into_further_host_bytes_garbles_both():
    firmware = Answering(b"x")
    wire = started(firmware, is_half_duplex=True)
    wire.host_sent(bytes((ASK, 5)), 0.0)
    got = b"".join(data for _, data in arrivals(wire, 0.006))
    assert got != b"x"
    assert firmware.fed[1][1] != 5


def test_two_wires_do_not_collide():
    firmware = Answering(b"xyz")
    wire = started(firmware)
    wire.host_sent(bytes((ASK, 5, 6)), 0.0)
    assert b"".join(data for _, data in arrivals(wire, 0.006)) == b"xyz"
    assert bytes_fed(firmware) == bytes((ASK, 5, 6))


def test_wrong_baud_is_garbage_both_ways_and_paced_by_the_line():
    firmware = Answering(b"xyz", chatter=b"hello")
    wire = started(firmware)
    wire.set_line_baud(BAUD // 2)
    wire.host_sent(b"abcd", 0.0)
    wire.advance(0.0079)
    assert len(firmware.fed) == 3
    got = b"".join(data for _, data in arrivals(wire, 1.1))
    assert bytes_fed(firmware) != b"abcd"
    assert len(got) == 5
    assert got != b"hello"
    wire.set_line_baud(BAUD)
    assert b"hello" in wire.advance(2.1)


def test_unsolicited_frames_come_by_themselves():
    wire = started(Answering(chatter=b"!"))
    assert [round(t_s, 3) for t_s, _ in arrivals(wire, 3.5)] == [1.001, 2.001, 3.001]


def test_cutting_loses_what_is_under_way():
    firmware = Answering(b"xyz")
    wire = started(firmware)
    wire.host_sent(bytes((ASK, 1, 2)), 0.0)
    wire.advance(0.0025)
    wire.cut()
    assert arrivals(wire, 0.01) == []
    assert bytes_fed(firmware) == bytes((ASK, 1))


def test_tap_hears_all_that_passes():
    heard = []

    class Ear(Tap):
        def fed(self, n_steps, data):
            heard.append((n_steps, "in", data))

        def sent(self, n_steps, data):
            heard.append((n_steps, "out", data))

        def heard(self, n_steps, baud):
            heard.append((n_steps, "baud", baud))

    wire = Wire(Answering(b"x"), WireOptions(), Ear())
    wire.advance(0.0)
    wire.host_sent(bytes((ASK,)), 0.0)
    wire.advance(0.001)
    wire.set_line_baud(9600)
    assert heard == [(1, "in", b"?"), (1, "out", b"x"), (1, "baud", 9600)]


def test_same_seed_garbles_alike():
    def garbled(seed):
        firmware = Answering()
        wire = started(firmware, seed=seed)
        wire.set_line_baud(300)
        wire.host_sent(bytes(20), 0.0)
        wire.advance(10.0)
        return bytes_fed(firmware)

    assert garbled(1) == garbled(1) != garbled(2)
