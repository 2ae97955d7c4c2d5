import numpy as np
import pytest

from firmware_bridge.codec import rrc
from firmware_bridge.errors import LinkLost, MotionRefused, NotArmed
from firmware_bridge.session import HORIZON_S, SessionState

NEAR_TABLE_M = np.array([[0.14, 0.05, 0.06], [0.14, 0.05, 0.005]])


@pytest.fixture
def ready(bench):
    bench.start()
    return bench


def goals(arm):
    q, is_reachable = arm.inverse(NEAR_TABLE_M)
    assert is_reachable.all()
    return q


def go(bench, arm, share=0.9):
    way = goals(arm)
    knots = np.vstack([bench.session.read().joints_rad, way])
    times = np.array([arm.travel_time_s(a, b[None])[0] for a, b in zip(knots, knots[1:])]) / share
    report = bench.session.move(way, times)
    assert report.is_accepted, report.reason
    return way[-1], float(times.sum())


def unplug(bench):
    bench.board.close()
    with pytest.raises(LinkLost):
        bench.session.tick()


def test_a_session_goes_from_closed_to_connected_to_armed(bench):
    assert bench.session.state is SessionState.CLOSED
    bench.session.open()
    assert bench.session.state is SessionState.CONNECTED
    bench.session.arm()
    bench.advance(0.3)
    assert bench.session.state is SessionState.ARMED


def test_a_move_ends_at_its_goal_by_bytes_alone(ready, arm):
    goal, total_s = go(ready, arm)
    assert ready.session.state is SessionState.MOVING
    ready.advance(total_s + arm.lag_s)
    assert ready.session.state is SessionState.ARMED
    assert np.linalg.norm(ready.firmware.points_m[3] - NEAR_TABLE_M[-1]) < 0.001
    assert np.array_equal(ready.session.read().joints_rad, goal)
    assert ready.firmware.n_bad_crc == ready.firmware.n_rejected == ready.firmware.n_clamped == 0


def test_the_first_segment_is_sent_at_once(ready, arm):
    before = ready.link.n_bytes_out
    report = ready.session.move(goals(arm), np.array([1.0, 1.0]))
    assert ready.link.n_bytes_out > before
    assert report.t_sent_s == ready.t_s


def test_the_servos_follow_the_path_closely(ready, arm):
    go(ready, arm)
    for _ in range(40):
        ready.advance(0.02)
        commanded = ready.session.read().joints_rad
        lag_rad = 3.0 * arm.servo_time_constant_s
        corner_rad = 3.0 * HORIZON_S / 4 + 0.01  # the horizon cuts corners between segments
        assert np.abs(ready.firmware.joints_rad - commanded).max() < lag_rad + corner_rad


@pytest.mark.parametrize("died_after_s", [0.0, 0.1, 0.26, 0.4])
def test_the_arm_of_a_dead_host_stops_within_the_horizon(ready, arm, died_after_s):
    go(ready, arm)
    ready.advance(died_after_s)
    ready.exchange()
    ready.advance(HORIZON_S, is_host_alive=False)
    commanded = ready.firmware.set_points_us
    ready.advance(0.1, is_host_alive=False)
    resting = ready.firmware.joints_rad
    ready.advance(2.0, is_host_alive=False)
    assert np.array_equal(ready.firmware.set_points_us, commanded)
    assert np.abs(ready.firmware.joints_rad - resting).max() < 0.002


def test_a_host_that_stalls_does_not_make_the_arm_hurry(ready, arm):
    go(ready, arm, share=1.0)
    ready.advance(0.15)
    ready.advance(0.5, is_host_alive=False)
    speeds, before = [], ready.firmware.set_points_us
    for _ in range(60):
        ready.advance(0.01)
        now = ready.firmware.set_points_us
        speeds.append(np.abs(now - before)[:4] / np.abs(arm.ticks_per_rad) / 0.01)
        before = now
    # whole pulses and whole milliseconds: one pulse in 100 ms is 0.016 rad/s
    assert np.max(speeds) <= arm.rate_rad_s.max() * 1.02
    assert np.max(speeds) > 1.0
    assert ready.session.n_late_ticks == 1


def test_a_stalled_host_arrives_later_but_arrives(ready, arm):
    _, total_s = go(ready, arm)
    ready.advance(0.1)
    ready.advance(1.0, is_host_alive=False)
    ready.advance(total_s + arm.lag_s)
    assert np.linalg.norm(ready.firmware.points_m[3] - NEAR_TABLE_M[-1]) < 0.001


def test_a_new_move_takes_over_from_where_the_arm_is(ready, arm):
    go(ready, arm)
    ready.advance(0.2)
    before = ready.firmware.joints_rad
    report = ready.session.move(arm.home_rad[None], np.array([1.0]))
    ready.advance(0.02)
    assert report.is_accepted
    assert np.abs(ready.firmware.joints_rad - before).max() < 3.0 * 0.03
    ready.advance(1.1)
    assert np.abs(ready.firmware.joints_rad - arm.home_rad).max() < 0.0015


