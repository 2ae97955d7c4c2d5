"""Live collection with real parts: session -> serial port -> pty -> firmware, and drawn pictures.

Time is simulated: it passes when the host sleeps or waits for a picture.
"""

import io
import json
import time
from types import SimpleNamespace

import numpy as np
import pytest

from apex_edge import plugins
from apex_edge.cameras.base import Camera
from apex_edge.cameras.calibration import save_camera
from apex_edge.cli import main
from apex_edge.errors import CalibrationError, CameraError
from apex_edge.types import Frame, Intrinsics
from calib import hand_eye_live, servo_live
from calib.boards import parse_board
from calib.hand_eye import solve
from calib.hand_eye_checks import apart, motion_of
from calib.hand_eye_file import load_hand_eye
from calib.pose_pairs import read_pairs
from calib.rigid import inverse, pose, turn_from_vector
from calib.servo import solve as solve_servo
from calib.simulated import BoardRenderer, Look, board_pose
from calib.verbs import hand_eye as verb
from calib.verbs import servo as servo_verb
from firmware_bridge.errors import LinkLost, MotionRefused
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.ready import ReadyArm
from firmware_bridge.session import SessionState
from firmware_bridge.simulator import PtyBoard, RrcFirmware

BOARD = parse_board("9x6", 0.010)
AIM_M = np.array([0.2, 0.0, 0.0])
# the camera sits above and behind the tip and looks along the hand (gripper x), a little down
LOOKS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
HAND = pose(
    LOOKS @ turn_from_vector(np.array([-0.22, -0.04, 0.03])), np.array([-0.045, 0.008, 0.035])
)
# the board lies on the table with its middle about at the aim
TARGET = pose(turn_from_vector(np.array([0.0, 0.0, -1.5])), np.array([0.155, 0.045, 0.001]))
LENS = Intrinsics(640, 480, 520.0, 520.0, 319.5, 239.5, np.zeros(5))


@pytest.fixture(scope="module")
def arm():
    return ArmModel.load()


class Bench:
    """A simulated arm behind a pty and the clock of both sides."""

    def __init__(self, arm):
        self.t_s, self.n_sleeps, self.stop_after = 0.0, 0, None
        self.firmware = RrcFirmware(arm)
        self.board = PtyBoard(self.firmware)
        self.link = None

    def clock(self):
        return self.t_s

    def sleep(self, seconds):
        self.n_sleeps += 1
        if self.stop_after is not None and self.n_sleeps > self.stop_after:
            raise KeyboardInterrupt
        self.pass_time(seconds)

    def pass_time(self, seconds):
        give_up_s = time.monotonic() + 2.0
        self.board.pump()
        while self.link is not None and self.board.n_bytes_in < self.link.n_bytes_out:
            self.board.pump()
            if time.monotonic() > give_up_s:
                raise LinkLost("bytes are stuck in the pseudo-terminal")
        self.firmware.step(seconds)
        self.t_s += seconds

    def ready(self, arm):
        ready = ReadyArm(arm, self.board.port, self.clock, self.sleep)
        self.link = ready.session.bus.link
        self.link.wait_readable = self.pass_time  # time passes while the host waits for answers
        return ready


@pytest.fixture
def bench(arm):
    made = Bench(arm)
    yield made
    made.board.close()


class HandCamera(Camera):
    """Sits on the simulated gripper, where the servos really stand, and draws the board."""

    type = "hand"

    def __init__(self, bench, arm):
        super().__init__()
        self._bench, self._arm, self._seq = bench, arm, 0
        self._rng = np.random.RandomState(0)
        self._renderer = BoardRenderer(BOARD, LENS)
        self._gripper = self._shown = None

    def open(self):
        pass

    def close(self):
        pass

    def read(self, timeout_s):
        self._bench.pass_time(0.25)
        self._seq += 1
        gripper = self._arm.gripper_pose(self._bench.firmware.joints_rad)[0]
        if self._gripper is None or np.abs(gripper - self._gripper).max() > 1e-6:
            self._gripper, self._shown = gripper, self._draw(inverse(gripper @ HAND) @ TARGET)
        return Frame(self._seq, self._bench.t_s, self._shown, None, None, False)

    def _draw(self, cam_from_target):
        return self._renderer.render(cam_from_target, Look(), self._rng)


