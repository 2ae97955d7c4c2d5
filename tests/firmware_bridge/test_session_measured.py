"""Sessions on servos that can be measured, over real ptys."""

import threading
import time

import numpy as np
import pytest
from live_arm import LiveArm

from firmware_bridge.errors import HandshakeFailed, LinkLost, NotArmed
from firmware_bridge.links.dry import DryLink
from firmware_bridge.policy import Policy
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator.faulty import servos_of
from firmware_bridge.simulator.make import Setup

PROTOCOLS = ("sts", "lx16a", "rrc-bus")


@pytest.fixture(params=PROTOCOLS)
def live(request):
    with LiveArm(request.param) as made:
        yield made


@pytest.fixture
def sts():
    with LiveArm("sts") as made:
        yield made.ready()


def test_arming_starts_from_the_measured_pose_and_moves_nothing(live):
    before = live.true_rad()
    live.ready()
    assert live.session.state is SessionState.ARMED
    live.tick_for(0.3)
    assert np.abs(live.true_rad() - before).max() < 0.03
    state = live.session.read()
    assert state.source == "measured"
    assert state.is_valid.all()
    assert np.abs(state.joints_rad - live.true_rad()).max() < 0.02


def test_a_move_ends_at_its_goal(live):
    goal = live.ready().swing()
    assert live.arrive()
    live.tick_for(0.3)
    assert np.abs(live.true_rad() - goal).max() < 0.03
    assert live.session.read().age_s < 1.0


def test_stop_holds_where_the_arm_is(live):
    live.ready().swing(0.8, 1.6)
    live.tick_for(0.6)
    live.session.stop()
    live.tick_for(0.3)
    held = live.true_rad()
    live.tick_for(0.4)
    assert live.session.state is SessionState.ARMED
    assert np.abs(live.true_rad() - held).max() < 0.01
    assert abs(held[0] - live.arm.home_rad[0]) < 0.75


def test_an_estop_from_another_thread_does_not_wait_for_the_sessions_lock(sts):
    sts.swing(0.8, 2.0)
    sts.tick_for(0.3)
    with sts.session._lock:
        other = threading.Thread(target=sts.session.estop, args=("button",))
        other.start()
        other.join(5.0)
        assert not other.is_alive()
        assert sts.session.state is SessionState.ESTOP
    sts.tick_for(0.3)
    held = sts.true_rad()
    sts.tick_for(0.4)
    assert np.abs(sts.true_rad() - held).max() < 0.01
    assert abs(held[0] - sts.arm.home_rad[0]) < 0.7
    assert not sts.session.move(sts.arm.home_rad[None], np.ones(1)).is_accepted
    sts.session.reset()
    assert sts.session.state is SessionState.CONNECTED
    sts.session.arm()
    sts.swing()
    assert sts.arrive()


def test_an_estop_can_drop_the_torque_where_that_is_wanted():
    with LiveArm("sts", policy=Policy(estop="torque-off")) as live:
        live.ready().session.estop("button")
        live.tick_for(0.2)
        assert not any(servo.is_torque_on for servo in servos_of(live.firmware))


def test_a_servo_that_is_not_there_is_named_and_nothing_is_armed():
    with LiveArm("sts", ids=(1, 2, 4, 5, 6)) as live:
        live.session.open()
        with pytest.raises(HandshakeFailed, match=r"dead id: elbow_flex \(id 3\) does not answer"):
            live.session.arm()
        assert live.session.state is SessionState.CONNECTED


@pytest.mark.parametrize("protocol", PROTOCOLS[:2])
def test_a_servo_at_another_rate_is_named_with_its_rate(protocol):
    with LiveArm(protocol, [{"kind": "wrong-baud", "id": 2, "at_s": 0.0}]) as live:
        live.session.open()
        with pytest.raises(HandshakeFailed, match=r"wrong baud: .*\(id 2\) answers at 9600 baud"):
            live.session.arm()
        assert live.link.baud == live.firmware.baud


@pytest.mark.parametrize("protocol", PROTOCOLS[:2])
def test_two_servos_with_one_id_are_named(protocol):
    fault = {"kind": "id-clash", "id": 2, "with": 3, "at_s": 0.0}
    with LiveArm(protocol, [fault]) as live:
        live.session.open()
        with pytest.raises(HandshakeFailed, match="id clash: .*two servos have the id 3"):
            live.session.arm()


