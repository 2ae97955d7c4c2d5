"""Device faults on the real firmware of every bus: named by silence, garbage or error bits."""

import pytest

from firmware_bridge.codec import protocol
from firmware_bridge.codec.protocol import Quantity, ServoFlag, ServoTarget
from firmware_bridge.simulator.make import FAMILIES, Setup

BUSES = sorted(name for name in FAMILIES if FAMILIES[name].is_half_duplex)
# an LX servo shows its errors with a lamp and tells nobody
TELLING = [name for name in BUSES if Quantity.FLAGS in protocol(name).quantities]


def struck(name, *devices):
    script = {"version": 1, "devices": list(devices)}
    firmware = Setup(name, ids=(1, 2, 3), faults=script).firmware()
    wait(firmware, 0.2)
    return firmware


def wait(firmware, seconds):
    out = b""
    for _ in range(round(seconds / 0.001)):
        firmware.step(0.001)
        out += firmware.replies()
    return out


def ask(firmware, name, servo_id, quantity=Quantity.POSITION):
    """Return what a servo answers: its values, or None for silence or garbage."""
    speech = protocol(name)
    found = None
    for query in speech.query(quantity, (servo_id,)):
        firmware.feed(query.frame)
        for frame in speech.parser().feed(firmware.replies() + wait(firmware, 0.05)):
            for reply in speech.match(query, frame):
                found = reply.values
    return found


@pytest.mark.parametrize("name", BUSES)
def test_servos_of_the_same_id_cannot_be_understood(name):
    clash = {"kind": "id-clash", "id": 2, "with": 1, "at_s": 0.1, "for_s": 1.0}
    firmware = struck(name, clash)
    assert ask(firmware, name, 1) is None
    assert ask(firmware, name, 2) is None
    assert ask(firmware, name, 3) is not None
    wait(firmware, 1.0)
    assert ask(firmware, name, 1) is not None
    assert ask(firmware, name, 2) is not None


@pytest.mark.parametrize("name", BUSES)
def test_servo_at_another_baud_is_found_there(name):
    firmware = struck(name, {"kind": "wrong-baud", "id": 2, "baud": 9600, "at_s": 0.1})
    assert ask(firmware, name, 2) is None
    assert ask(firmware, name, 1) is not None
    assert firmware.listen(9600)
    assert ask(firmware, name, 2) is not None
    assert ask(firmware, name, 1) is None
    assert not firmware.listen(4800)
    assert firmware.listen(protocol(name).baud)
    assert ask(firmware, name, 1) is not None


@pytest.mark.parametrize("name", BUSES)
def test_dead_servo_is_silent_and_the_others_answer(name):
    firmware = struck(name, {"kind": "dead", "id": 2, "at_s": 0.1})
    assert ask(firmware, name, 2) is None
    assert ask(firmware, name, 3) is not None


@pytest.mark.parametrize("name", BUSES)
def test_overheated_servo_shows_its_temperature(name):
    firmware = struck(name, {"kind": "overheat", "id": 2, "at_s": 0.1})
    assert ask(firmware, name, 2, Quantity.TEMPERATURE)[0] > 80
    assert ask(firmware, name, 1, Quantity.TEMPERATURE)[0] < 40


@pytest.mark.parametrize("name", TELLING)
def test_overheated_servo_says_so_in_its_own_bits(name):
    firmware = struck(name, {"kind": "overheat", "id": 2, "at_s": 0.1})
    assert ask(firmware, name, 2, Quantity.FLAGS)[0] & ServoFlag.OVERHEAT
    assert not ask(firmware, name, 1, Quantity.FLAGS)[0] & ServoFlag.OVERHEAT


def moved(name, firmware, ticks):
    """Send servos 1 to 3 somewhere and wait until they should be there."""
    speech = protocol(name)
    targets = [ServoTarget(one, ticks, 2000) for one in (1, 2, 3)]
    for frame in (*speech.torque((1, 2, 3), True), *speech.move(targets, 100)):
        firmware.feed(frame)
        wait(firmware, 0.01)
    wait(firmware, 1.0)


@pytest.mark.parametrize("name", BUSES)
def test_stuck_servo_stays_where_it_was(name):
    firmware = struck(name, {"kind": "stuck", "id": 2, "at_s": 0.1})
    before = ask(firmware, name, 2)[0]
    moved(name, firmware, before + 200)
    assert ask(firmware, name, 2)[0] == before
    assert ask(firmware, name, 1)[0] > before + 190


@pytest.mark.parametrize("name", TELLING)
def test_stuck_servo_says_so_in_its_own_bits(name):
    firmware = struck(name, {"kind": "stuck", "id": 2, "at_s": 0.1})
    moved(name, firmware, ask(firmware, name, 2)[0] + 200)
    assert ask(firmware, name, 2, Quantity.FLAGS)[0] & ServoFlag.STALL
    assert not ask(firmware, name, 1, Quantity.FLAGS)[0] & ServoFlag.STALL


@pytest.mark.parametrize("name", BUSES)
def test_brown_out_switches_the_torque_off(name):
    firmware = struck(name, {"kind": "brown-out", "at_s": 0.1, "for_s": 0.5})
    assert ask(firmware, name, 1) is None
    wait(firmware, 0.5)
    assert ask(firmware, name, 1, Quantity.TORQUE) == (0,)
