"""The lens: recovery of known ones, bad views left out by their own error, refusals, the verb."""

import json

import cv2
import numpy as np
import pytest
from board_scene import CHESS, LENS, good_views, parsed, views, with_corners
from hypothesis import given
from hypothesis import strategies as st

from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.calibration import load_camera, load_intrinsics
from apex_edge.errors import ApexError, CalibrationError, ConfigError, InputError, RecordingError
from calib import collect, intrinsics, sources
from calib.boards import parse_board
from calib.detect import detect
from calib.simulated import (
    BoardCamera,
    BoardRenderer,
    Look,
    board_pose,
    default_lens,
    varied_poses,
)
from calib.verbs import intrinsics as verb
from calib.verdict import PASS, REFUSE, WARN

SIZE = (640, 480)
SMALL = default_lens(320, 240)


def values(lens):
    return np.array([lens.fx_px, lens.fy_px, lens.cx_px, lens.cy_px])


def reasons(result):
    return "; ".join(result.verdict.reasons)


def test_known_lens_is_recovered_within_the_stated_uncertainty():
    off = []
    for seed in range(8):
        result = intrinsics.solve(good_views(seed=seed), SIZE, CHESS)
        assert result.verdict.grade == PASS
        assert result.rms_px == pytest.approx(0.1 * np.sqrt(2.0), rel=0.15)
        assert result.lens.dist[4] == 0.0  # a k3 that is not there is not fitted
        off.append((values(result.lens) - values(LENS)) / result.sd_px)
    # 32 normalised errors: their rms is 1 +- 0.13 when the sds are honest
    assert 0.6 <= np.sqrt(np.mean(np.square(off))) <= 1.4


def test_k3_is_fitted_where_the_views_show_it():
    strong = default_lens(640, 480)
    strong.dist[:] = (-0.3, 0.15, 0.0, 0.0, -0.2)
    result = intrinsics.solve(good_views(n=24, lens=strong), SIZE, CHESS)
    assert result.lens.dist[4] == pytest.approx(-0.2, abs=5 * result.sd_dist[4])
    assert result.sd_dist[4] > 0.0


def test_more_noise_gives_more_stated_uncertainty():
    calm = intrinsics.solve(good_views(noise_px=0.05), SIZE, CHESS)
    loud = intrinsics.solve(good_views(noise_px=0.2), SIZE, CHESS)
    assert loud.sd_px[0] == pytest.approx(4.0 * calm.sd_px[0], rel=0.3)
    assert loud.jackknife_px > 2.0 * calm.jackknife_px


def test_few_views_and_empty_cells_warn():
    result = intrinsics.solve(good_views(n=8), SIZE, CHESS)
    assert result.verdict.grade == WARN
    assert "only 8 views" in reasons(result)
    centre = board_pose(CHESS, np.array([0.0, 0.0, 0.6]), 0.0, 0.0)
    poses = varied_poses(CHESS, LENS, 18)
    poses[:, :3, 3] = 0.35 * poses[:, :3, 3] + 0.65 * centre[:3, 3]
    result = intrinsics.solve(views(poses), SIZE, CHESS)
    assert result.verdict.grade in (WARN, REFUSE)
    assert "5 x 5 cells" in reasons(result)


def mixed(one, other):
    """Return corners of which half come from another picture."""
    half = len(one.ids) // 2
    return np.concatenate([one.corners_px[:half], other.corners_px[half:]])


@pytest.mark.parametrize("kind", ["mixed", "shuffled", "noisy", "one corner"])
def test_damaged_view_is_left_out_by_its_own_error(kind):
    rng = np.random.RandomState(3)
    given_views = good_views()
    victim = given_views[7]
    corners = {
        "mixed": lambda: mixed(victim, given_views[2]),
        "shuffled": lambda: victim.corners_px[rng.permutation(54)],
        "noisy": lambda: victim.corners_px + rng.normal(0.0, 0.6, (54, 2)),
        "one corner": lambda: victim.corners_px + 8.0 * (np.arange(54) == 20)[:, None],
    }[kind]()
    given_views[7] = with_corners(victim, corners)
    result = intrinsics.solve(given_views, SIZE, CHESS)
    assert [bad.name for bad in result.rejected] == ["v7.png"]
    assert result.verdict.grade == PASS
    assert np.all(np.abs(values(result.lens) - values(LENS)) <= 4.0 * result.sd_px)


