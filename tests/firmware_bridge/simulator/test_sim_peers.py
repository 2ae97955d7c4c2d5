"""Unmodified libraries of other people drive the paced simulator and believe it is an arm."""

import time

import pytest
import serial

from firmware_bridge.simulator.make import Setup
from firmware_bridge.simulator.pty_board import PtyBoard, serving
from offline_train.benchmarks.firmware import peers

PATIENCE_S = 20.0


def library(package, module):
    found = peers.load(package, module)
    if found is None:
        pytest.skip(f"{package} is not installed; scripts/setup_peers.py does that")
    return found


def board(protocol, tmp_path, name="arm"):
    setup = Setup(protocol, ids=(1, 2, 3), seed=1)
    return serving(PtyBoard(setup.firmware(), tmp_path / name, setup.wire()))


def arrives(read, ticks, tolerance):
    """Read a position until it is there; say whether it got there."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        if abs(read() - ticks) <= tolerance:
            return True
    return False


def test_lewansoul_lx16a_moves_and_reads_a_servo(tmp_path):
    lewansoul = library("lewansoul-lx16a", "lewansoul_lx16a")
    with board("lx16a", tmp_path) as made, serial.Serial(made.port, 115200, timeout=1) as line:
        controller = lewansoul.ServoController(line, timeout=5)
        assert controller.get_position(2) == 500
        controller.move(2, 700, 200)
        assert arrives(lambda: controller.get_position(2), 700, 3)
        assert 20 <= controller.get_temperature(2) <= 40
        assert 7000 <= controller.get_voltage(2) <= 7400
        controller.motor_off(2)
        assert not controller.is_motor_on(2)
        assert controller.get_led_errors(2) is not None


def test_pylx16a_moves_and_reads_a_servo(tmp_path):
    pylx16a = library("pylx16a", "pylx16a.lx16a")
    with board("lx16a", tmp_path) as made:
        pylx16a.LX16A.initialize(made.port, 1.0)
        try:
            servo = pylx16a.LX16A(2)
            servo.move(150.0, 200)
            assert arrives(servo.get_physical_angle, 150.0, 1.0)
            assert servo.get_temp() < 60
        finally:
            pylx16a.LX16A._controller.close()


def test_xarm_moves_and_reads_a_servo(tmp_path, monkeypatch):
    xarm = library("xarm", "xarm")
    monkeypatch.chdir(tmp_path)
    with board("lsc", tmp_path, "COM1"):  # it opens only names that start so
        arm = xarm.Controller("COM1")
        try:
            assert 6.0 < arm.getBatteryVoltage() < 8.5
            arm.setPosition(2, 650, duration=200)
            assert arrives(lambda: arm.getPosition(2), 650, 3)
        finally:
            arm._device.close()


def test_feetech_servo_sdk_moves_and_reads_a_servo(tmp_path):
    sdk = library("feetech-servo-sdk", "scservo_sdk")
    with board("sts", tmp_path) as made:
        port = sdk.PortHandler(made.port)
        assert port.openPort()
        try:
            assert port.setBaudRate(1_000_000)
            packet = sdk.PacketHandler(0)
            model, result, error = packet.ping(port, 2)
            assert (model, result, error) == (777, sdk.COMM_SUCCESS, 0)
            assert packet.write1ByteTxRx(port, 2, 40, 1) == (sdk.COMM_SUCCESS, 0)
            assert packet.write2ByteTxRx(port, 2, 42, 2600) == (sdk.COMM_SUCCESS, 0)
            assert arrives(lambda: packet.read2ByteTxRx(port, 2, 56)[0], 2600, 10)
        finally:
            port.closePort()


def test_ftservo_sdk_moves_and_reads_a_servo(tmp_path):
    sdk = library("ftservo-python-sdk", "scservo_sdk")
    with board("sts", tmp_path) as made:
        port = sdk.PortHandler(made.port)
        assert port.openPort()
        try:
            assert port.setBaudRate(1_000_000)
            packet = sdk.sms_sts(port)
            assert packet.ping(2)[0] == 777
            packet.write1ByteTxRx(2, 40, 1)
            packet.WritePosEx(2, 2600, 3000, 0)
            assert arrives(lambda: packet.ReadPos(2)[0], 2600, 10)
        finally:
            port.closePort()


def test_dynamixel_sdk_moves_and_reads_a_servo(tmp_path):
    sdk = library("dynamixel-sdk", "dynamixel_sdk")
    with board("dxl2", tmp_path) as made:
        port = sdk.PortHandler(made.port)
        assert port.openPort()
        try:
            assert port.setBaudRate(made.firmware.baud)
            packet = sdk.PacketHandler(2.0)
            model, result, error = packet.ping(port, 2)
            assert (result, error) == (sdk.COMM_SUCCESS, 0)
            assert model > 0
            assert packet.write1ByteTxRx(port, 2, 64, 1) == (sdk.COMM_SUCCESS, 0)
            assert packet.write4ByteTxRx(port, 2, 116, 2600) == (sdk.COMM_SUCCESS, 0)
            assert arrives(lambda: packet.read4ByteTxRx(port, 2, 132)[0], 2600, 10)
        finally:
            port.closePort()
