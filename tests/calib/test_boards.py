"""Boards: their names, the printed sheet, and finding them in a picture."""

import json
import re
import struct
from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_scene import CHARUCO, CHESS, LENS, parsed
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from apex_edge.cameras.base import CameraConfig
from apex_edge.errors import CalibrationError, ConfigError, InputError
from calib import board_sheet
from calib.boards import black_boxes, charuco_board, parse_board
from calib.detect import detect
from calib.simulated import BoardCamera, BoardRenderer, Look, board_pose, varied_poses
from calib.verbs import board as verb

NAMES = ["9x6", "8x6", "charuco:7x5:DICT_4X4_50", "charuco:8x6:DICT_5X5_100"]


def facing(board, tilt_deg=10.0, seed=0):
    pose = board_pose(board, np.array([0.0, 0.0, 0.45]), tilt_deg, 5.0)
    return BoardRenderer(board, LENS).render(pose, Look(), np.random.RandomState(seed))


@pytest.mark.parametrize("name", NAMES)
def test_name_reads_back_as_the_same_board(name):
    board = parse_board(name, 0.02)
    assert board.name == name
    assert parse_board(board.name, 0.02, board.marker_m) == board


@pytest.mark.parametrize(
    "text",
    ["", "9", "9x", "x6", "2x9", "9x6x3", "99x6", "-9x6", "aruco:7x5", "charuco:7x5:DICT_9X9_1",
     "9x6:DICT_4X4_50", "charuco:7x5:drop table", "charuco:40x40:DICT_4X4_50", "９x6"],
)  # fmt: skip
def test_name_of_no_board_is_refused(text):
    with pytest.raises(CalibrationError):
        parse_board(text, 0.025)


@pytest.mark.parametrize("square_m", [0.0, -0.025, float("nan"), float("inf"), 25.0])
def test_square_of_no_possible_size_is_refused(square_m):
    with pytest.raises(CalibrationError, match="square"):
        parse_board("9x6", square_m)


def test_marker_must_fit_its_square():
    with pytest.raises(CalibrationError, match="marker"):
        parse_board("charuco:7x5", 0.025, 0.025)


def test_large_board_gets_a_dictionary_with_enough_markers():
    assert parse_board("charuco:12x12", 0.01).dictionary == "DICT_4X4_100"


@pytest.mark.parametrize("name, is_ambiguous", [("9x6", False), ("6x9", False), ("8x6", True),
                                                ("9x7", True), ("charuco:7x5", False)])  # fmt: skip
def test_symmetric_chessboards_and_no_others_are_ambiguous(name, is_ambiguous):
    board = parse_board(name, 0.025)
    assert board.is_ambiguous == is_ambiguous
    # the printed pattern itself, turned by half a turn about its middle
    boxes = {tuple(np.round(box[:2], 6)) for box in black_boxes(board)}
    turned = {
        tuple(np.round(np.array(board.size_m) - box[:2] - box[2:], 6)) for box in black_boxes(board)
    }
    assert (boxes == turned) == is_ambiguous


def test_corner_ids_are_those_of_opencv():
    theirs = np.array(charuco_board(CHARUCO).getChessboardCorners())
    ours = CHARUCO.corners_m()
    assert np.allclose(ours[:, 0], theirs[:, 0])
    assert np.allclose(ours[:, 1], CHARUCO.size_m[1] - theirs[:, 1])


def content(pdf):
    return re.search(rb"stream\n(.*)\nendstream", pdf, re.S).group(1).decode("latin-1")