def test_good_views_are_not_left_out():
    for seed in range(5):
        assert intrinsics.solve(good_views(seed=seed), SIZE, CHESS).rejected == ()


def test_too_many_bad_views_are_refused_and_named():
    rng = np.random.RandomState(0)
    bad = [with_corners(v, v.corners_px[rng.permutation(54)]) for v in good_views()[:8]]
    with pytest.raises(CalibrationError, match="8 of 18 views disagree.*v0.png"):
        intrinsics.solve(bad + good_views()[8:], SIZE, CHESS)


def test_no_and_too_few_views_are_refused():
    with pytest.raises(CalibrationError, match="found in no picture"):
        intrinsics.solve([], SIZE, CHESS)
    with pytest.raises(CalibrationError, match="too few views.*5 pictures"):
        intrinsics.solve(good_views(n=5), SIZE, CHESS)


@pytest.mark.parametrize("tilt_deg", [0.0, 2.0, 5.0])
@pytest.mark.parametrize("seed", range(4))
def test_board_seen_only_head_on_is_refused(tilt_deg, seed):
    poses = varied_poses(CHESS, LENS, 18, tilt_deg)
    result = intrinsics.solve(views(poses, seed=seed), SIZE, CHESS)
    assert result.verdict.grade == REFUSE
    assert "only head-on" in reasons(result)


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0])
def test_one_and_the_same_pose_is_refused(tilt_deg):
    pose = board_pose(CHESS, np.array([0.0, 0.0, 0.4]), tilt_deg, 0.5 * tilt_deg)
    result = intrinsics.solve(views([pose] * 16), SIZE, CHESS)
    assert result.verdict.grade == REFUSE
    assert "the same pose" in reasons(result)


def test_one_tilt_moved_around_is_refused():
    centres = [p[:3, :3] @ (0.125, 0.0875, 0.0) + p[:3, 3] for p in varied_poses(CHESS, LENS, 18)]
    result = intrinsics.solve(
        views([board_pose(CHESS, c, 35.0, 20.0) for c in centres]), SIZE, CHESS
    )
    assert result.verdict.grade == REFUSE
    assert "the same tilt" in reasons(result)


def test_picture_of_another_size_is_refused_and_named():
    odd = good_views(lens=default_lens(320, 240))[3]
    with pytest.raises(CalibrationError, match="v3.png: 320x240"):
        intrinsics.solve([*good_views(), odd], SIZE, CHESS)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_corners_that_are_no_numbers_are_refused_and_named(value):
    given_views = good_views()
    corners = given_views[4].corners_px.copy()
    corners[3, 1] = value
    given_views[4] = with_corners(given_views[4], corners)
    with pytest.raises(CalibrationError, match=r"v4\.png.*not finite"):
        intrinsics.solve(given_views, SIZE, CHESS)


@given(st.integers(0, 2**31 - 1), st.floats(0.0, 1e6), st.booleans())
def test_senseless_corners_are_refused_and_never_make_a_lens(seed, spread_px, is_one_point):
    rng = np.random.RandomState(seed)
    wild = [
        with_corners(v, rng.uniform(-1.0, 1.0, (1 if is_one_point else 54, 2)) * spread_px
                     + np.zeros((54, 2)))
        for v in good_views(n=7)
    ]  # fmt: skip
    try:
        result = intrinsics.solve(wild, SIZE, CHESS)
    except CalibrationError:
        return
    assert result.verdict.grade == REFUSE


# real pictures


@pytest.fixture(scope="module")
def real_views(real_data):
    folder = real_data / "chessboard"
    truth = json.loads((folder / "truth.json").read_text())
    board = parse_board("x".join(map(str, truth["pattern_inner_corners"])), 0.025)
    found = [
        detect(cv2.imread(str(path)), board, path.name) for path in sorted(folder.glob("*.jpg"))
    ]
    return [view for view in found if view is not None], tuple(truth["image_size"]), board, truth


def assert_as_expected(result, truth):
    expect = truth["expect"]
    assert result.rms_px <= expect["rms_px_max"]
    for name in ("fx", "fy", "cx", "cy"):
        low, high = expect[name]
        assert low <= getattr(result.lens, name + "_px") <= high
    assert not result.verdict.is_refused


