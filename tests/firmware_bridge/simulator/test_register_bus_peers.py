"""Unmodified vendor libraries drive the simulated servos over a real pty, in real time.

A library gives up after some 20 ms, and a loaded machine may keep the simulator from the CPU for
longer, so every exchange is tried again a few times; the values are what is tested.
"""

import time

import pytest

from firmware_bridge.simulator.dxl_bus import DxlBus
from firmware_bridge.simulator.pty_board import PtyBoard, serving
from firmware_bridge.simulator.servo import SimServo
from firmware_bridge.simulator.sts_bus import StsBus
from offline_train.benchmarks.firmware import peers

N_TRIES = 30
IDS = (1, 2, 3)


def loaded(package, module):
    found = peers.load(package, module)
    if found is None:
        pytest.skip(f"{package} is not set up")
    return found


def insist(call):
    """Call until the library reports success; return what it returned before its result codes."""
    for _ in range(N_TRIES):
        *values, result, error = call()
        if result == 0:
            assert error == 0
            return values[0] if values else None
    raise AssertionError(f"no success in {N_TRIES} tries, last result {result}")


def insist_group(call):
    for _ in range(N_TRIES):
        if call() == 0:
            return
    raise AssertionError(f"no success in {N_TRIES} tries")


def wait_for(read, wanted, within=3):
    """Read until a position has come near enough: how long that takes is up to the machine."""
    give_up_s = time.monotonic() + 20.0
    while time.monotonic() < give_up_s:
        at = read()
        if abs(at - wanted) <= within:
            return
        time.sleep(0.02)
    raise AssertionError(f"stands at {at}, not at {wanted}")


@pytest.fixture
def sts_board():
    bus = StsBus([SimServo(one, 2048, (0, 4095), 3000.0) for one in IDS])
    with serving(PtyBoard(bus)) as board:
        yield board


@pytest.fixture
def dxl_board():
    bus = DxlBus([SimServo(one, 2048, (0, 4095), 3000.0) for one in IDS])
    with serving(PtyBoard(bus)) as board:
        yield board


@pytest.fixture
def feetech(sts_board):
    module = loaded("feetech-servo-sdk", "scservo_sdk")
    port = module.PortHandler(sts_board.port)
    assert port.openPort()
    yield module, port, module.PacketHandler(0)
    port.closePort()


@pytest.fixture
def ftservo(sts_board):
    module = loaded("ftservo-python-sdk", "scservo_sdk")
    port = module.PortHandler(sts_board.port)
    assert port.openPort()
    yield module, module.sms_sts(port)
    port.closePort()


@pytest.fixture
def dynamixel(dxl_board):
    module = loaded("dynamixel-sdk", "dynamixel_sdk")
    port = module.PortHandler(dxl_board.port)
    assert port.setBaudRate(57_600)
    yield module, port, module.PacketHandler(2.0)
    port.closePort()


def test_feetech_servo_sdk_pings_moves_and_reads(feetech, sts_board):
    _, port, handler = feetech
    for one in IDS:
        assert insist(lambda one=one: handler.ping(port, one)) == 777
    insist(lambda: handler.write2ByteTxRx(port, 1, 42, 2500))
    wait_for(lambda: insist(lambda: handler.read2ByteTxRx(port, 1, 56)), 2500)
    assert sts_board.firmware.commanded == {1: 2500}
    assert insist(lambda: handler.read1ByteTxRx(port, 1, 63)) == 30


def test_feetech_servo_sdk_syncs_and_prepares(feetech, sts_board):
    module, port, handler = feetech
    group = module.GroupSyncWrite(port, handler, 42, 2)
    for one in IDS:
        assert group.addParam(one, [(2000 + one) & 0xFF, (2000 + one) >> 8])
    insist_group(group.txPacket)
    insist(lambda: handler.regWriteTxRx(port, 3, 42, 2, [0x00, 0x04]))
    reads = module.GroupSyncRead(port, handler, 56, 2)
    for one in IDS:
        assert reads.addParam(one)

    def at(one):
        insist_group(reads.txRxPacket)
        return reads.getData(one, 56, 2)

    for one in IDS:
        wait_for(lambda one=one: at(one), 2000 + one)
    handler.action(port, 0xFE)
    wait_for(lambda: at(3), 1024)


