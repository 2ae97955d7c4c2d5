import numpy as np
import pytest

from apex_edge.act import ActConfig, Actuator
from apex_edge.types import ArmState, Candidates, Decision
from firmware_bridge.guard import check_path
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.links.serial_link import SerialLink
from firmware_bridge.session import ArmSession, SessionState
from firmware_bridge.simulator import PtyBoard, RrcFirmware

ARM = ArmModel.load("armpi-mini")
TIP_Z_M, HOVER_Z_M = 0.005, 0.06


def grid(n, seed):
    """Return n reachable candidates, drawn evenly over the reachable half ring."""
    rng = np.random.default_rng(seed)
    radius, yaw = rng.uniform(0.085, 0.19, n), rng.uniform(-1.5, 1.5, n)
    tip = np.stack([radius * np.cos(yaw), radius * np.sin(yaw), np.full(n, TIP_Z_M)], axis=1)
    above = tip.copy()
    above[:, 2] = HOVER_Z_M
    joints, is_reachable = ARM.inverse(tip)
    hover, is_clear = ARM.inverse(above)
    assert (is_reachable & is_clear).all()
    return Candidates(1, tip, joints, hover)


class Rig:
    """An actuator over a pty board, on one simulated clock."""

    def __init__(self, candidates, config=None):
        self.t_s = 0.0
        self.firmware = RrcFirmware(ARM)
        self.board = PtyBoard(self.firmware)
        self.link = SerialLink(self.board.port)
        self.link.wait_readable = self.let_pass  # while the host waits for an answer
        self.session = ArmSession(ARM, self.link, lambda: self.t_s)
        self.actuator = Actuator(self.session, ARM, candidates, config)
        self.candidates = candidates
        self._ticks_left = 0

    def start(self):
        self.session.open()
        self.session.arm()
        while self.session.state is not SessionState.ARMED:
            self.advance(0.01)
            assert self.t_s < 5.0

    def let_pass(self, seconds):
        self.board.pump()
        self.firmware.step(seconds)
        self.t_s += seconds

    def advance(self, seconds, dt_s=0.005):
        """Tick the session every 30 ms and step the servos every 5 ms."""
        for _ in range(int(round(seconds / dt_s))):
            if self._ticks_left == 0:
                self.session.tick()
                self._ticks_left = 6
            self._ticks_left -= 1
            while self.board.n_bytes_in < self.link.n_bytes_out:
                self.board.pump()
            self.board.pump()
            self.firmware.step(dt_s)
            self.t_s += dt_s

    def act(self, action, index=-1, **more):
        decision = Decision(7, self.t_s, action, "reflex", index=index, **more)
        return self.actuator.execute(decision, 7, self.t_s)

    def travel_s(self):
        return self.actuator.travel_s(self.candidates, self.actuator.state())

    @property
    def tip_m(self):
        return self.firmware.points_m[3]


@pytest.fixture
def rig():
    made = Rig(grid(40, 5))
    made.start()
    yield made
    made.session.close()
    made.board.close()


def test_the_tip_stands_at_every_target_by_the_time_travel_s_promised(rig):
    """From wherever the arm happens to be: home, high, low and half way elsewhere."""
    late_s, early_s = [], []
    for i, target in enumerate(rig.candidates.tip_m):
        promised_s, begin_s = float(rig.travel_s()[i]), rig.t_s
        _, ack = rig.act("intervene", i)
        assert ack.is_accepted, ack.reason
        last_away_s = begin_s
        while rig.t_s < begin_s + promised_s + 0.2:
            rig.advance(0.005)
            if np.linalg.norm(rig.tip_m - target) > 0.001:
                last_away_s = rig.t_s
        late_s.append(last_away_s - begin_s - promised_s)
        early_s.append(-late_s[-1])
        if i % 4 == 3:  # leave some moves half way
            rig.act("return")
            rig.advance(0.15)
    assert max(late_s) <= 0.05
    assert max(early_s) <= 0.2  # not won by promising little
    assert rig.firmware.n_bad_crc == rig.firmware.n_rejected == rig.firmware.n_clamped == 0


def test_travel_s_is_the_schedule_that_execute_sends_plus_the_lag(rig):
    for i in (0, 7, 19):
        promised_s = rig.travel_s()[i]
        command, ack = rig.act("redirect", i)
        assert np.isclose(promised_s, command.duration_s.sum() + ARM.lag_s)
        assert np.allclose(ack.duration_s, command.duration_s)
        rig.advance(0.35)  # half way: the next one starts from a moving arm


def test_travel_s_takes_all_candidates_of_a_run_at_once(rig):
    many = grid(1412, 9)
    state = rig.actuator.state()
    together = rig.actuator.travel_s(many, state)
    assert together.shape == (1412,)
    assert np.isfinite(together).all()
    for i in (0, 500, 1411):
        one = Candidates(
            1, many.tip_m[i : i + 1], many.joints_rad[i : i + 1], many.hover_rad[i : i + 1]
        )
        assert np.isclose(rig.actuator.travel_s(one, state)[0], together[i])


def test_travel_s_grows_when_the_tip_is_low_and_must_be_lifted(rig):
    joints = rig.candidates.joints_rad[3]
    low = ArmState(0.0, joints, ARM.tip(joints)[0], False, "commanded")
    hover = rig.candidates.hover_rad[3]
    high = ArmState(0.0, hover, ARM.tip(hover)[0], False, "commanded")
    from_low = rig.actuator.travel_s(rig.candidates, low)
    from_high = rig.actuator.travel_s(rig.candidates, high)
    lift_s = ARM.travel_time_s(joints, hover[None])[0] / 0.9
    assert np.allclose(from_low - from_high, lift_s)