def rounds(arm):
    return hand_eye_live.auto_poses(arm, AIM_M, np.random.RandomState(0))


def test_poses_chosen_by_itself_are_safe_diverse_and_the_same_each_time(arm):
    poses = rounds(arm)
    assert np.array_equal(poses, rounds(arm))
    assert len(poses) >= 15
    assert 10.0 < hand_eye_live.check_poses(arm, poses) < 300.0
    motion = motion_of(arm.gripper_pose(poses))
    assert motion.range_deg > 30.0
    assert motion.spread_deg[1] > 8.0
    assert arm.forward(poses)[:, 1:, 2].min() >= 0.03


def test_a_board_out_of_reach_is_refused(arm):
    with pytest.raises(CalibrationError, match="random poses"):
        hand_eye_live.auto_poses(arm, np.array([2.0, 0.0, 0.0]), np.random.RandomState(0))


def test_poses_that_only_yaw_are_refused_before_anything_moves(arm):
    poses = np.tile(arm.home_rad, (8, 1))
    poses[:, 0] = np.linspace(-0.8, 0.8, 8)
    with pytest.raises(CalibrationError, match="all about one axis"):
        hand_eye_live.check_poses(arm, poses)


def test_poses_too_near_the_table_are_refused_before_anything_moves(arm):
    poses = rounds(arm)
    down, is_reachable = arm.inverse(np.array([[0.15, 0.0, 0.02]]))
    assert is_reachable.all()
    poses[3] = down[0]
    with pytest.raises(MotionRefused, match="way-point 3"):
        hand_eye_live.check_poses(arm, poses)


def test_poses_of_a_file_are_in_degrees(arm, tmp_path):
    path = tmp_path / "poses.csv"
    rows = "\n".join(",".join(f"{d:.6f}" for d in np.degrees(q)) for q in rounds(arm))
    path.write_text(f"yaw,shoulder,elbow,wrist\n{rows}\n")
    assert np.allclose(hand_eye_live.read_poses(path, arm), rounds(arm), atol=1e-6)


def test_the_drawn_board_is_found_where_it_is(arm, bench):
    look = hand_eye_live.detector(LENS, BOARD)
    camera = HandCamera(bench, arm)
    worst_mm = worst_deg = n_seen = 0
    for q in rounds(arm):
        expected = inverse(arm.gripper_pose(q)[0] @ HAND) @ TARGET
        seen = look(camera._draw(expected))
        if seen is not None:
            n_seen += 1
            mm, deg = apart(seen, expected)
            worst_mm, worst_deg = max(worst_mm, mm), max(worst_deg, deg)
    assert n_seen >= 12
    assert worst_mm < 2.0
    assert worst_deg < 2.0


def test_a_charuco_board_is_found_and_a_symmetric_one_refused():
    board = parse_board("charuco:7x5", 0.012)
    expected = board_pose(board, np.array([0.01, 0.0, 0.2]), 25.0, 10.0, 170.0)
    picture = BoardRenderer(board, LENS).render(expected, Look(), np.random.RandomState(0))
    mm, deg = apart(hand_eye_live.detector(LENS, board)(picture), expected)
    assert mm < 1.0
    assert deg < 1.0
    with pytest.raises(CalibrationError, match="same after half a turn"):
        hand_eye_live.detector(LENS, parse_board("8x6", 0.01))


def test_live_round_finds_the_true_camera_on_the_simulated_gripper(arm, bench):
    told = []
    with HandCamera(bench, arm) as camera, bench.ready(arm) as ready:
        pairs = hand_eye_live.collect(
            ready, camera, hand_eye_live.detector(LENS, BOARD), rounds(arm), told.append
        )
    assert ready.session.state is SessionState.CLOSED
    assert len(told) == len(rounds(arm))
    assert len(pairs) == sum(line.endswith(": seen") for line in told) >= 12
    result = solve(pairs)
    mm, deg = apart(result.solution.gripper_from_cam, HAND)
    assert not result.verdict.is_refused
    assert mm < 2.0
    assert deg < 0.7