@pytest.mark.parametrize("paper, size_mm", [("a4", (210.0, 297.0)), ("letter", (215.9, 279.4))])
def test_pdf_states_the_paper_and_draws_the_board_in_millimetres(paper, size_mm):
    pdf = board_sheet.to_pdf(board_sheet.lay_out(CHARUCO, paper))
    stated = re.search(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", pdf)
    assert np.allclose([float(v) / 72.0 * 25.4 for v in stated.groups()], size_mm, atol=1e-3)
    text = content(pdf)
    unit = float(re.match(r"([\d.]+) 0 0 \1 0 0 cm", text).group(1))
    assert unit == pytest.approx(72.0 / 25.4)
    boxes = np.array([row.split()[:4] for row in text.splitlines() if row.endswith(" re")], float)
    wanted = 1e3 * black_boxes(CHARUCO)
    assert np.allclose(boxes - boxes.min(axis=0) * (1, 1, 0, 0), wanted, atol=1e-3)
    assert (boxes[:, :2] >= 5.0).all()
    assert (boxes[:, :2] + boxes[:, 2:] <= np.array(size_mm) - 5.0).all()


def test_pdf_is_a_whole_file_with_the_offsets_of_its_objects():
    pdf = board_sheet.to_pdf(board_sheet.lay_out(CHESS, "a4"))
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", pdf).group(1))
    assert pdf[start : start + 4] == b"xref"
    offsets = [int(v) for v in re.findall(rb"(\d{10}) 00000 n", pdf)]
    assert len(offsets) == 5
    for number, offset in enumerate(offsets, start=1):
        assert pdf[offset:].startswith(f"{number} 0 obj".encode("ascii"))
    length = int(re.search(rb"/Length (\d+)", pdf).group(1))
    assert length == len(content(pdf))


def test_ruler_is_100_mm():
    sheet = board_sheet.lay_out(CHESS, "a4")
    assert any(line[2] - line[0] == 100.0 and line[1] == line[3] for line in sheet.lines)


@pytest.mark.parametrize("name", ["9x6", "charuco:7x5"])
def test_board_drawn_from_the_pdf_is_found_with_true_spacing(name):
    board = parse_board(name, 0.025)
    pdf = board_sheet.to_pdf(board_sheet.lay_out(board, "a4"))
    per_mm, height = 4, 1200
    picture = np.full((height, 1200), 255, np.uint8)
    for row in content(pdf).splitlines():
        if row.endswith(" re"):
            x, y, w, h = (float(v) * per_mm for v in row.split()[:4])
            top, bottom = round(height - y - h), round(height - y)
            picture[top:bottom, round(x) : round(x + w)] = 0
    view = detect(picture, board)
    assert len(view.ids) == board.inner[0] * board.inner[1]
    found_mm = view.corners_px * (1, -1) / per_mm
    offset = found_mm - 1e3 * view.points_m[:, :2]
    assert np.ptp(offset, axis=0).max() <= 0.15  # two thirds of one of these coarse pixels


@pytest.mark.parametrize("name, square_mm", [("9x6", 25), ("charuco:8x6", 20)])
def test_png_states_its_scale_and_shows_the_board_at_it(tmp_path, name, square_mm):
    out = tmp_path / "board.png"
    words = ("--board", name, "--square-mm", square_mm, "--paper", "letter", "--out", out)
    assert verb.run(parsed(verb, *words)) == 0
    data = out.read_bytes()
    place = data.index(b"pHYs")
    per_m, per_m_y, unit = struct.unpack(">IIB", data[place + 4 : place + 13])
    assert per_m == per_m_y
    assert unit == 1  # metre
    board = parse_board(name, 1e-3 * square_mm)
    view = detect(cv2.imread(str(out)), board)
    assert len(view.ids) == board.inner[0] * board.inner[1]
    offset_m = view.corners_px * (1, -1) / per_m - view.points_m[:, :2]
    assert np.ptp(offset_m, axis=0).max() <= 0.02e-3


def test_board_that_does_not_fit_is_refused_and_the_stated_size_would():
    board = parse_board("9x6", 0.040)
    with pytest.raises(CalibrationError, match="does not fit on a4") as refused:
        board_sheet.lay_out(board, "a4")
    room_mm = float(re.search(r"up to ([\d.]+) mm", str(refused.value)).group(1))
    board_sheet.lay_out(replace(board, square_m=1e-3 * (room_mm - 0.05)), "a4")
    with pytest.raises(CalibrationError):
        board_sheet.lay_out(replace(board, square_m=1e-3 * (room_mm + 0.1)), "a4")


@pytest.mark.parametrize(
    "square_mm, out, match",
    [
        (25, "board.jpg", "pdf or .png"),
        (60, "board.pdf", "does not fit"),
        (25, "no/board.pdf", "cannot write"),
    ],
)
def test_verb_refuses_and_writes_nothing(tmp_path, square_mm, out, match):
    words = ("--board", "9x6", "--square-mm", square_mm, "--out", tmp_path / out)
    with pytest.raises(InputError, match=match):
        verb.run(parsed(verb, *words))
    assert list(tmp_path.iterdir()) == []


def test_verb_prints_json_and_warns_of_a_symmetric_board(tmp_path, capsys):
    words = ("--board", "8x6", "--square-mm", 20, "--out", tmp_path / "b.pdf")
    assert verb.run(parsed(verb, *words)) == 0
    assert "upside down" in capsys.readouterr().out
    assert verb.run(parsed(verb, *words, "--json")) == 0
    assert json.loads(capsys.readouterr().out)["board"] == "8x6"


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chessboard", "charuco"])
@pytest.mark.parametrize("turn", [None, cv2.ROTATE_180, cv2.ROTATE_90_CLOCKWISE])
def test_corners_keep_their_ids_when_the_picture_is_turned(board, turn):
    picture = facing(board)
    plain = detect(picture, board)
    if turn is None:
        turned, back = plain, plain.corners_px
    else:
        turned = detect(cv2.rotate(picture, turn), board)
        x, y = turned.corners_px.T
        height, width = picture.shape[:2]
        back = np.column_stack(
            [width - 1 - x, height - 1 - y] if turn == cv2.ROTATE_180 else [y, height - 1 - x]
        )
    assert turned.ids.tolist() == list(range(board.inner[0] * board.inner[1]))
    assert np.abs(back - plain.corners_px).max() <= 0.1


@pytest.mark.parametrize("board, worst_px", [(CHESS, 0.2), (CHARUCO, 0.3)])
def test_corners_are_found_where_the_lens_puts_them(board, worst_px):
    from board_scene import views

    renderer = BoardRenderer(board, LENS)
    poses = varied_poses(board, LENS, 4)
    for i, (pose, true) in enumerate(zip(poses, views(poses, 0.0, board=board))):
        found = detect(renderer.render(pose, Look(), np.random.RandomState(i)), board)
        assert len(found.ids) >= 0.9 * len(true.ids)
        assert np.abs(found.corners_px - true.corners_px[found.ids]).max() <= worst_px


def test_charuco_partly_out_of_the_picture_keeps_its_ids():
    picture = facing(CHARUCO)
    whole = detect(picture, CHARUCO)
    part = detect(np.ascontiguousarray(picture[:, 250:]), CHARUCO)
    assert 6 <= len(part.ids) < len(whole.ids)
    shift = whole.corners_px[part.ids] - part.corners_px
    assert np.abs(shift - (250, 0)).max() <= 0.2


def test_charuco_of_an_old_opencv_is_found_as_well():
    board = parse_board("charuco:7x6", 0.025)
    old = charuco_board(board, is_legacy=True).generateImage((700, 600))
    new = charuco_board(board).generateImage((700, 600))
    assert (old != new).any()
    for picture in (old, new):
        view = detect(cv2.copyMakeBorder(picture, 40, 40, 40, 40, 0, value=255), board)
        assert len(view.ids) == 30
        offset = view.corners_px * (1, -1) - 4000.0 * view.points_m[:, :2]
        assert np.ptp(offset, axis=0).max() <= 0.5


def test_missing_charuco_says_what_to_install(monkeypatch):
    monkeypatch.setattr(cv2, "aruco", object())
    with pytest.raises(CalibrationError, match="opencv-python-headless>=4.7"):
        parse_board("charuco:7x5", 0.025)


@pytest.mark.parametrize("board", [CHESS, CHARUCO], ids=["chessboard", "charuco"])
def test_no_board_is_none(board):
    rng = np.random.RandomState(0)
    black, grey = np.zeros((240, 320, 3), np.uint8), np.full((240, 320), 128, np.uint8)
    noise = rng.randint(0, 256, (240, 320, 3)).astype(np.uint8)
    other = facing(CHARUCO if board is CHESS else CHESS)
    for picture in (black, 255 - black, grey, noise, other, black[:1, :1], black[:5]):
        assert detect(picture, board) is None


@pytest.mark.parametrize("picture", [np.zeros((240, 320)), np.zeros((0,), np.uint8)])
def test_what_is_no_picture_is_a_typed_error(picture):
    with pytest.raises(CalibrationError, match="uint8"):
        detect(picture, CHESS)


@given(hnp.arrays(np.uint8, st.tuples(st.integers(1, 60), st.integers(1, 60))))
def test_any_small_picture_is_looked_at_without_a_fault(picture):
    for board in (CHESS, CHARUCO):
        assert detect(picture, board) is None


def test_simulated_camera_shows_a_board_that_can_be_found():
    with BoardCamera(CameraConfig(type="board", path="9x6@25", width=320, height=240)) as camera:
        frames = [camera.read(1.0) for _ in range(8)]
    assert all(detect(frame.colour_bgr, camera.board) is not None for frame in frames)
    assert [frame.seq for frame in frames] == list(range(8))
    assert np.all(np.diff([frame.t_s for frame in frames]) > 0.0)


@pytest.mark.parametrize("path", ["9x6", "9x6@", "9x6@x", "nine@25", "9x6@-1"])
def test_simulated_camera_refuses_a_board_it_cannot_read(path):
    with pytest.raises(ConfigError, match="BOARD@MM"):
        BoardCamera(CameraConfig(type="board", path=path))