def test_real_pictures_give_the_expected_lens(real_views):
    found, size_px, board, truth = real_views
    result = intrinsics.solve(found, size_px, board)
    assert len(result.views) == 14
    assert_as_expected(result, truth)
    assert result.rms_px <= 0.30
    assert max(result.sd_px[:2] / values(result.lens)[:2]) <= 0.005


@pytest.mark.parametrize("victim", [0, 6, 9])
@pytest.mark.parametrize("kind", ["mixed", "noisy"])
def test_one_damaged_real_view_does_not_spoil_the_rest(real_views, victim, kind):
    found, size_px, board, truth = real_views
    view = found[victim]
    noise = np.random.RandomState(victim).normal(0.0, 0.8, view.corners_px.shape)
    corners = mixed(view, found[3]) if kind == "mixed" else view.corners_px + noise
    damaged = [with_corners(v, corners) if v is view else v for v in found]
    result = intrinsics.solve(damaged, size_px, board)
    assert [bad.name for bad in result.rejected] == [view.name]
    assert_as_expected(result, truth)


def test_blurred_real_picture_does_not_spoil_the_rest(real_views, real_data):
    found, size_px, board, truth = real_views
    path = real_data / "chessboard" / found[8].name
    picture = cv2.imread(str(path))
    smeared = cv2.blur(picture, (15, 1))
    # the left half moved while the shutter was open
    smeared[:, 320:] = picture[:, 320:]
    damaged = detect(smeared, board, found[8].name)
    views_now = [damaged if v.name == path.name else v for v in found]
    result = intrinsics.solve([v for v in views_now if v is not None], size_px, board)
    assert_as_expected(result, truth)


@pytest.mark.parametrize("name", ["8x6", "charuco:7x5"])
def test_wrong_board_on_real_pictures_is_refused(real_data, tmp_path, name):
    words = ("--images", real_data / "chessboard" / "*.jpg", "--board", name, "--square-mm", 25)
    with pytest.raises(CalibrationError, match="found in"):
        verb.run(parsed(verb, *words, "--out", tmp_path / "camera.json"))
    assert list(tmp_path.iterdir()) == []


# the verb on files


@pytest.fixture(scope="module")
def shots(tmp_path_factory):
    """Return a folder with 16 rendered pictures, 320x240, of a 9x6 board."""
    folder = tmp_path_factory.mktemp("shots")
    renderer = BoardRenderer(CHESS, SMALL)
    for i, pose in enumerate(varied_poses(CHESS, SMALL, 16)):
        picture = renderer.render(pose, Look(), np.random.RandomState(i))
        cv2.imwrite(str(folder / f"s{i:02d}.png"), picture)
    return folder


def calibrate(out, *images, board="9x6"):
    words = [word for image in images for word in ("--images", image)]
    return verb.run(
        parsed(verb, *words, "--board", board, "--square-mm", 25, "--out", out, "--json")
    )


def test_verb_writes_a_lens_that_loads_and_a_picture(shots, tmp_path, capsys):
    out = tmp_path / "camera.json"
    assert calibrate(out, shots / "*.png") == 0
    printed = json.loads(capsys.readouterr().out)
    lens = load_intrinsics(out)
    assert printed["verdict"] == "pass"
    assert printed["rms_px"] <= 0.30
    assert printed["fx_px"] == lens.fx_px
    sds = np.array(list(printed["sd_px"].values()))
    assert np.all(np.abs(values(lens) - values(SMALL)) <= 5.0 * sds)
    with pytest.raises(CalibrationError, match="apex calibrate table"):
        load_camera(out)
    document = json.loads(out.read_text())
    assert document["camera"]["table_from_cam"] is None
    made = document["made"]
    assert [v["name"] for v in made["views"]] == [f"s{i:02d}.png" for i in range(16)]
    where_from = {
        "date",
        "data_sha256",
        "files",
        "versions",
        "board",
        "square_mm",
        "not_found",
        "rejected",
    }
    how_well = {"verdict", "reasons", "rejected", "coverage", "sd_px", "jackknife_focal_share"}
    assert where_from | how_well <= set(made)
    assert np.array(made["coverage"]).shape == (5, 5)
    assert cv2.imread(str(tmp_path / "camera.png")).shape[1] == 960
    assert sorted(p.name for p in tmp_path.iterdir()) == ["camera.json", "camera.png"]


