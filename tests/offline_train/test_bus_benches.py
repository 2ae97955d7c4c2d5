"""The benches of the bus in small, on devices that need no peer library."""

import math
import random

import pytest

from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity, ServoTarget
from firmware_bridge.simulator.direct_link import DirectLink
from offline_train.benchmarks.firmware import devices, estop, noisy_moves, reads, throughput


@pytest.mark.parametrize("name", ["sts", "dxl2"])
def test_no_wrong_value_gets_through_a_faulty_line(name):
    tally = reads.count(name, 0.1, 1500, 3)
    assert tally.n_faults > 100
    assert tally.n_wrong == 0
    assert tally.n_soon >= 1495
    assert tally.n_tries / tally.n_soon < 1.2


def test_the_faulty_line_does_carry_wrong_values_to_a_host_that_believes_them():
    inner = devices.device("sts", 0)
    for servo in devices.servos(inner).values():
        servo.actual = 500.0 * servo.servo_id
        servo.command(servo.actual, 0.0)
    firmware = devices.FaultyAnswers(inner, 0.9, random.Random(0))
    dialect, link = protocol("sts"), DirectLink(firmware)
    link.open()
    values = {}
    for at in range(8000):
        query = dialect.query(Quantity.POSITION, (1 + at % 6,))[0]
        link.write(query.frame)
        link.wait_readable(0.005)
        for frame in dialect.parser().feed(link.read_available()):
            for reply in dialect.match(query, frame):
                values.setdefault(reply.servo_id, set()).update(reply.values)
    assert any(abs(v - 500 * i) > 68 for i, found in values.items() for v in found)


@pytest.mark.parametrize("name", ["sts", "dxl2"])
def test_no_damaged_move_goes_unnoticed(name):
    tally = noisy_moves.count(name, 1500, 0)
    assert (tally.n_outside, tally.n_missed, tally.n_late) == (0, 0, 0)
    assert tally.n_left > 0  # noise there was


def test_the_watch_sees_what_another_servo_was_told():
    firmware = devices.device("sts", 0)
    watch = noisy_moves.Watch(firmware)
    link = DirectLink(firmware)
    link.open()
    for frame in protocol("sts").move([ServoTarget(3, 1000, 100)], 100):
        link.write(frame)
    assert watch.seen == {(3, 1000.0)}


def test_a_board_that_cannot_be_asked_claims_nothing():
    assert noisy_moves._says_so("i2c").is_ok


def test_a_stop_overtakes_a_full_queue():
    stop = estop.run("sts", 1)
    assert stop.n_ahead <= 1
    assert stop.n_moves_after == 0
    assert stop.is_holding


def test_the_simulated_wire_takes_its_time():
    link = estop.WireLink(devices.device("sts", 0), 9600)
    link.open()
    link.write(bytes(10))
    assert 0.0 < link.idle_in_s() <= 100 / 9600
    link.write(bytes(10))
    assert 100 / 9600 < link.idle_in_s() <= 200 / 9600


def test_reads_through_a_real_terminal_are_counted():
    with throughput.served("sts") as port:
        for read in throughput._ours("sts")(port):
            assert throughput.rate_hz(read, 100) > 0.0
    assert throughput.rate_hz(lambda servo_id: None, 20) == 0.0
    assert math.isnan(throughput.rate_hz(lambda servo_id: servo_id, 20))
