from dataclasses import replace

import cv2
import numpy as np
import pytest
import record_steps

from apex_edge.errors import RecordingError
from apex_edge.geometry import project
from apex_edge.record.canvas import BEST, Canvas, name_colour
from apex_edge.record.draw import annotate, moving_path
from apex_edge.record.montage import Moment, montage, spread
from apex_edge.record.safe_points import OUTCOMES, draw_safe_points, outcome_of
from apex_edge.record.story import SceneStory
from apex_edge.record.video import AnnotatedVideo
from apex_edge.types import Frame

CAMERA = record_steps.camera_model(640, 480)
GREY = np.full((480, 640, 3), 180, np.uint8)


def grey_step(seq, camera=CAMERA, picture=GREY):
    return record_steps.step(
        seq, camera, picture_of=Frame(seq, 10.0 + seq / 30.0, picture, None, camera)
    )


def count_frames(path):
    capture = cv2.VideoCapture(str(path))
    sizes = []
    while True:
        is_read, picture = capture.read()
        if not is_read:
            return sizes
        sizes.append(picture.shape)


def test_annotating_leaves_the_frame_itself_untouched():
    step = grey_step(25)
    before = step.frame.colour_bgr.copy()
    picture = annotate(step)
    assert np.array_equal(step.frame.colour_bgr, before)
    assert picture.shape == before.shape
    assert not np.array_equal(picture, before)


def test_marks_stand_where_the_objects_are():
    step = grey_step(5)
    picture = annotate(step)
    at = step.tracks.centre_px[1]
    radius = np.sqrt(step.tracks.area_px2[1] / np.pi) + 1.5
    edge = picture[int(at[1]), int(round(at[0] + radius))]
    assert np.abs(edge.astype(int) - name_colour("red")).max() < 60


def test_best_points_are_drawn_at_their_projection():
    step = grey_step(20)
    picture = annotate(step)
    pixels, _ = project(CAMERA, step.rollouts.candidates.tip_m[step.rollouts.best])
    inside = [p for p in pixels if np.linalg.norm(p - step.tracks.centre_px, axis=1).min() > 60]
    assert inside
    for x, y in inside:
        assert np.abs(picture[int(round(y)), int(round(x))].astype(int) - BEST).max() < 90


def test_uncalibrated_lost_and_empty_steps_can_be_drawn():
    annotate(grey_step(25, camera=None))
    step = grey_step(25)
    lost = replace(
        step.tracks,
        status=np.array([2, 2]),
        centre_px=np.full((2, 2), np.nan),
        pos_m=np.full((2, 3), np.nan),
        vel_m_s=np.full((2, 3), np.nan),
    )
    annotate(replace(step, tracks=lost))
    annotate(replace(step, arm=None, rollouts=None, hazards=None, command=None, ack=None))


@pytest.mark.parametrize("width, height", [(160, 120), (1920, 1080), (48, 32)])
def test_any_picture_size_can_be_drawn(width, height):
    picture = np.full((height, width, 3), 90, np.uint8)
    camera = record_steps.camera_model(width, height)
    assert annotate(grey_step(25, camera, picture)).shape == (height, width, 3)


def test_many_dots_at_once_match_their_places_and_skip_what_is_outside():
    canvas = Canvas(np.zeros((480, 640, 3), np.uint8))
    pixels = np.array([[100.0, 50.0], [-5.0, 10.0], [np.nan, 3.0], [1e12, 0.0], [639.0, 479.0]])
    canvas.dots(pixels, 1.0, np.tile(np.array([1, 2, 3], np.uint8), (5, 1)))
    assert canvas.picture[50, 100].tolist() == [1, 2, 3]
    assert canvas.picture[479, 639].tolist() == [1, 2, 3]
    assert np.count_nonzero(canvas.picture[:, :, 0]) == 5 + 3


def test_labels_do_not_cover_each_other():
    canvas = Canvas(np.zeros((480, 640, 3), np.uint8))
    for _ in range(4):
        canvas.label((320.0, 240.0), 10.0, "red #1", (9, 9, 9))
    boxes = canvas._taken
    for i, (x, y, w, h) in enumerate(boxes):
        for tx, ty, tw, th in boxes[i + 1 :]:
            assert x + w <= tx or tx + tw <= x or y + h <= ty or ty + th <= y


def test_braking_object_stops_on_its_predicted_path():
    path = moving_path(np.zeros(3), np.array([0.2, 0.0, 0.0]), np.array([-0.2, 0.0, 0.0]), 5.0)
    assert path[-1, 0] == pytest.approx(0.1, abs=1e-6)
    assert np.all(np.diff(path[:, 0]) > 0)


def test_outcomes_of_all_candidates_add_up():
    rollouts = record_steps.rollouts(record_steps.frame(20), record_steps.candidates(200))
    counts = np.bincount(outcome_of(rollouts), minlength=len(OUTCOMES))
    assert counts[0] == rollouts.is_safe.sum() > 0
    assert counts[2] == np.sum(~rollouts.is_safe & (rollouts.slack_s < 0)) > 0
    assert counts.sum() == 200


