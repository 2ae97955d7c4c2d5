"""The camera over the table: known poses recovered, everything doubtful refused, the verb."""

import argparse
import json
import math

import cv2
import numpy as np
import pytest
from board_scene import CHARUCO, LENS, camera_at, on_table, parsed, photo
from hypothesis import given
from hypothesis import strategies as st

from apex_edge.cameras.calibration import load_camera, save_camera
from apex_edge.cli import main
from apex_edge.errors import CalibrationError, ConfigError, RecordingError
from apex_edge.geometry import on_plane, project
from apex_edge.types import CameraModel, Intrinsics
from calib import table
from calib.boards import parse_board
from calib.detect import View, detect
from calib.table import Placement
from calib.verbs import table as verb
from calib.verdict import PASS, REFUSE, WARN

CAMERA = camera_at((0.55, 0.05, 0.45), (0.2, 0.0, 0.0))
THICK_M = 0.003
HERE, THERE = Placement(0.12, -0.10, 0.2), Placement(0.10, 0.05, -0.3)
HAND_M = np.array([[0.1, -0.15], [0.1, 0.15], [0.3, 0.15], [0.3, -0.15], [0.2, 0.0], [0.15, 0.1]])


def sighting(camera, where=HERE, noise_px=0.1, seed=0, board=CHARUCO, stated=None):
    """Return a board at ``where``, said to lie at ``stated``, as the camera sees its corners."""
    points = board.corners_m()
    there = points @ on_table(where, THICK_M)[:3, :3].T + on_table(where, THICK_M)[:3, 3]
    noise = np.random.RandomState(seed).normal(0.0, noise_px, (len(points), 2))
    pixels = project(camera, there)[0] + noise
    view = View(f"p{seed}", (640, 480), np.arange(len(points)), pixels, points)
    return table.place(view, board, stated or where)


def by_hand(camera, table_m=HAND_M, height_m=0.0, noise_px=0.0):
    at_height = np.column_stack([table_m, np.full(len(table_m), height_m)])
    noise = np.random.RandomState(0).normal(0.0, noise_px, (len(table_m), 2))
    return table.points(project(camera, at_height)[0] + noise, table_m)


def error_mm(found, true):
    """Return how far off the found camera maps the true pixels of the workspace, at most."""
    x, y = np.meshgrid(np.linspace(0.05, 0.35, 5), np.linspace(-0.2, 0.2, 5))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(25)])
    there = on_plane(found, project(true, points)[0], np.zeros(25))
    return 1e3 * float(np.linalg.norm(there - points, axis=1).max())


def test_board_in_a_picture_gives_the_camera_within_the_stated_error():
    picture = photo(CAMERA, CHARUCO, HERE, THICK_M)
    view = detect(picture, CHARUCO)
    result = table.solve(LENS, [table.place(view, CHARUCO, HERE)], THICK_M)
    assert result.verdict.grade == PASS
    assert error_mm(result.camera, CAMERA) <= 2.0
    off_m = result.camera.table_from_cam[:3, 3] - CAMERA.table_from_cam[:3, 3]
    assert np.all(np.abs(off_m) <= 5.0 * result.sd_translation_m)


def test_stated_uncertainty_is_honest():
    off = []
    for seed in range(20):
        result = table.solve(LENS, [sighting(CAMERA, seed=seed)], THICK_M)
        shift = result.camera.table_from_cam[:3, 3] - CAMERA.table_from_cam[:3, 3]
        turn = CAMERA.table_from_cam[:3, :3].T @ result.camera.table_from_cam[:3, :3]
        off.append([*(shift / result.sd_translation_m),
                    *(cv2.Rodrigues(turn)[0].ravel() / result.sd_rotation_rad)])  # fmt: skip
    # 120 normalised errors, correlated within a run
    assert 0.7 <= np.sqrt(np.mean(np.square(off))) <= 1.4