def test_same_pictures_give_the_same_lens_and_hash(shots, tmp_path, capsys):
    for name in ("a.json", "b.json"):
        calibrate(tmp_path / name, shots / "*.png")
    a, b = (json.loads((tmp_path / name).read_text()) for name in ("a.json", "b.json"))
    # OpenCV sums over threads in any order, so the last digits may differ
    assert a["camera"]["fx_px"] == pytest.approx(b["camera"]["fx_px"], rel=1e-9)
    assert a["made"]["data_sha256"] == b["made"]["data_sha256"]


def test_picture_without_a_board_is_named_and_does_not_harm(shots, tmp_path, capsys):
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((240, 320, 3), np.uint8))
    assert calibrate(tmp_path / "camera.json", shots / "*.png", black) == 0
    assert json.loads(capsys.readouterr().out)["not_found"] == ["black.png"]


def test_refusal_prints_its_reason_as_json_and_leaves_the_old_file(shots, tmp_path, capsys):
    out = tmp_path / "camera.json"
    calibrate(out, shots / "*.png")
    before = out.read_bytes()
    capsys.readouterr()
    with pytest.raises(CalibrationError, match="too few views") as refused:
        calibrate(out, shots / "s00.png", shots / "s01.png")
    assert refused.value.exit_code == 2
    printed = json.loads(capsys.readouterr().out)
    assert printed["verdict"] == "refuse"
    assert "too few views" in printed["reasons"][0]
    assert out.read_bytes() == before


def test_refused_fit_prints_all_its_figures(tmp_path, capsys):
    renderer = BoardRenderer(CHESS, SMALL)
    for i, pose in enumerate(varied_poses(CHESS, SMALL, 8, 0.0)):
        picture = renderer.render(pose, Look(), np.random.RandomState(i))
        cv2.imwrite(str(tmp_path / f"s{i}.png"), picture)
    with pytest.raises(CalibrationError, match="head-on"):
        calibrate(tmp_path / "camera.json", tmp_path / "s*.png")
    printed = json.loads(capsys.readouterr().out)
    assert printed["verdict"] == "refuse"
    assert printed["tilt_spread_deg"] < 12.0
    assert not (tmp_path / "camera.json").exists()
    assert not (tmp_path / "camera.png").exists()


@pytest.mark.parametrize("content", [b"", b"x", b"\x89PNG\r\n\x1a\n"])
def test_unreadable_picture_is_a_typed_error_that_names_it(shots, tmp_path, content):
    bad = tmp_path / "bad.png"
    bad.write_bytes(content)
    with pytest.raises(RecordingError, match=r"bad\.png"):
        calibrate(tmp_path / "camera.json", shots / "*.png", bad)
    assert [p.name for p in tmp_path.iterdir()] == ["bad.png"]