def test_no_candidate_is_promised_while_the_arm_cannot_move(rig):
    assert np.isfinite(rig.travel_s()).all()
    rig.session.estop("button")
    assert np.isinf(rig.travel_s()).all()


def test_the_arm_goes_up_before_it_goes_sideways(rig):
    rig.act("intervene", 0)
    rig.advance(2.0)
    begin = rig.tip_m.copy()
    far = int(np.argmax(np.linalg.norm(rig.candidates.tip_m - begin, axis=1)))
    command, _ = rig.act("redirect", far)
    heights = ARM.tip(command.joints_rad)[:, 2]
    assert np.allclose(heights, [HOVER_Z_M, HOVER_Z_M, TIP_Z_M], atol=1e-9)
    while rig.session.state is SessionState.MOVING:
        rig.advance(0.01)
        sideways = np.linalg.norm((rig.tip_m - begin)[:2])
        to_go = np.linalg.norm((rig.tip_m - rig.candidates.tip_m[far])[:2])
        if sideways > 0.025 and to_go > 0.025:
            assert rig.tip_m[2] > 0.035  # higher than a ball or block


def test_a_tip_already_high_is_not_lifted(rig):
    command, _ = rig.act("intervene", 4)
    assert len(command.joints_rad) == 2


def test_return_lifts_and_goes_home(rig):
    rig.act("intervene", 4)
    rig.advance(2.0)
    command, ack = rig.act("return")
    rig.advance(2.0)
    assert ack.is_accepted
    assert len(command.joints_rad) == 2
    assert np.linalg.norm(rig.tip_m - ARM.tip(ARM.home_rad)[0]) < 0.001


def test_returning_from_home_is_accepted_and_still(rig):
    _, ack = rig.act("return")
    rig.advance(0.3)
    assert ack.is_accepted
    assert np.linalg.norm(rig.tip_m - ARM.tip(ARM.home_rad)[0]) < 0.001


@pytest.mark.parametrize("action", ["none", "watch", "hold"])
def test_other_actions_command_nothing(rig, action):
    n_sent = rig.link.n_bytes_out
    assert rig.act(action, 3) == (None, None)
    assert rig.link.n_bytes_out == n_sent


def test_a_decision_can_name_a_point_instead_of_a_candidate(rig):
    _, ack = rig.act("intervene", target_m=(0.15, -0.03, 0.005))
    rig.advance(2.0)
    assert ack.is_accepted
    assert np.linalg.norm(rig.tip_m - [0.15, -0.03, 0.005]) < 0.001


@pytest.mark.parametrize(
    "target_m",
    [
        None,
        (0.5, 0.0, 0.005),
        (-0.15, 0.0, 0.005),
        (float("nan"), 0.0, 0.005),
        (float("inf"), 0.0, 0.005),
        (0.15, 0.0, -0.02),
        (0.12, 0.0, 0.001),
    ],
)
def test_a_target_out_of_reach_or_under_the_table_sends_no_byte(rig, target_m):
    n_sent = rig.link.n_bytes_out
    command, ack = rig.act("intervene", target_m=target_m)
    assert command is not None
    assert not ack.is_accepted
    assert ack.reason
    assert len(ack.joints_rad) == 0
    assert rig.link.n_bytes_out == n_sent


def test_the_ack_tells_when_the_bytes_were_out_and_whose_frame_it_was(rig):
    rig.advance(0.5)
    n_sent = rig.link.n_bytes_out
    _, ack = rig.act("intervene", 2)
    assert ack.t_sent_s == rig.t_s
    assert ack.seq == 7
    assert rig.link.n_bytes_out > n_sent


def test_before_arming_nothing_is_known_and_nothing_moves():
    rig = Rig(grid(3, 1))
    rig.session.open()
    assert np.isnan(rig.actuator.state().tip_m).all()
    assert np.isinf(rig.travel_s()).all()
    _, ack = rig.act("intervene", 0)
    assert not ack.is_accepted
    assert "pose is not known" in ack.reason
    assert rig.link.n_bytes_out == 0
    rig.session.close()
    rig.board.close()


def test_an_unplugged_arm_is_reported_not_raised(rig):
    rig.board.close()
    _, ack = rig.act("intervene", 0)
    assert not ack.is_accepted
    assert "the board is gone" in ack.reason
    assert rig.session.state is SessionState.FAULT


def test_stop_holds_the_tip_where_it_is(rig):
    rig.act("intervene", 6)
    rig.advance(0.3)
    rig.actuator.stop()
    held = rig.actuator.state()
    rig.advance(1.0)
    assert not held.is_moving
    assert held.source == "commanded"
    assert np.linalg.norm(rig.tip_m - held.tip_m) < 0.001


def test_a_slower_share_of_the_rate_takes_longer():
    fast, slow = Rig(grid(5, 2)), Rig(grid(5, 2), ActConfig(rate_share=0.45))
    for each in (fast, slow):
        each.start()
    quick = fast.travel_s() - ARM.lag_s
    assert np.allclose(slow.travel_s() - ARM.lag_s, 2 * quick)
    command, ack = slow.act("intervene", 1)
    assert ack.is_accepted
    assert np.isclose(command.duration_s.sum(), 2 * quick[1])
    for each in (fast, slow):
        each.session.close()
        each.board.close()


def test_every_pair_of_candidates_is_a_way_the_guard_lets_through():
    many = grid(120, 11)
    session = ArmSession(ARM, SerialLink("unused"), lambda: 0.0)
    actuator = Actuator(session, ARM, many)
    for start in (ARM.home_rad, many.joints_rad[17], many.hover_rad[80]):
        for i in range(120):
            goal = np.stack([many.hover_rad[i], many.joints_rad[i]])
            joints, duration = actuator._way_points(start, goal)
            path = check_path(ARM, start, joints, duration)
            assert not path.is_stretched