def test_feetech_servo_sdk_sets_limits_behind_the_lock(feetech, sts_board):
    _, port, handler = feetech
    insist(lambda: handler.write1ByteTxRx(port, 2, 55, 0))
    insist(lambda: handler.write2ByteTxRx(port, 2, 11, 2200))
    insist(lambda: handler.write1ByteTxRx(port, 2, 55, 1))
    insist(lambda: handler.write2ByteTxRx(port, 2, 42, 4000))
    wait_for(lambda: insist(lambda: handler.read2ByteTxRx(port, 2, 56)), 2200)


def test_feetech_servo_sdk_sees_the_error_bits(feetech, sts_board):
    _, port, handler = feetech
    sts_board.firmware.member(1).servo.temperature_c = 99.0
    seen = set()
    while (0, 4) not in seen and len(seen) < N_TRIES:  # the servo notices with its next step
        seen.add(handler.read2ByteTxRx(port, 1, 56)[1:])
    assert (0, 4) in seen


def test_ftservo_moves_with_speed_and_acceleration_and_reads_both(ftservo, sts_board):
    _, servo = ftservo
    assert insist(lambda: servo.ping(1)) == 777
    insist(lambda: servo.WritePosEx(1, 2600, 1500, 50))
    wait_for(lambda: insist(lambda: servo.ReadPos(1)), 2600)
    member = sts_board.firmware.member(1)
    assert (member.get("goal_speed"), member.get("acceleration")) == (1500, 50)
    for one in (2, 3):
        assert servo.SyncWritePosEx(one, 1500, 2000, 0)
    insist_group(servo.groupSyncWrite.txPacket)
    wait_for(lambda: insist(lambda: servo.ReadPos(3)), 1500)
    insist(lambda: servo.LockEprom(1))


def test_ftservo_reads_a_negative_position(ftservo, sts_board):
    _, servo = ftservo
    sts_board.firmware.member(2).set("homing_offset", 2000)
    sts_board.firmware.member(2).servo.command(1900, 0.0)
    wait_for(lambda: insist(lambda: servo.ReadPos(2)), -100)


def test_dynamixel_sdk_pings_moves_and_reads(dynamixel, dxl_board):
    _, port, handler = dynamixel
    for one in IDS:
        assert insist(lambda one=one: handler.ping(port, one)) == 1060
    insist(lambda: handler.write4ByteTxRx(port, 1, 116, 2500))
    wait_for(lambda: insist(lambda: handler.read4ByteTxRx(port, 1, 132)), 2500)
    assert dxl_board.firmware.commanded == {1: 2500}
    for _ in range(N_TRIES):
        result, error = handler.write4ByteTxRx(port, 1, 116, 5000)
        if result == 0:
            break
    assert (result, error) == (0, 6)


def test_dynamixel_sdk_syncs_prepares_and_reboots(dynamixel, dxl_board):
    module, port, handler = dynamixel
    group = module.GroupSyncWrite(port, handler, 116, 4)
    for one in IDS:
        assert group.addParam(one, list((2000 + one).to_bytes(4, "little")))
    insist_group(group.txPacket)
    reads = module.GroupSyncRead(port, handler, 132, 4)
    for one in IDS:
        assert reads.addParam(one)

    def at(one):
        insist_group(reads.txRxPacket)
        return reads.getData(one, 132, 4)

    for one in IDS:
        wait_for(lambda one=one: at(one), 2000 + one)
    insist(lambda: handler.regWriteTxRx(port, 2, 116, 4, [0x00, 0x04, 0, 0]))
    handler.action(port, 0xFE)
    wait_for(lambda: at(2), 1024)
    insist(lambda: handler.reboot(port, 3))
    wait_for(lambda: insist(lambda: handler.read1ByteTxRx(port, 3, 64)), 0, within=0)


def test_dynamixel_sdk_understands_a_stuffed_answer(dynamixel, dxl_board):
    _, port, handler = dynamixel
    dxl_board.firmware.member(1).set("profile_velocity", 0xFDFFFF)
    assert insist(lambda: handler.read4ByteTxRx(port, 1, 112)) == 0xFDFFFF


def test_the_unstuffed_frame_of_dynamixel_sdk_changes_nothing(dynamixel, dxl_board):
    _, port, handler = dynamixel
    result, _ = handler.write4ByteTxRx(port, 1, 112, 0xFDFFFF)
    assert result != 0
    assert dxl_board.firmware.member(1).get("profile_velocity") == 0