def test_two_boards_are_solved_together_and_know_more():
    one = table.solve(LENS, [sighting(CAMERA, HERE)], THICK_M)
    both = [sighting(CAMERA, HERE), sighting(CAMERA, THERE, seed=1)]
    two = table.solve(LENS, both, THICK_M)
    assert two.verdict.grade == PASS
    assert (two.sd_translation_m < one.sd_translation_m).all()
    assert error_mm(two.camera, CAMERA) <= 1.0


def test_thickness_of_the_board_is_taken_off_the_table():
    thick = table.solve(LENS, [sighting(CAMERA, noise_px=0.0)], THICK_M)
    thin = table.solve(LENS, [sighting(CAMERA, noise_px=0.0)], 0.0)
    lift_m = thick.camera.table_from_cam[:3, 3] - thin.camera.table_from_cam[:3, 3]
    assert np.allclose(lift_m, (0.0, 0.0, THICK_M), atol=1e-6)
    assert error_mm(thick.camera, CAMERA) <= 0.01


@given(
    eye=st.tuples(st.floats(0.3, 0.8), st.floats(-0.3, 0.3), st.floats(0.3, 0.8)),
    angle_rad=st.floats(-math.pi, math.pi),
)
def test_exact_corners_give_the_exact_camera(eye, angle_rad):
    camera = camera_at(eye, (0.2, 0.01, 0.0))
    where = Placement(0.2, 0.0, angle_rad)
    result = table.solve(LENS, [sighting(camera, where, noise_px=0.0)], THICK_M)
    assert np.allclose(result.camera.table_from_cam, camera.table_from_cam, atol=1e-4)


def test_homography_maps_undistorted_pixels_to_the_table():
    result = table.solve(LENS, [sighting(CAMERA, noise_px=0.0)], THICK_M)
    points = np.column_stack([HAND_M, np.zeros(len(HAND_M))])
    flat = CameraModel(**{**vars(CAMERA), "dist": np.zeros(5)})
    there = cv2.perspectiveTransform(project(flat, points)[0][:, None], result.table_from_px)
    assert np.allclose(there[:, 0], HAND_M, atol=1e-5)


def test_noisy_corners_warn_with_the_error_in_millimetres():
    result = table.solve(LENS, [sighting(CAMERA, noise_px=0.7)], THICK_M)
    assert result.verdict.grade == WARN
    assert any("workspace moves by" in reason for reason in result.verdict.reasons)


def test_left_out_points_foretell_the_true_error():
    for seed in range(5):
        result = table.solve(LENS, [sighting(CAMERA, noise_px=0.3, seed=seed)], THICK_M)
        assert error_mm(result.camera, CAMERA) <= 3.0 * result.workspace_mm


def test_wrongly_stated_place_of_one_board_is_refused():
    wrong = Placement(THERE.x_m + 0.02, THERE.y_m, THERE.angle_rad)
    both = [sighting(CAMERA, HERE), sighting(CAMERA, THERE, stated=wrong)]
    result = table.solve(LENS, both, THICK_M)
    assert result.verdict.grade == REFUSE
    assert "all stated places" in result.verdict.reasons[0]


def test_small_board_whose_two_poses_fit_alike_is_refused():
    board = parse_board("charuco:4x4", 0.010)
    for seed in range(3):
        with pytest.raises(CalibrationError, match="ambiguous: two poses"):
            table.solve(LENS, [sighting(CAMERA, Placement(0.2, 0.0), 0.3, seed, board)], THICK_M)


def test_straight_down_two_like_poses_are_one_and_no_reason_to_refuse():
    camera = camera_at((0.2, 0.001, 0.5), (0.2, 0.0, 0.0))
    result = table.solve(LENS, [sighting(camera, Placement(0.12, -0.06))], THICK_M)
    assert not result.verdict.is_refused
    assert error_mm(result.camera, camera) <= 3.0


def test_symmetric_chessboard_is_refused_for_the_table():
    with pytest.raises(CalibrationError, match="half a turn.*ChArUco"):
        sighting(CAMERA, board=parse_board("8x6", 0.02))