def test_safe_points_are_drawn_in_their_colour():
    step = record_steps.step(20, CAMERA, record_steps.candidates(600))
    with_safe = draw_safe_points(step.rollouts, step.tracks)
    none = replace(
        step.rollouts,
        is_safe=np.zeros_like(step.rollouts.is_safe),
        best=np.zeros(0, dtype=np.int64),
        score=np.full_like(step.rollouts.score, -np.inf),
    )
    without = draw_safe_points(none, step.tracks)

    def n_green(picture):
        blue, green, red = (picture[:1000, :, i].astype(int) for i in range(3))
        return np.count_nonzero((green - red > 60) & (green - blue > 20))

    assert with_safe.shape == without.shape
    assert n_green(with_safe) > n_green(without) + 100


def test_montage_shows_every_moment_at_the_asked_width():
    moments = [Moment(f"m{i}", i * 0.5, GREY) for i in range(5)]
    sheet = montage(moments, width_px=900)
    assert sheet.shape[1] == 900
    cell = sheet[60:200, 60:200]
    assert np.all(cell == 180)


def test_montage_of_nothing_is_refused():
    with pytest.raises(RecordingError):
        montage([])


def test_spread_keeps_first_and_last():
    moments = [Moment("", float(i), GREY) for i in range(40)]
    assert [m.t_s for m in spread(moments, 5)] == [0.0, 10.0, 20.0, 29.0, 39.0]
    assert spread(moments[:3], 5) == moments[:3]


@pytest.mark.parametrize("suffix", [".webm", ".mp4", ".avi"])
def test_annotated_video_opens_again_with_every_frame(tmp_path, suffix):
    with AnnotatedVideo(tmp_path / f"a{suffix}", 30.0) as video:
        for seq in range(12):
            video.write(grey_step(seq))
        assert not (tmp_path / f"a{suffix}").exists()
    assert count_frames(video.path) == [(480, 640, 3)] * 12
    assert [p for p in tmp_path.iterdir()] == [video.path]


def test_odd_picture_size_is_cut_to_even(tmp_path):
    with AnnotatedVideo(tmp_path / "a.mp4", 30.0) as video:
        video.write_picture(np.zeros((121, 161, 3), np.uint8))
    assert count_frames(video.path) == [(120, 160, 3)]


def test_missing_codec_falls_back_to_jpeg_frames(tmp_path, monkeypatch):
    from apex_edge.record import video as module

    monkeypatch.setitem(module.CODECS, ".mp4", "....")
    with AnnotatedVideo(tmp_path / "a.mp4", 30.0) as video:
        video.write_picture(GREY)
    assert video.path == tmp_path / "a.avi"
    assert count_frames(video.path) == [(480, 640, 3)]


def test_failed_run_leaves_no_half_video(tmp_path):
    with pytest.raises(ZeroDivisionError), AnnotatedVideo(tmp_path / "a.avi", 30.0) as video:
        video.write_picture(GREY)
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())


def test_video_refuses_another_size_name_or_folder(tmp_path):
    with AnnotatedVideo(tmp_path / "a.avi", 30.0) as video:
        video.write_picture(GREY)
        with pytest.raises(RecordingError, match="320x240"):
            video.write_picture(np.zeros((240, 320, 3), np.uint8))
    with pytest.raises(RecordingError, match="a.gif"):
        AnnotatedVideo(tmp_path / "a.gif", 30.0)
    with pytest.raises(RecordingError, match="gone"):
        AnnotatedVideo(tmp_path / "gone" / "a.avi", 30.0)


def test_story_keeps_key_moments_decisions_and_times():
    story = SceneStory()
    for seq in range(60):
        story.write(grey_step(seq))
    notes = story.notes()
    assert notes.n_frames == 60
    assert notes.duration_s == pytest.approx(59 / 30.0)
    assert [e.action for e in notes.events] == ["none", "watch", "intervene", "hold"]
    assert notes.frame_to_command_s == (pytest.approx(0.01),)
    assert [(c.source, c.verdict) for c in notes.calls] == [("llm", "late")]
    assert len(notes.timing_s["perception"]) == 60
    assert notes.montage.shape[1] == 1280
    assert notes.safe_points is not None
    labels = [m.label for m in story._moments()]
    assert labels == ["start", "hazard", "simulated", "intervention", "arm there", "end"]


def test_sparse_story_is_filled_with_moments_between():
    story = SceneStory()
    for seq in (0, 25, 60, 90, 120, 150):
        story.write(grey_step(seq))
    labels = [m.label for m in story._moments()]
    assert labels == ["start", "intervention", "hold", "hold", "hold", "end"]
    assert [m.t_s for m in story._moments()] == sorted(m.t_s for m in story._moments())


def test_quiet_scene_has_a_montage_and_no_safe_points():
    story = SceneStory()
    for seq in range(10):
        story.write(grey_step(seq))
    notes = story.notes()
    assert notes.montage is not None
    assert notes.safe_points is None
    assert [e.action for e in notes.events] == ["none"]


def test_long_quiet_scene_stays_small():
    story = SceneStory()
    step = grey_step(0)
    for second in range(200):
        story.write(replace(step, frame=replace(step.frame, t_s=10.0 + second)))
    assert len(story._plain) <= 25
    assert story.notes().duration_s == 199.0


def test_story_of_steps_without_pictures_has_no_montage():
    story = SceneStory()
    step = grey_step(0)
    story.write(replace(step, frame=replace(step.frame, colour_bgr=np.zeros((0, 0, 3), np.uint8))))
    assert story.notes().montage is None
    assert SceneStory().notes().n_frames == 0
