"""Hand-eye calibration: what is solved, how well, and what must be refused with which reason."""

import json

import cv2
import numpy as np
import pytest

from apex_edge import documents
from apex_edge.cli import main
from apex_edge.errors import CalibrationError
from calib import hand_eye_methods
from calib.hand_eye import REFINED, solve
from calib.hand_eye_checks import apart, motion_of
from calib.hand_eye_file import hand_eye_document, load_hand_eye, table_from_cam
from calib.pose_pairs import PosePairs, pairs_from, pairs_text, read_pairs
from calib.rigid import (
    inverse,
    pose,
    quaternion_from_turn,
    turn_from_quaternion,
    turn_from_vector,
    vector_from_turn,
)
from calib.verdict import PASS, REFUSE, WARN
from firmware_bridge.kinematics import ArmModel
from offline_train.benchmarks.hand_eye import HAND, SPOILS, Noise, campaign, simulate

EXACT = Noise(0.0, 0.0, 0.0, 0.0)
GOOD = Noise(0.1, 0.3, 0.2, 0.5)
PLAIN_KEYS = {
    *("verdict", "reasons", "method", "translation_m", "quaternion_xyzw", "scatter_rms_mm"),
    *("scatter_rms_deg", "n_pairs", "n_used", "rejected", "methods"),
}


def rng(seed=0):
    return np.random.RandomState(seed)


@pytest.fixture(scope="module")
def sound():
    return simulate(20, rng(), noise=GOOD)


def written(tmp_path, pairs):
    path = tmp_path / "pairs.csv"
    path.write_text(pairs_text(pairs))
    return path


def calibrate(tmp_path, path, *words):
    out = tmp_path / "handeye.json"
    code = main(
        ["calibrate", "hand-eye", "--pairs", str(path), "--out", str(out), "--json", *words]
    )
    return code, out


def shaken(pairs, row, deg=0.0, mm=0.0):
    target = pairs.cam_from_target.copy()
    knock = pose(turn_from_vector(np.radians([deg, 0.0, 0.0])), 1e-3 * np.array([0.0, mm, 0.0]))
    target[row] = target[row] @ knock
    return PosePairs(pairs.base_from_gripper, target, pairs.row)