def test_camera_that_looks_along_the_table_is_refused():
    low = camera_at((0.9, 0.0, 0.05), (0.2, 0.0, 0.0))
    points = np.column_stack([np.tile([0.2, 0.4, 0.6], 2), np.repeat([-0.1, 0.1], 3)])
    result = table.solve(LENS, [by_hand(low, points)], 0.0)
    assert result.verdict.grade == REFUSE
    assert "looks along the table" in result.verdict.reasons[0]


def test_workspace_out_of_view_warns():
    away = camera_at((1.3, 1.2, 0.5), (1.1, 1.0, 0.0))
    result = table.solve(LENS, [sighting(away, Placement(1.0, 0.9))], THICK_M)
    assert any("workspace are in view" in reason for reason in result.verdict.reasons)


def test_points_by_hand_are_enough():
    result = table.solve(LENS, [by_hand(CAMERA, noise_px=0.3)], 0.0)
    assert result.verdict.grade in (PASS, WARN)
    assert error_mm(result.camera, CAMERA) <= 4.0


def test_four_points_by_hand_warn_that_nothing_checks_them():
    result = table.solve(LENS, [by_hand(CAMERA, HAND_M[:4])], 0.0)
    assert result.verdict.grade == WARN
    assert "leave none to check with" in result.verdict.reasons[0]
    assert result.figures()["left_out_mm"] is None
    assert error_mm(result.camera, CAMERA) <= 0.1


def test_mirrored_places_put_the_camera_below_the_table_and_are_refused():
    good = by_hand(CAMERA)
    mirrored = table.points(good.pixels, good.table_m * (1.0, -1.0))
    with pytest.raises(CalibrationError, match="must be above.*y to the left"):
        table.solve(LENS, [mirrored], 0.0)


@pytest.mark.parametrize(
    "table_m, match",
    [
        (HAND_M[:3], "at least 4"),
        (np.column_stack([np.linspace(0.1, 0.3, 5), np.zeros(5)]), "on a line in the picture"),
        (np.repeat(HAND_M[:1], 5, axis=0), "on a line"),
        (np.append(HAND_M[:4], [[np.nan, 0.0]], axis=0), "not all numbers are finite"),
    ],
)
def test_points_that_fix_no_pose_are_refused(table_m, match):
    with pytest.raises(CalibrationError, match=match):
        table.solve(LENS, [by_hand(CAMERA, table_m)], 0.0)


@pytest.mark.parametrize("height_m", [-0.001, 0.5, float("nan")])
def test_impossible_thickness_is_refused(height_m):
    with pytest.raises(CalibrationError, match="mm thick"):
        table.solve(LENS, [by_hand(CAMERA)], height_m)


@given(st.lists(st.tuples(*[st.floats(-1e4, 1e4)] * 2, *[st.floats(-1.0, 1.0)] * 2), max_size=8))
def test_senseless_points_are_refused_or_judged(values):
    data = np.array(values, dtype=float).reshape(-1, 4)
    try:
        result = table.solve(LENS, [table.points(data[:, :2], data[:, 2:])], 0.0)
    except CalibrationError:
        return
    assert result.camera.table_from_cam[2, 3] > 0.0
    assert result.rms_px <= table.MAX_RMS_PX or result.verdict.is_refused


# the verb


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """Return a folder with the lens and pictures of the board in two places."""
    folder = tmp_path_factory.mktemp("table")
    lens = Intrinsics(**{key: value for key, value in vars(LENS).items()})
    save_camera(folder / "lens.json", lens, {"rms_px": 0.1, "verdict": "pass"})
    for name, where in (("here", HERE), ("there", THERE)):
        cv2.imwrite(str(folder / f"{name}.png"), photo(CAMERA, CHARUCO, where, THICK_M))
    return folder


def origin(where):
    return f"{1e3 * where.x_m:g},{1e3 * where.y_m:g},{math.degrees(where.angle_rad):.6f}"


def words(scene, out, *more, board="charuco:7x5"):
    return ["--camera-file", scene / "lens.json", "--board", board, "--square-mm", 25,
            "--thickness-mm", 3, "--out", out, *more]  # fmt: skip