def test_poses_at_which_nothing_is_seen_are_left_out(arm, bench):
    seen = iter([np.eye(4), None, np.eye(4), None, None, np.eye(4)])
    poses = rounds(arm)[:6]
    with HandCamera(bench, arm) as camera, bench.ready(arm) as ready:
        pairs = hand_eye_live.collect(ready, camera, lambda _: next(seen), poses, lambda _: None)
    assert len(pairs) == 3
    told = arm.angles_rad(arm.ticks(poses[[0, 2, 5]]))
    assert np.allclose(pairs.base_from_gripper, arm.gripper_pose(told))


def test_pictures_are_taken_when_the_arm_stands(arm, bench):
    speeds = []

    def watch(_):
        before = bench.firmware.joints_rad
        bench.pass_time(0.05)
        speeds.append(np.abs(bench.firmware.joints_rad - before).max() / 0.05)

    with HandCamera(bench, arm) as camera, bench.ready(arm) as ready:
        hand_eye_live.collect(ready, camera, watch, rounds(arm)[:4], lambda _: None)
    assert max(speeds) < 1e-3


def test_the_arm_moves_slowly(arm, bench):
    speeds = []
    with bench.ready(arm) as ready:
        step = bench.firmware.step

        def measured(dt_s):
            before = bench.firmware.joints_rad
            step(dt_s)
            speeds.append(np.abs(bench.firmware.joints_rad - before).max() / dt_s)

        bench.firmware.step = measured
        for goal in rounds(arm)[:3]:
            ready.go(goal, hand_eye_live.RATE_SHARE)
    assert 0.2 < max(speeds) < 0.35 * arm.rate_rad_s.max()


def test_ctrl_c_in_the_middle_of_a_way_leaves_the_arm_standing(arm, bench):
    goal = rounds(arm)[0]
    with pytest.raises(KeyboardInterrupt), bench.ready(arm) as ready:
        bench.stop_after = bench.n_sleeps + 20
        ready.go(goal, hand_eye_live.RATE_SHARE)
    assert ready.session.state is SessionState.CLOSED
    for _ in range(10):
        bench.pass_time(0.02)
    stopped = bench.firmware.joints_rad
    assert np.abs(stopped - goal).max() > 0.1
    for _ in range(50):
        bench.pass_time(0.02)
    assert np.abs(bench.firmware.joints_rad - stopped).max() < 1e-3


def test_a_refused_way_is_told_and_nothing_moves(arm, bench):
    with bench.ready(arm) as ready:
        before = bench.firmware.joints_rad
        with pytest.raises(MotionRefused, match="outside"):
            ready.go(arm.home_rad + 5.0, 0.2)
        assert np.array_equal(bench.firmware.joints_rad, before)


def test_a_camera_on_another_clock_is_told(arm, bench):
    camera = HandCamera(bench, arm)
    with pytest.raises(CameraError, match="clock"):
        hand_eye_live._picture_after(camera, 1e9)


@pytest.fixture
def desk(arm, bench, tmp_path, monkeypatch):
    """Settings of the simulated arm; the verbs' clocks and camera are simulated ones."""
    lens = tmp_path / "lens.json"
    save_camera(lens, LENS, {})
    config = tmp_path / "apex.toml"
    config.write_text(
        f'[camera]\ntype = "hand"\ncalibration = "{lens}"\n[arm]\nport = "{bench.board.port}"\n'
    )
    load = plugins.load
    monkeypatch.setattr(
        plugins,
        "load",
        lambda kind, name: (
            (lambda _: HandCamera(bench, arm))
            if (kind, name) == ("cameras", "hand")
            else load(kind, name)
        ),
    )
    simulated = SimpleNamespace(monotonic=bench.clock, sleep=bench.sleep)
    for module in (verb, servo_verb):
        monkeypatch.setattr(module, "time", simulated)
        monkeypatch.setattr(module, "ReadyArm", lambda arm, *_: bench.ready(arm))
    return config