def test_rotation_vector_and_quaternion_survive_every_angle_up_to_a_half_turn():
    axes = rng().standard_normal((50, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    for angle in (0.0, 1e-9, 1e-4, 1.0, 3.0, np.pi - 1e-7):
        turns = turn_from_vector(angle * axes)
        assert np.allclose(vector_from_turn(turns), angle * axes, atol=1e-6)
        assert np.allclose(turn_from_quaternion(quaternion_from_turn(turns)), turns, atol=1e-12)


@pytest.mark.parametrize("name", sorted(hand_eye_methods.methods()))
def test_every_method_finds_the_exact_answer_from_exact_poses(name):
    pairs = simulate(12, rng(), noise=EXACT)
    found = hand_eye_methods.methods()[name](pairs.base_from_gripper, pairs.cam_from_target)
    mm, deg = apart(found, HAND)
    assert mm < 1e-3
    assert deg < 1e-3


def test_each_method_of_opencv_is_really_a_different_one():
    pairs = simulate(12, rng())
    methods = hand_eye_methods.methods()
    names = [name for name in methods if name.startswith("opencv-")]
    if not names:
        pytest.skip("this OpenCV has no hand-eye calibration")
    found = [methods[n](pairs.base_from_gripper, pairs.cam_from_target)[:3, 3] for n in names]
    assert len({tuple(np.round(place, 7)) for place in found}) == len(names) == 5


def test_own_solver_gives_what_opencv_gives_for_park(sound):
    methods = hand_eye_methods.methods()
    if "opencv-park" not in methods:
        pytest.skip("this OpenCV has no hand-eye calibration")
    both = [
        methods[name](sound.base_from_gripper, sound.cam_from_target)
        for name in ("park", "opencv-park")
    ]
    assert np.allclose(*both, atol=1e-6)


def test_an_opencv_without_hand_eye_is_made_up_for(sound, monkeypatch):
    if hasattr(cv2, "calibrateHandEye"):
        monkeypatch.delattr(cv2, "calibrateHandEye")
    result = solve(sound)
    assert {score.name for score in result.methods} == {"park", REFINED}
    mm, deg = apart(result.solution.gripper_from_cam, HAND)
    assert result.verdict.grade == PASS
    assert mm < 2.0
    assert deg < 0.5


def test_the_chosen_method_scatters_least_of_all_closed_ones(sound):
    result = solve(sound)
    others = [score.weighed for score in result.methods if score.name != REFINED]
    chosen = next(s for s in result.methods if s.name == result.solution.method)
    assert chosen.weighed == min(others)


def test_refinement_wins_only_when_asked_to():
    pairs = simulate(25, rng(), noise=Noise(0.02, 0.1, 0.5, 1.0))
    assert solve(pairs).solution.method != REFINED
    refined = solve(pairs, is_refined=True)
    assert refined.solution.method == REFINED
    assert refined.solution.scatter_mm < solve(pairs).solution.scatter_mm


def test_stated_sd_is_honest_over_many_simulated_arms():
    ratios = []
    for seed in range(20):
        found = solve(simulate(12, rng(seed))).solution
        error = 1e3 * (found.gripper_from_cam - HAND)[:3, 3]
        ratios.append(np.linalg.norm(error) / np.linalg.norm(found.sd_mm))
    assert 0.4 < np.median(ratios) < 1.6


def test_left_out_scatter_is_larger_than_the_scatter_in_sample(sound):
    for score in solve(sound).methods:
        assert score.scatter_rms_mm > score.in_sample_mm


def test_two_axes_of_a_small_arm_are_enough():
    result = solve(simulate(20, rng(1), n_axes=2))
    mm, deg = apart(result.solution.gripper_from_cam, HAND)
    assert not result.verdict.is_refused
    assert mm < 5.0
    assert deg < 1.5


def test_real_pairs_are_within_their_tolerance_and_as_good_as_the_best_of_opencv(real_data):
    folder = real_data / "handeye"
    truth = json.loads((folder / "truth.json").read_text())
    result = solve(read_pairs(folder / truth["file"]))
    found = result.solution
    off = found.gripper_from_cam[:3, 3] - truth["expect_t_gripper_to_camera_m"]
    assert result.verdict.grade == PASS
    assert np.linalg.norm(off) <= truth["tolerance_m"]
    by_opencv = [s.scatter_rms_mm for s in result.methods if s.name.startswith("opencv-")]
    assert found.scatter_mm <= min(by_opencv, default=np.inf) + 1e-9
    in_sample = next(s.in_sample_mm for s in result.methods if s.name == found.method)
    assert in_sample == pytest.approx(truth["scatter_rms_mm"], abs=0.3)


@pytest.mark.parametrize("n", [0, 1, 4])
def test_too_few_poses_are_refused_and_how_many_are_needed_is_said(n):
    result = solve(simulate(n, rng()))
    assert result.verdict.grade == REFUSE
    assert f"{n} pose pairs; at least 5 are needed" in result.verdict.reasons[0]


def test_few_poses_are_warned_about():
    result = solve(simulate(9, rng(), noise=GOOD))
    assert result.verdict.grade == WARN
    assert any("9 pose pairs (wanted at least 15)" in reason for reason in result.verdict.reasons)


def test_a_single_axis_is_refused_and_the_missing_motion_is_named():
    result = solve(simulate(20, rng(), n_axes=1))
    assert result.verdict.grade == REFUSE
    assert result.solution is None
    assert "all about one axis" in result.verdict.reasons[0]
    assert "turn the gripper about its x and y" in " ".join(
        result.verdict.reasons
    ) or "turn the gripper about its y and x" in " ".join(result.verdict.reasons)


def test_small_turns_are_refused_with_the_largest_turn():
    result = solve(simulate(20, rng(), half_range_deg=2.0))
    assert result.verdict.grade == REFUSE
    assert "turns by at most" in result.verdict.reasons[0]


def test_repeated_poses_do_not_count_twice(sound):
    twice = sound.pick(np.repeat(np.arange(4), 5))
    result = solve(twice)
    assert result.verdict.grade == REFUSE
    assert "only 4 of 20 gripper poses differ" in result.verdict.reasons[0]
    with_one = sound.pick(np.append(np.arange(20), 3))
    with_one = PosePairs(with_one.base_from_gripper, with_one.cam_from_target, np.arange(1, 22))
    assert solve(with_one).rejected == ((21, "repeats an earlier pose"),)


@pytest.mark.parametrize("deg, mm", [(15.0, 0.0), (0.0, 60.0), (-40.0, 300.0)])
def test_a_wrong_pair_is_rejected_by_its_own_error_and_named(sound, deg, mm):
    clean = solve(sound).solution.gripper_from_cam
    result = solve(shaken(sound, 6, deg, mm))
    assert [row for row, _ in result.rejected] == [7]
    assert not result.verdict.is_refused
    off_mm, off_deg = apart(result.solution.gripper_from_cam, clean)
    assert off_mm < 1.5
    assert off_deg < 0.3


def test_a_majority_of_wrong_pairs_is_refused(sound):
    pairs = sound
    for row in range(0, 12):
        pairs = shaken(pairs, row, 10.0 + 9.0 * row, 20.0 * row)
    result = solve(pairs)
    assert result.verdict.grade == REFUSE
    assert "agree" in result.verdict.reasons[0]


def test_shuffled_rows_are_refused_with_the_mismatch_of_the_turns(sound):
    order = rng(3).permutation(len(sound))
    result = solve(PosePairs(sound.base_from_gripper, sound.cam_from_target[order], sound.row))
    assert result.verdict.grade == REFUSE
    assert "the rows do not belong together" in result.verdict.reasons[0]


def w_first(poses):
    quaternion = quaternion_from_turn(poses[:, :3, :3])
    return pose(turn_from_quaternion(np.roll(quaternion, 1, axis=1)), poses[:, :3, 3])


@pytest.mark.parametrize(
    "of_gripper, of_target, advice",
    [
        (np.array, inverse, "camera->target is written the other way round"),
        (inverse, np.array, "base->gripper is the other way round"),
        (inverse, inverse, "both poses are written the other way round"),
        (w_first, w_first, "quaternions are in the order w, x, y, z"),
    ],
)
def test_poses_written_another_way_are_refused_with_the_cure(sound, of_gripper, of_target, advice):
    pairs = PosePairs(
        of_gripper(sound.base_from_gripper), of_target(sound.cam_from_target), sound.row
    )
    result = solve(pairs)
    assert result.verdict.grade == REFUSE
    assert advice in " ".join(result.verdict.reasons)


def test_a_moved_target_is_refused(sound):
    gripper = sound.base_from_gripper.copy()
    gripper[::2, :3, 3] += rng().uniform(-0.08, 0.08, (10, 3))
    result = solve(PosePairs(gripper, sound.cam_from_target, sound.row))
    assert result.verdict.grade == REFUSE
    assert "translations are wrong" in result.verdict.reasons[0]


@pytest.mark.parametrize("name", sorted(SPOILS))
def test_a_spoilt_file_is_refused_or_solved_without_what_was_spoilt(sound, name):
    count = campaign(sound, name, 1)
    is_minority = name == "two rows swapped" or name.startswith("up to 30 %")
    assert count["wrong"] == 0
    assert count["right" if is_minority else "refused"] == 1
    assert count["reason"]


@pytest.mark.parametrize(
    "change, reason",
    [
        (lambda text: "", "the file is empty"),
        (lambda text: text.split("\n", 1)[1], "first line must name the columns"),
        (lambda text: text.replace("\n", ",1\n").replace(",1\n", "\n", 1), "15 columns"),
        (lambda text: text.split("\n")[0] + "\n1,2,3\n", "row 1 has 3 columns, expected 14"),
        (lambda text: text.split("\n")[0] + "\n" + "nan," * 13 + "1\n", "not a finite number"),
        (lambda text: text.split("\n")[0] + "\n" + "0," * 13 + "0\n", "length 0, expected 1"),
        (lambda text: text.split("\n")[0] + "\n" + "500,0,0,0,0,0,1," * 2 + "\n", "15 columns"),
        (
            lambda text: text.split("\n")[0] + "\n500,0,0,0,0,0,1,0,0,0,0,0,0,1\n",
            "metres, not millimetres",
        ),
        (
            lambda text: text.replace("gripper_qx", "q").replace("gripper_qw", "gripper_qx"),
            "",
        ),
        (lambda text: "x,y,z,qw,qx,qy,qz,x,y,z,qw,qx,qy,qz\n", "order x, y, z, w"),
    ],
)
def test_a_corrupt_file_is_refused_with_its_place(tmp_path, sound, change, reason):
    path = tmp_path / "pairs.csv"
    path.write_text(change(pairs_text(sound)))
    if not reason:  # other names for the columns are no fault
        assert len(read_pairs(path)) == len(sound)
        return
    with pytest.raises(CalibrationError, match=reason) as error:
        read_pairs(path)
    assert str(path) in str(error.value)


def test_a_file_that_is_not_text_or_not_there_is_refused(tmp_path):
    path = tmp_path / "pairs.csv"
    path.write_bytes(b"\xff\xfe\x00\x01" * 9)
    for each in (path, tmp_path / "none.csv", tmp_path):
        with pytest.raises(CalibrationError, match="cannot read"):
            read_pairs(each)


def test_pairs_from_arrays_must_be_rigid(sound):
    scaled = sound.base_from_gripper.copy()
    scaled[3, :3, :3] *= 1.01
    with pytest.raises(CalibrationError, match="pair 4: base_from_gripper is not a rigid"):
        pairs_from(scaled, sound.cam_from_target)
    with pytest.raises(CalibrationError, match="two arrays"):
        pairs_from(sound.base_from_gripper, sound.cam_from_target[:3])


def test_verb_writes_a_signed_file_and_a_picture_and_tells_all_as_json(tmp_path, capsys, sound):
    code, out = calibrate(tmp_path, written(tmp_path, sound))
    told = json.loads(capsys.readouterr().out)
    assert code == 0
    assert set(told) >= PLAIN_KEYS
    assert told["verdict"] == PASS
    assert told["n_used"] == told["n_pairs"] == 20
    document = documents.read(out, "apex-hand-eye", 1, CalibrationError)
    assert document["translation_m"] == told["translation_m"]
    assert len(document["made"]["poses"]) == 20
    assert document["made"]["data_sha256"]
    assert cv2.imread(told["picture"]).shape[1] == 960
    assert np.allclose(load_hand_eye(out)[:3, 3], told["translation_m"])


def test_verb_refuses_with_exit_code_2_tells_why_as_json_and_writes_nothing(tmp_path, capsys):
    path = written(tmp_path, simulate(20, rng(), n_axes=1))
    code, out = calibrate(tmp_path, path)
    captured = capsys.readouterr()
    told = json.loads(captured.out)
    assert code == 2
    assert told["verdict"] == REFUSE
    assert told["translation_m"] is None
    assert told["reasons"][0] in captured.err
    assert [each.name for each in tmp_path.iterdir()] == ["pairs.csv"]


def test_verb_tells_a_corrupt_file_as_json_too(tmp_path, capsys):
    path = tmp_path / "pairs.csv"
    path.write_text("a,b\n1,2\n")
    code, _ = calibrate(tmp_path, path)
    told = json.loads(capsys.readouterr().out)
    assert code == 2
    assert told["verdict"] == REFUSE
    assert "2 columns, expected 14" in told["reasons"][0]


def test_text_output_lists_the_methods(tmp_path, capsys, sound):
    out = tmp_path / "h.json"
    path = written(tmp_path, sound)
    assert main(["calibrate", "hand-eye", "--pairs", str(path), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "left out" in text
    assert "park" in text
    assert "mm" in text


def test_a_file_changed_by_hand_is_not_loaded(tmp_path):
    path = tmp_path / "h.json"
    path.write_text(documents.to_text(hand_eye_document(HAND, {})))
    assert np.array_equal(load_hand_eye(path), HAND)
    path.write_text(path.read_text().replace("0.06", "0.07", 1))
    with pytest.raises(CalibrationError, match="does not match its hash"):
        load_hand_eye(path)


@pytest.mark.parametrize(
    "wrong", [np.eye(3), 2.0 * np.eye(4), np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0])]
)
def test_a_document_of_no_rigid_pose_is_not_made(wrong):
    with pytest.raises(CalibrationError, match="gripper_from_cam"):
        hand_eye_document(wrong, {})


def test_camera_in_the_hand_is_placed_over_the_table_by_the_joints():
    arm = ArmModel.load()
    joints = np.array([[0.0, 1.2, 0.8, -0.6], [0.7, 1.0, 1.1, -0.9]])
    placed = table_from_cam(arm, joints, np.eye(4))
    assert np.allclose(placed[:, :3, 3], arm.tip(joints))
    moved = table_from_cam(arm, joints, pose(np.eye(3), np.array([0.05, 0.0, 0.0])))
    along = arm.tip(joints) - arm.forward(joints)[:, 2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    assert np.allclose(moved[:, :3, 3] - placed[:, :3, 3], 0.05 * along)


def test_spread_of_axes_is_that_of_the_motion():
    about_z = pose(turn_from_vector(np.radians([[0, 0, a] for a in (0, 20, 40)])), np.zeros((3, 3)))
    motion = motion_of(about_z)
    assert motion.range_deg == pytest.approx(40.0)
    assert motion.spread_deg[1] == pytest.approx(0.0, abs=1e-6)
    assert abs(motion.axes[0, 2]) == pytest.approx(1.0)


def test_garbled_files_are_typed_errors_and_nothing_else(tmp_path, sound):
    """Cells and characters replaced at random: refused, or read as finite rigid poses."""
    random, path = rng(5), tmp_path / "pairs.csv"
    tokens = ["nan", "-inf", "1e308", "", "-1", '"', "\n", "x", "\0", "9" * 400, "0", ","]
    text = pairs_text(sound)
    for _ in range(300):
        letters = list(text)
        for place in random.randint(len(letters), size=random.randint(1, 6)):
            letters[place] = tokens[random.randint(len(tokens))]
        path.write_text("".join(letters))
        try:
            pairs = read_pairs(path)
        except CalibrationError:
            continue
        assert np.isfinite(pairs.base_from_gripper).all()
        assert np.isfinite(pairs.cam_from_target).all()