def test_stop_holds_where_the_arm_is(ready, arm):
    go(ready, arm)
    ready.advance(0.3)
    held = ready.session.read().joints_rad
    ready.session.stop()
    assert ready.session.state is SessionState.ARMED
    ready.advance(1.0)
    assert np.abs(ready.firmware.joints_rad - held).max() < 0.0015
    assert np.abs(ready.session.read().joints_rad - held).max() < 1e-12


def test_estop_holds_latches_and_refuses_everything(ready, arm):
    go(ready, arm)
    ready.advance(0.3)
    held = ready.session.read().joints_rad
    ready.session.estop("button")
    ready.advance(0.2)
    n_sent = ready.link.n_bytes_out
    report = ready.session.move(goals(arm), np.array([1.0, 1.0]))
    with pytest.raises(NotArmed, match="found estop"):
        ready.session.arm()
    ready.session.open()
    ready.session.stop()
    ready.advance(1.0)
    assert not report.is_accepted
    assert "estop" in report.reason
    assert ready.session.state is SessionState.ESTOP
    assert ready.session.reason == "button"
    assert ready.link.n_bytes_out == n_sent
    assert np.abs(ready.firmware.joints_rad - held).max() < 0.0015


def test_after_reset_the_arm_must_be_armed_again(ready, arm):
    ready.session.estop("button")
    ready.session.reset()
    assert ready.session.state is SessionState.CONNECTED
    assert not ready.session.move(goals(arm), np.array([1.0, 1.0])).is_accepted
    ready.session.arm()
    ready.advance(0.3)
    assert ready.session.move(goals(arm), np.array([1.0, 1.0])).is_accepted


def test_unplugging_while_moving_is_a_latched_fault(ready, arm):
    go(ready, arm)
    ready.advance(0.2)
    unplug(ready)
    assert ready.session.state is SessionState.FAULT
    assert "the board is gone" in ready.session.reason
    report = ready.session.move(goals(arm), np.array([1.0, 1.0]))
    assert not report.is_accepted
    ready.session.tick()  # the loss was raised once; a dead link is quiet from then on
    assert ready.session.state is SessionState.FAULT


def test_unplugging_between_ticks_makes_a_move_report_it(ready, arm):
    ready.board.close()
    report = ready.session.move(goals(arm), np.array([1.0, 1.0]))
    assert not report.is_accepted
    assert "the board is gone" in report.reason
    assert ready.session.state is SessionState.FAULT


def test_replugging_never_resumes_motion(make_bench, arm):
    first, second = make_bench(), make_bench()
    first.start()
    go(first, arm)
    first.advance(0.2)
    unplug(first)
    first.link.port, first.board, first.firmware = second.board.port, second.board, second.firmware
    first.link.n_bytes_out = 0
    first.session.open()
    assert first.session.state is SessionState.FAULT
    first.session.reset()
    assert first.session.state is SessionState.CONNECTED
    first.advance(1.0)
    assert first.link.n_bytes_out == 0
    assert np.abs(first.firmware.joints_rad - arm.home_rad).max() < 0.001
    first.session.arm()
    first.advance(0.3)
    go(first, arm)


def test_reset_without_a_link_lands_in_closed(ready):
    unplug(ready)
    ready.session.reset()
    assert ready.session.state is SessionState.CLOSED


@pytest.mark.parametrize(
    "joints",
    [
        [[np.nan, 1.0, 1.0, -1.0]],
        [[0.0, np.inf, 1.0, -1.0]],
        [[0.0, -0.01, 0.0, 0.0]],
        [[0.0, 1e308, 0.0, 0.0]],
        [[0.0, 0.2, 0.8, -1.0]],  # under the table
        [[0.0, 1.0, 1.0]],
        [],
    ],
)
def test_a_refused_move_sends_no_byte(ready, joints):
    n_sent = ready.link.n_bytes_out
    report = ready.session.move(np.array(joints), np.ones(len(joints)))
    assert not report.is_accepted
    assert report.reason
    assert len(report.joints_rad) == len(report.duration_s) == 0
    assert ready.link.n_bytes_out == n_sent
    assert ready.session.state is SessionState.ARMED


def test_a_refused_move_leaves_the_current_one_going(ready, arm):
    _, total_s = go(ready, arm)
    ready.advance(0.1)
    assert not ready.session.move(np.full((1, 4), np.nan), np.ones(1)).is_accepted
    ready.advance(total_s)
    assert np.linalg.norm(ready.firmware.points_m[3] - NEAR_TABLE_M[-1]) < 0.001


def test_a_move_too_fast_is_slowed_down_and_says_so(ready, arm):
    report = ready.session.move(goals(arm), np.array([0.02, 0.02]))
    assert report.is_accepted
    assert "slowed down" in report.reason
    assert report.duration_s.sum() > 0.4