def words(config, out, *more):
    given = ["--config", str(config), "--board", "9x6", "--square-mm", "10", "--out", str(out)]
    return ["calibrate", "hand-eye", *given, "--json", *more]


def test_verb_drives_the_arm_and_keeps_the_pairs_beside_the_result(desk, tmp_path, capsys):
    out = tmp_path / "handeye.json"
    assert main(words(desk, out, "--yes")) == 0
    captured = capsys.readouterr()
    told = json.loads(captured.out)
    assert "Ctrl-C stops the arm" in captured.err
    mm, deg = apart(load_hand_eye(out), HAND)
    assert mm < 2.0
    assert deg < 0.7
    again = read_pairs(tmp_path / "handeye-pairs.csv")
    assert len(again) == told["n_pairs"]


@pytest.mark.parametrize("answer", ["no\n", "y\n", ""])
def test_nothing_moves_without_a_plain_yes(desk, bench, tmp_path, monkeypatch, capsys, answer):
    monkeypatch.setattr("sys.stdin", io.StringIO(answer))
    assert main(words(desk, tmp_path / "h.json")) == 2
    assert "nothing was moved" in capsys.readouterr().err
    bench.pass_time(0.1)
    assert bench.firmware.n_frames == 0
    assert not (tmp_path / "h.json").exists()


@pytest.mark.parametrize(
    "settings, reason",
    [
        ('[camera]\ntype = "hand"\n', "serial port of a real arm"),
        ('[camera]\ntype = "hand"\n[arm]\nport = "/dev/ttyX"\n', "calibration under [camera]"),
        ('[arm]\nprot = "/dev/ttyX"\n', "unknown key 'prot'"),
    ],
)
def test_settings_that_cannot_serve_are_refused(tmp_path, capsys, settings, reason):
    config = tmp_path / "apex.toml"
    config.write_text(settings)
    assert main(words(config, tmp_path / "h.json", "--yes")) == 2
    assert reason in capsys.readouterr().err


def test_servo_round_reads_the_joint_both_ways_and_finds_its_map(arm, bench):
    poses = servo_live.poses_for(arm, "yaw")

    def protractor(_):
        return float(np.degrees(bench.firmware.joints_rad[0]))

    with bench.ready(arm) as ready:
        samples = servo_live.collect(ready, "yaw", poses, protractor)
    fit = solve_servo(samples)[0]
    assert fit.servo_id == 6
    assert samples.is_up.sum() == (~samples.is_up).sum() == len(poses) - 1
    assert (np.diff(samples.ticks[samples.is_up]) > 0).all()
    assert (np.diff(samples.ticks[~samples.is_up]) < 0).all()
    assert fit.zero_ticks == pytest.approx(1500.0, abs=1.0)
    assert fit.ticks_per_rad == pytest.approx(636.6, abs=1.0)
    assert fit.backlash_deg < 0.1


def test_a_joint_whose_angles_hit_the_table_is_read_where_it_is_free(arm):
    for joint in arm.joint_names:
        poses = servo_live.poses_for(arm, joint)
        assert len(poses) >= 5
        assert arm.forward(poses)[:, 1:, 2].min() >= 0.02


def test_servo_verb_asks_for_each_angle_and_takes_no_nonsense(
    desk, bench, tmp_path, monkeypatch, capsys
):
    class Typing:
        n_asked = 0

        def readline(self):
            self.n_asked += 1
            if self.n_asked == 1:
                return "yes\n"
            if self.n_asked == 2:
                return "what?\n"
            return f"{np.degrees(bench.firmware.joints_rad[0]):.1f}\n"

    monkeypatch.setattr("sys.stdin", Typing())
    out = tmp_path / "servo.json"
    code = main(["calibrate", "servo", "--config", str(desk), "--joint", "yaw", "--out", str(out)])
    captured = capsys.readouterr()
    assert code == 0
    assert "is no number of degrees" in captured.err
    assert "[joints.yaw]" in captured.out
    assert (tmp_path / "servo-samples.csv").exists()
