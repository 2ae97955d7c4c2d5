"""Unmodified LX and LSC libraries set and read everything they know, over a real pty."""

import time

import pytest
import serial

from firmware_bridge.simulator.make import Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving
from offline_train.benchmarks.firmware import peers

_WAIT_S = 30.0  # a servo answers within a few ms; a machine with much to do may take longer


def library(package, module):
    found = peers.load(package, module)
    if found is None:
        pytest.skip(f"{package} is not installed; scripts/setup_peers.py does that")
    return found


def board(protocol, tmp_path, ids, name="arm"):
    setup = Setup(protocol, ids=ids, is_plain=True)
    return serving(PtyBoard(setup.firmware(), tmp_path / name, setup.wire()))


@pytest.fixture
def controller(tmp_path):
    lewansoul = library("lewansoul-lx16a", "lewansoul_lx16a")
    with board("lx16a", tmp_path, (2,)) as made, serial.Serial(made.port, 115200) as line:
        yield lewansoul.ServoController(line, timeout=_WAIT_S)


@pytest.mark.parametrize(
    ("store", "tell", "values"),
    [
        ("set_position_limits", "get_position_limits", (100, 900)),
        ("set_voltage_limits", "get_voltage_limits", (5000, 11000)),
        ("set_max_temperature_limit", "get_max_temperature_limit", (70,)),
        ("set_position_offset", "get_position_offset", (-12,)),
        ("set_led_errors", "get_led_errors", (5,)),
        ("set_motor_mode", "get_motor_speed", (-300,)),
        ("move_prepare", "get_prepared_move", (640, 250)),
    ],
)
def test_lewansoul_reads_back_what_it_has_stored(controller, store, tell, values):
    getattr(controller, store)(2, *values)
    told = getattr(controller, tell)(2)
    assert (told if isinstance(told, tuple) else (told,)) == values


def test_lewansoul_switches_led_torque_and_mode(controller):
    controller.led_off(2)
    controller.motor_off(2)
    assert not controller.is_led_on(2)
    assert not controller.is_motor_on(2)
    controller.led_on(2)
    controller.motor_on(2)
    controller.set_motor_mode(2, 100)
    assert controller.is_led_on(2)
    assert controller.is_motor_on(2)
    assert controller.get_mode(2) == 1
    controller.set_servo_mode(2)
    assert controller.get_mode(2) == 0


def test_lewansoul_finds_a_lone_servo_and_gives_it_another_id(controller):
    assert controller.get_servo_id() == 2
    controller.set_servo_id(2, 9)
    assert controller.get_servo_id() == 9
    assert controller.get_position(9) == 500


def test_lewansoul_starts_and_stops_what_it_has_prepared(controller):
    controller.move_prepare(2, 900, 30000)
    assert controller.get_position(2) == 500
    controller.move_start()
    end_s = time.monotonic() + _WAIT_S
    while controller.get_position(2) == 500 and time.monotonic() < end_s:
        pass
    controller.move_stop(2)
    stopped = controller.get_position(2)
    assert 500 < stopped < 900
    time.sleep(0.2)
    assert abs(controller.get_position(2) - stopped) <= 1


def test_pylx16a_finds_the_registers_as_they_were_set(tmp_path):
    pylx16a = library("pylx16a", "pylx16a.lx16a")
    with board("lx16a", tmp_path, (1, 2)) as made:
        pylx16a.LX16A.initialize(made.port, _WAIT_S)
        try:
            servo = pylx16a.LX16A(2)
            servo.set_angle_limits(24.0, 216.0)
            servo.set_vin_limits(5000, 9000)
            servo.set_temp_limit(75)
            servo.set_angle_offset(-3)
            servo.set_led_error_triggers(True, False, True)
            assert servo.get_angle_limits(poll_hardware=True) == (24.0, 216.0)
            assert servo.get_vin_limits(poll_hardware=True) == (5000, 9000)
            assert servo.get_temp_limit(poll_hardware=True) == 75
            assert servo.get_led_error_triggers(poll_hardware=True) == (True, False, True)
            servo.disable_torque()
            assert not servo.is_torque_enabled(poll_hardware=True)
            assert servo.get_id(poll_hardware=True) == 2
        finally:
            pylx16a.LX16A._controller.close()


def test_xarm_unloads_servos_and_reads_several_at_once(tmp_path, monkeypatch):
    xarm = library("xarm", "xarm")
    monkeypatch.chdir(tmp_path)
    with board("lsc", tmp_path, (1, 2, 3), "COM1") as made:  # it opens only names that start so
        arm = xarm.Controller("COM1")
        arm._device.timeout = 0.3  # it asks for two bytes too many and waits for them
        try:
            arm.servoOff([1, 3])
            assert arm.getBatteryVoltage() == pytest.approx(7.4, abs=0.2)
            torques = {one.servo_id: one.is_torque_on for one in made.firmware.servos}
            assert torques == {1: False, 2: True, 3: False}
            members = [xarm.Servo(one) for one in (1, 2, 3)]
            arm.getPosition(members)
            assert [member.position for member in members] == [500, 500, 500]
        finally:
            arm._device.close()