def at_here(scene):
    return "--images", scene / "here.png", f"--origin-mm={origin(HERE)}"


def test_verb_writes_a_camera_that_replay_accepts(scene, tmp_path, capsys):
    out = tmp_path / "camera.json"
    assert verb.run(parsed(verb, *words(scene, out, *at_here(scene), "--json"))) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["verdict"] == "pass"
    assert printed["left_out_mm"] <= 2.0
    assert np.array(printed["homography_table_m_from_undistorted_px"]).shape == (3, 3)
    camera = load_camera(out)
    assert error_mm(camera, CAMERA) <= 2.0
    made = json.loads(out.read_text())["made"]
    assert made["lens"]["rms_px"] == 0.1
    assert made["board"] == CHARUCO.name
    shown = cv2.imread(str(tmp_path / "camera.png"))
    assert shown.shape[1] == 1280
    frames = tmp_path / "frames"
    frames.mkdir()
    ball = frames / "0.png"
    for i in range(6):
        picture = cv2.imread(str(scene / "here.png"))
        cv2.circle(picture, (320 + 3 * i, 200), 12, (40, 40, 210), -1, cv2.LINE_AA)
        cv2.imwrite(str(frames / f"{i}.png"), picture)
    colours = tmp_path / "colours.json"
    teach = ["calibrate", "colour", "--image", str(ball), "--sample", "red:320,200,9"]
    assert main([*teach, "--out", str(colours)]) == 0
    run = ["replay", str(frames), "--colours", str(colours), "--calibration", str(out)]
    assert main([*run, "--out", str(tmp_path / "run")]) == 0


def test_several_boards_each_with_its_place(scene, tmp_path, capsys):
    out = tmp_path / "camera.json"
    there = ("--images", scene / "there.png", f"--origin-mm={origin(THERE)}")
    assert verb.run(parsed(verb, *words(scene, out, *at_here(scene), *there, "--json"))) == 0
    assert json.loads(capsys.readouterr().out)["n_points"] >= 40
    assert error_mm(load_camera(out), CAMERA) <= 1.0


def test_camera_file_may_be_replaced_by_its_own_result(scene, tmp_path, capsys):
    out = tmp_path / "camera.json"
    out.write_bytes((scene / "lens.json").read_bytes())
    for _ in range(2):
        given_words = words(scene, out, *at_here(scene))
        given_words[1] = out
        assert verb.run(parsed(verb, *given_words)) == 0
    assert json.loads(out.read_text())["made"]["lens"] == {"rms_px": 0.1, "verdict": "pass"}


def test_points_of_the_command_line(scene, tmp_path, capsys):
    given_points = []
    for pixel, place in zip(by_hand(CAMERA).pixels, HAND_M):
        text = f"{pixel[0]:.1f},{pixel[1]:.1f}={1e3 * place[0]:g},{1e3 * place[1]:g}"
        given_points += ["--point", text]
    out = tmp_path / "camera.json"
    base = ["--camera-file", scene / "lens.json", "--out", out]
    assert verb.run(parsed(verb, *base, *given_points)) == 0
    assert error_mm(load_camera(out), CAMERA) <= 1.0
    assert cv2.imread(str(tmp_path / "camera.png")) is not None
    with pytest.raises(CalibrationError, match="outside the 640x480"):
        verb.run(parsed(verb, *base, *given_points, "--point", "641,5=1,1"))
    with pytest.raises(ConfigError, match="not both"):
        verb.run(parsed(verb, *base, *given_points, "--origin-mm", "0,0"))


def test_refusal_is_json_with_its_reason_and_writes_nothing(scene, tmp_path, capsys):
    out = tmp_path / "camera.json"
    there = ("--images", scene / "there.png", f"--origin-mm={origin(HERE)}")
    with pytest.raises(CalibrationError, match="all stated places") as refused:
        verb.run(parsed(verb, *words(scene, out, *at_here(scene), *there, "--json")))
    assert refused.value.exit_code == 2
    printed = json.loads(capsys.readouterr().out)
    assert printed["verdict"] == "refuse"
    assert printed["rms_px"] > 3.0
    assert list(tmp_path.iterdir()) == []