@pytest.mark.parametrize("protocol", PROTOCOLS[:2])
def test_narrower_limits_in_a_servo_are_refused_and_can_be_written(protocol):
    with LiveArm(protocol) as live:
        live.session.open()
        wide = live.session.handshake().servos[0].limits_ticks
        live.session.bus.send(
            live.session.bus.protocol.set_limits(live.arm.servo_ids[0], 400, 600), 2
        )
        with pytest.raises(HandshakeFailed, match="itself allows 400..600"):
            live.session.arm()
        findings = live.session.write_limits()
        assert not findings.troubles
        assert not findings.notes
        assert findings.servos[0].limits_ticks != wide
        live.session.arm()


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("overheat", "overheat"),
        ("dead", "dead id"),
        ("wrong-baud", "wrong baud"),
        ("brown-out", "brown-out"),
    ],
)
@pytest.mark.parametrize("protocol", PROTOCOLS[:2])
def test_a_fault_of_a_servo_is_named_and_the_others_stay_readable(protocol, kind, name):
    with LiveArm(protocol, [{"kind": kind, "id": 3, "at_s": 0.8}]) as live:
        live.ready()
        assert live.tick_until(lambda: name in live.session.reason), live.session.reason
        assert live.session.state is SessionState.FAULT
        assert "(id 3)" in live.session.reason
        live.tick_for(0.2)
        others = [j for j, i in enumerate(live.arm.servo_ids) if i != 3]
        assert live.session.read().is_valid[others].all()
        assert not live.session.move(live.arm.home_rad[None], np.ones(1)).is_accepted


def test_a_stuck_joint_is_a_stall():
    with LiveArm("lx16a", [{"kind": "stuck", "id": 6, "at_s": 0.5}]) as live:
        live.ready().tick_until(lambda: live.firmware.t_s > 0.6)
        live.swing(0.8, 1.0)
        assert live.tick_until(live.is_state(SessionState.FAULT))
        assert "stall: yaw (id 6)" in live.session.reason


def test_after_a_replug_the_session_is_connected_and_nothing_moves(sts):
    sts.swing(0.8, 2.0)
    sts.tick_for(0.3)
    sts.board.unplug()
    with pytest.raises(LinkLost):
        sts.tick_for(1.0)
    assert sts.session.state is SessionState.FAULT
    time.sleep(0.4)
    sts.board.replug()
    sts.link.port = sts.board.port
    sts.session.reopen()
    assert sts.session.state is SessionState.CONNECTED
    stood = sts.true_rad()
    sts.tick_for(0.3)
    assert np.abs(sts.true_rad() - stood).max() < 0.003
    assert not sts.session.move(sts.arm.home_rad[None], np.ones(1)).is_accepted
    sts.session.arm()
    assert sts.session.state is SessionState.ARMED


def test_an_estop_survives_a_replug(sts):
    sts.session.estop("button")
    sts.session.reopen()
    assert sts.session.state is SessionState.ESTOP


def test_a_limp_arm_is_no_longer_armed(sts):
    assert sts.session.torque(False)
    assert sts.session.state is SessionState.CONNECTED
    with pytest.raises(NotArmed):
        sts.session.torque(True)
    sts.session.arm()
    servos = servos_of(sts.firmware)
    assert sts.tick_until(lambda: all(servo.is_torque_on for servo in servos))


def test_the_gripper_opens_step_by_step(sts):
    gripper = sts.arm.gripper
    sts.session.grip(1.0)
    assert sts.tick_until(lambda: not sts.session.is_gripping)
    (servo,) = [one for one in servos_of(sts.firmware) if one.servo_id == gripper.servo_id]
    assert sts.tick_until(lambda: abs(servo.actual - gripper.open_ticks) < 20.0)


def test_telemetry_tells_of_every_servo(sts):
    def is_told():
        told = sts.session.telemetry()
        return np.isfinite(told.temperature_c + told.voltage_v + told.load).all()

    assert sts.tick_until(is_told)
    told = sts.session.telemetry()
    assert told.names[-1] == "gripper"
    assert np.abs(told.voltage_v - 7.4).max() < 0.5
    assert sts.session.stats()["bus answered"] > 0


def test_a_deadline_that_has_passed_is_refused(sts):
    late_s = time.monotonic() - 0.001
    report = sts.session.move(sts.arm.home_rad[None], np.ones(1), deadline_s=late_s)
    assert not report.is_accepted
    assert "deadline has passed" in report.reason


def test_a_dry_run_does_everything_but_send():
    live = LiveArm("lx16a")
    shown = []
    clock = [0.0]

    def wait(seconds):
        clock[0] += seconds

    link = DryLink(
        lambda: clock[0],
        wait,
        Setup("lx16a", "lx16a-arm").firmware(),
        lambda *one: shown.append(one),
    )
    session = ArmSession(live.arm, link, lambda: clock[0])
    session.open()
    session.arm()
    goal = live.arm.home_rad + [0.3, 0.0, 0.0, 0.0, 0.0]
    assert session.move(goal[None], np.ones(1)).is_accepted
    while session.state is SessionState.MOVING:
        session.tick()
        wait(0.01)
    session.close()
    live.board.close()
    assert np.abs(session.read().joints_rad - goal).max() < 0.05
    assert link.frames == shown
    assert any(frame[:2] == b"\x55\x55" and frame[4] == 1 for _, frame in link.frames)