def test_arming_goes_home_slowly_from_the_boards_last_command(make_bench, arm):
    elsewhere = np.array([0.8, 1.6, 0.4, -0.5])
    bench = make_bench(at_rad=elsewhere)
    bench.session.open()
    bench.session.arm()
    speeds, before = [], bench.firmware.joints_rad
    while bench.session.state is SessionState.MOVING:
        assert not bench.session.can_move
        assert not bench.session.move(goals(arm), np.ones(2)).is_accepted
        bench.advance(0.01)
        speeds.append(np.abs(bench.firmware.joints_rad - before).max() / 0.01)
        before = bench.firmware.joints_rad
        assert bench.t_s < 5.0
    bench.advance(0.2)
    assert bench.session.state is SessionState.ARMED
    assert max(speeds) < 1.5
    assert np.abs(bench.firmware.joints_rad - arm.home_rad).max() < 0.0015


def test_arming_a_board_that_does_not_answer_is_one_slow_move(make_bench, arm, monkeypatch):
    bench = make_bench(at_rad=np.array([0.8, 1.6, 0.4, -0.5]))
    monkeypatch.setattr(bench.firmware, "replies", lambda: b"")
    bench.session.open()
    bench.session.arm()
    bench.advance(0.2)
    assert np.isnan(bench.session.read().joints_rad).all()
    bench.advance(1.0)
    assert bench.session.state is SessionState.MOVING
    bench.advance(2.5)
    assert bench.session.state is SessionState.ARMED
    assert np.abs(bench.firmware.joints_rad - arm.home_rad).max() < 0.0015


def test_stopping_while_going_home_leaves_the_session_unarmed(make_bench):
    bench = make_bench(at_rad=np.array([0.8, 1.6, 0.4, -0.5]))
    bench.session.open()
    bench.session.arm()
    bench.advance(0.4)
    held = bench.session.read().joints_rad
    bench.session.stop()
    bench.advance(1.0)
    assert bench.session.state is SessionState.CONNECTED
    assert np.abs(bench.firmware.joints_rad - held).max() < 0.0015


def test_the_caller_can_vouch_for_the_pose(make_bench, arm):
    pose = goals(arm)[0]
    bench = make_bench(at_rad=pose)
    bench.session.open()
    bench.session.arm(at_rad=pose)
    assert bench.session.state is SessionState.ARMED
    bench.advance(0.5)
    assert np.abs(bench.firmware.joints_rad - pose).max() < 0.001


def test_a_pose_outside_the_limits_cannot_be_vouched_for(bench):
    bench.session.open()
    with pytest.raises(MotionRefused):
        bench.session.arm(at_rad=np.array([0.0, -1.0, 0.0, 0.0]))
    assert bench.session.state is SessionState.CONNECTED
    assert bench.link.n_bytes_out == 0


def test_arming_closes_the_gripper(ready, arm):
    ready.firmware.feed(rrc.encode(rrc.PwmMoveOne(0, arm.gripper.servo_id, arm.gripper.open_ticks)))
    ready.advance(1.0)
    ready.session.estop("x")
    ready.session.reset()
    ready.session.arm()
    ready.advance(1.0)
    assert ready.firmware.gripper_us == pytest.approx(arm.gripper.closed_ticks, abs=1.0)


def test_the_battery_voltage_is_known_after_a_second(ready):
    assert np.isnan(ready.session.battery_v)
    ready.advance(1.1)
    assert ready.session.battery_v == pytest.approx(7.4)


def test_garbage_from_the_board_is_ignored(ready, monkeypatch):
    noise = bytes(range(256)) + rrc.frame_bytes(7, bytes(24)) + rrc.encode(rrc.Battery(6900))
    monkeypatch.setattr(ready.link, "read_available", lambda: noise)
    ready.session.tick()
    ready.session.tick()
    assert ready.session.battery_v == pytest.approx(6.9)
    assert ready.session.state is SessionState.ARMED


def test_a_clock_that_steps_back_moves_the_arm_neither_back_nor_fast(ready, arm):
    go(ready, arm)
    ready.advance(0.2)
    before = ready.session.read().joints_rad
    ready.t_s -= 5.0
    ready.session.tick()
    ready.exchange()
    ready.firmware.step(0.01)
    assert np.abs(ready.session.read().joints_rad - before).max() < 3.0 * HORIZON_S


def test_closing_while_moving_holds_and_lets_go_of_the_port(ready, arm):
    go(ready, arm)
    ready.advance(0.2)
    held = ready.session.read().joints_rad
    ready.session.close()
    ready.exchange()
    assert ready.session.state is SessionState.CLOSED
    assert not ready.link.is_open
    ready.advance(0.5)
    assert np.abs(ready.firmware.joints_rad - held).max() < 0.0015


def test_closing_after_the_board_was_pulled_is_quiet_and_a_fault(ready, arm):
    go(ready, arm)
    ready.board.close()
    ready.session.close()
    assert ready.session.state is SessionState.FAULT
    assert not ready.link.is_open
