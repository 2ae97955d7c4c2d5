"""Several callers at once, on a line that takes real time."""

import os
import threading
import time
import tty

import pytest
from plain_bus import MOVE, POSITION, STOP, Plain, PlainServos, frame, number

from firmware_bridge.bus import Bus, Priority
from firmware_bridge.bus_turns import Turns
from firmware_bridge.codec.protocol import Quantity
from firmware_bridge.errors import MotionRefused
from firmware_bridge.links.serial_link import SerialLink

_PATIENCE_S = 20.0


class PtyServos(threading.Thread):
    """Simulated servos at the end of a real pty, in a thread; ``is_mute`` keeps answers back."""

    def __init__(self):
        super().__init__(daemon=True)
        self.servos = PlainServos()
        self.is_mute = False
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.port = os.ttyname(self._slave)
        self.start()

    def run(self):
        while True:
            try:
                data = os.read(self._master, 4096)
                self.servos.feed(data)
                answer = self.servos.replies()
                if answer and not self.is_mute:
                    os.write(self._master, answer)
            except OSError:
                return

    def unplug(self):
        os.close(self._slave)
        os.close(self._master)


@pytest.fixture
def device():
    return PtyServos()


@pytest.fixture
def bus(device):
    made = Bus(Plain(), SerialLink(device.port, Plain.baud))
    made.open()
    yield made
    made.close()


def run(*jobs):
    """Run jobs in threads of their own; return what each returned or raised."""
    results = [None] * len(jobs)

    def call(at, job):
        try:
            results[at] = job()
        except (MotionRefused, OSError) as error:
            results[at] = error

    threads = [
        threading.Thread(target=call, args=(at, job), daemon=True) for at, job in enumerate(jobs)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(_PATIENCE_S)
    assert not any(thread.is_alive() for thread in threads)
    return results


def test_turns_go_by_priority_and_then_by_who_came_first():
    turns, order, threads = Turns(), [], []

    def wait(priority, name):
        with turns.turn(priority):
            order.append(name)

    with turns.turn(Priority.READ):
        for priority, name in [
            (Priority.READ, "read 1"),
            (Priority.MOVE, "move 1"),
            (Priority.READ, "read 2"),
            (Priority.STOP, "stop"),
            (Priority.MOVE, "move 2"),
        ]:
            threads.append(threading.Thread(target=wait, args=(priority, name), daemon=True))
            threads[-1].start()
            give_up_s = time.monotonic() + _PATIENCE_S
            while len(turns._waiting) < len(threads) and time.monotonic() < give_up_s:
                time.sleep(0.001)
        assert turns.is_wanted_above(Priority.MOVE)
        assert not turns.is_wanted_above(Priority.STOP)
    for thread in threads:
        thread.join(_PATIENCE_S)
    assert order == ["stop", "move 1", "move 2", "read 1", "read 2"]


def test_a_turn_that_is_taken_is_not_given_twice():
    turns = Turns()
    with turns.turn(Priority.READ), turns.turn_if_free() as is_mine:
        assert not is_mine
    with turns.turn_if_free() as is_mine:
        assert is_mine


def test_many_threads_read_and_nobody_gets_an_answer_of_another(bus, device):
    for servo_id in (1, 2, 3):
        device.servos.servos[servo_id].actual = 100.0 * servo_id

    def read(servo_id):
        return {bus.read(Quantity.POSITION, (servo_id,))[servo_id].values for _ in range(50)}

    results = run(*[lambda i=i: read(i) for i in (1, 2, 3, 1, 2, 3)])
    assert results == [{(100,)}, {(200,)}, {(300,)}] * 2


def test_a_stop_ends_a_list_that_another_thread_is_sending(bus, device):
    frames = [frame(1, MOVE, number(500) + number(at)) for at in range(5000)]  # 4.3 s of bytes
    stop = frame(1, STOP)

    def halt():
        while not bus.stats.sent:
            time.sleep(0.001)
        return bus.urgent((stop,))

    refused, _ = run(lambda: bus.send(frames, Priority.MOVE), halt)
    assert isinstance(refused, MotionRefused)
    give_up_s = time.monotonic() + _PATIENCE_S
    while stop not in device.servos.log and time.monotonic() < give_up_s:
        time.sleep(0.001)
    time.sleep(0.02)
    assert device.servos.log[-1] == stop
    assert len(device.servos.log) < len(frames)


def test_a_stop_of_ordinary_priority_does_not_wait_for_a_list_of_moves(bus, device):
    frames = [frame(1, MOVE, number(500) + number(at)) for at in range(5000)]
    stop = frame(1, STOP)

    def halt():
        while not bus.stats.sent:
            time.sleep(0.001)
        return bus.send((stop,), Priority.STOP)

    refused, _ = run(lambda: bus.send(frames, Priority.MOVE), halt)
    assert isinstance(refused, MotionRefused)
    assert not bus.is_latched


def test_a_stop_goes_out_while_another_thread_waits_for_an_answer(bus, device):
    device.is_mute = True
    written = []
    true_write = bus.link.write

    def write(data, n_reply=0):
        true_write(data, n_reply)
        written.append(data)

    bus.link.write = write
    question, stop = frame(1, POSITION), frame(1, STOP)

    def halt():
        while not written:
            time.sleep(0.0001)
        bus.urgent((stop,))
        device.is_mute = False

    found, _ = run(lambda: bus.read(Quantity.POSITION, (1,)), halt)
    assert written[0] == question
    assert stop in written
    assert found[1].values == (500,)  # asked again by itself


def test_unplugging_ends_every_thread_with_one_error(bus, device):
    from firmware_bridge.errors import LinkLost

    def read():
        try:
            for _ in range(100000):
                bus.read(Quantity.POSITION, (1,))
        except LinkLost as error:
            return error
        return None

    def unplug():
        while bus.stats.answered < 20:
            time.sleep(0.001)
        bus.link.close()  # what a reader finds when another thread has lost the port

    *errors, _ = run(read, read, read, unplug)
    assert all(isinstance(error, LinkLost) for error in errors)
    assert not bus.is_open