def test_picture_without_the_board_is_refused(scene, tmp_path):
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((480, 640, 3), np.uint8))
    with pytest.raises(CalibrationError, match=r"black\.png.*not found"):
        verb.run(parsed(verb, *words(scene, tmp_path / "c.json", "--images", black,
                                     "--origin-mm", "0,0")))  # fmt: skip


def test_picture_of_another_size_is_refused(scene, tmp_path):
    small = tmp_path / "small.png"
    cv2.imwrite(str(small), cv2.resize(cv2.imread(str(scene / "here.png")), (320, 240)))
    with pytest.raises(CalibrationError, match="320x240.*640x480"):
        verb.run(parsed(verb, *words(scene, tmp_path / "c.json", "--images", small,
                                     "--origin-mm", "0,0")))  # fmt: skip


@pytest.mark.parametrize("content", [b"", b"nothing"])
def test_unreadable_picture_is_a_typed_error(scene, tmp_path, content):
    bad = tmp_path / "bad.png"
    bad.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bad\.png"):
        verb.run(parsed(verb, *words(scene, tmp_path / "c.json", "--images", bad,
                                     "--origin-mm", "0,0")))  # fmt: skip


@pytest.mark.parametrize("lens", ["", "{}", '{"format": "apex-camera"}'])
def test_camera_file_that_is_none_is_a_typed_error(scene, tmp_path, lens):
    bad = tmp_path / "bad.json"
    bad.write_text(lens)
    given_words = words(scene, tmp_path / "c.json", *at_here(scene))
    given_words[1] = bad
    with pytest.raises(CalibrationError, match=r"bad\.json"):
        verb.run(parsed(verb, *given_words))


def test_symmetric_board_is_refused_before_it_is_looked_for(scene, tmp_path):
    with pytest.raises(CalibrationError, match="half a turn"):
        verb.run(parsed(verb, *words(scene, tmp_path / "c.json", *at_here(scene), board="8x6")))


@pytest.mark.parametrize(
    "given_words, match",
    [
        ([], "--board, --square-mm and --origin-mm"),
        (["--board", "9x6", "--square-mm", 25, "--origin-mm", "0,0"], "--images or a camera"),
        (["--board", "9x6", "--square-mm", 25, "--origin-mm", "0,0", "--origin-mm", "1,1",
          "--images", "{here}"], "2 --origin-mm for 1 --images"),
    ],
)  # fmt: skip
def test_incomplete_commands_say_what_is_missing(scene, tmp_path, given_words, match):
    filled = [str(word).replace("{here}", str(scene / "here.png")) for word in given_words]
    base = ["--camera-file", scene / "lens.json", "--out", tmp_path / "c.json"]
    with pytest.raises(ConfigError, match=match):
        verb.run(parsed(verb, *base, *filled))


@pytest.mark.parametrize("text", ["", "1", "1,2,3,4", "a,b", "nan,1", "1;2"])
def test_malformed_origin_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        verb.parse_origin(text)


@pytest.mark.parametrize("text", ["", "1,2", "1,2=", "1,2=3", "1=2,3", "1,2=3,4,5", "1,2=inf,4"])
def test_malformed_point_is_refused(text):
    with pytest.raises(argparse.ArgumentTypeError):
        verb.parse_point(text)


def test_live_camera_sees_the_board_ten_times(scene, tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    data = (scene / "here.png").read_bytes()
    for i in range(10):
        (frames / f"{i:02d}.png").write_bytes(data)
    out = tmp_path / "camera.json"
    live = ("--camera", "folder", "--path", frames, f"--origin-mm={origin(HERE)}")
    assert verb.run(parsed(verb, *words(scene, out, *live))) == 0
    assert error_mm(load_camera(out), CAMERA) <= 2.0
    (frames / "09.png").unlink()
    with pytest.raises(CalibrationError, match="in 9 of"):
        verb.run(parsed(verb, *words(scene, out, *live)))