def test_missing_pictures_and_no_source_are_typed_errors(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        calibrate(tmp_path / "camera.json", tmp_path / "*.jpg")
    with pytest.raises(ConfigError, match="--images or a camera"):
        calibrate(tmp_path / "camera.json")
    with pytest.raises(CalibrationError, match="expected 9x6"):
        calibrate(tmp_path / "camera.json", "x.png", board="nine")


# live


def at(x_m, y_m=0.0, tilt_deg=0.0):
    return board_pose(CHESS, np.array([x_m, y_m, 0.45]), tilt_deg, 0.0)


class Stage:
    """A board before a small camera."""

    def __init__(self):
        self.renderer = BoardRenderer(CHESS, SMALL)
        self.rng = np.random.RandomState(0)

    def show(self, pose):
        return self.renderer.render(pose, Look(), self.rng)


def test_view_is_kept_only_when_still_and_new():
    stage, collector = Stage(), collect.Collector(CHESS)
    black = np.zeros((240, 320, 3), np.uint8)
    states = [
        collector.step(picture).state
        for picture in (
            black,
            stage.show(at(0.0)),
            stage.show(at(0.03)),
            stage.show(at(0.03)),
            stage.show(at(0.03)),
            stage.show(at(0.03, tilt_deg=35.0)),
            stage.show(at(0.03, tilt_deg=35.0)),
        )
    ]
    assert states == [collect.NOT_SEEN, collect.MOVING, collect.MOVING, collect.KEPT,
                      collect.KNOWN, collect.MOVING, collect.KEPT]  # fmt: skip
    assert len(collector.views) == 2


def test_advice_names_where_the_board_has_not_been():
    stage, collector = Stage(), collect.Collector(CHESS)
    for _ in range(2):
        advice = collector.step(stage.show(at(-0.08, -0.06)))
    assert advice.state == collect.KEPT
    assert "right" in advice.hint
    assert not advice.is_complete
    assert advice.coverage[:3, :3].all()


def test_untilted_views_lead_to_the_advice_to_tilt():
    collector = collect.Collector(CHESS)
    stage = Stage()
    for x in (-0.09, 0.0, 0.09):
        for y in (-0.07, 0.0, 0.07):
            for _ in range(2):
                advice = collector.step(stage.show(at(x, y)))
    assert "tilt it more" in advice.hint


def test_collector_completes_with_views_that_pass():
    camera = BoardCamera(CameraConfig(type="board", path="9x6@25", width=320, height=240))
    collector = collect.Collector(camera.board)
    with camera:
        for _ in range(400):
            advice = collector.step(camera.read(1.0).colour_bgr)
            if advice.is_complete:
                break
    assert advice.hint == ""
    assert intrinsics.solve(collector.views, (320, 240), camera.board).verdict.grade == PASS


def test_live_verb_calibrates_the_simulated_camera(tmp_path, capsys):
    config = tmp_path / "apex.toml"
    config.write_text('[camera]\ntype = "board"\npath = "9x6@25"\nwidth = 320\nheight = 240\n')
    words = ("--config", config, "--board", "9x6", "--square-mm", 25)
    assert verb.run(parsed(verb, *words, "--out", tmp_path / "camera.json")) == 0
    said = capsys.readouterr()
    assert "move it to the" in said.err
    assert " # #" in said.err
    assert "pass: RMS" in said.out
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["apex.toml", "camera.json", "camera.png"]  # the preview is gone


def test_preview_is_there_meanwhile_and_ctrl_c_leaves_nothing(tmp_path, monkeypatch):
    seen = []

    def interrupted(settings):
        stage = Stage()
        for i in range(3):
            yield float(i), stage.show(at(0.0))
            seen.append(sorted(p.name for p in tmp_path.iterdir()))
        raise KeyboardInterrupt

    monkeypatch.setattr(sources, "frames", interrupted)
    words = ("--camera", "board", "--board", "9x6", "--square-mm", 25)
    with pytest.raises(KeyboardInterrupt):
        verb.run(parsed(verb, *words, "--out", tmp_path / "camera.json"))
    assert seen[-1] == ["camera-preview.png"]
    assert list(tmp_path.iterdir()) == []


def test_camera_that_shows_no_board_is_refused(tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    for i in range(3):
        cv2.imwrite(str(folder / f"{i}.png"), np.zeros((240, 320, 3), np.uint8))
    words = ("--camera", "folder", "--path", folder, "--board", "9x6", "--square-mm", 25)
    with pytest.raises(CalibrationError, match="in no frame"):
        verb.run(parsed(verb, *words, "--out", tmp_path / "camera.json"))
    assert not (tmp_path / "camera.json").exists()


@pytest.mark.parametrize(
    "text, match", [('[camera]\ntype = "twin"\n', "shows no board"),
                    ("camera = 5\n", "must be a table"),
                    ("[camera]\nfsp = 3\n", "fps")],
)  # fmt: skip
def test_settings_without_a_usable_camera_are_refused(tmp_path, text, match):
    config = tmp_path / "apex.toml"
    config.write_text(text)
    words = ("--config", config, "--board", "9x6", "--square-mm", 25)
    with pytest.raises(ApexError, match=match):
        verb.run(parsed(verb, *words, "--out", tmp_path / "camera.json"))


def test_out_in_a_missing_folder_is_a_typed_error(shots, tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        calibrate(tmp_path / "no" / "camera.json", shots / "*.png")
