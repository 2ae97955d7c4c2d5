import json

import cv2
import numpy as np
import pytest
import record_steps

from apex_edge import plugins
from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.calibration import save_camera
from apex_edge.cameras.folder import FolderCamera, read_timestamps
from apex_edge.cameras.mcap import McapCamera
from apex_edge.cameras.playback import config_for
from apex_edge.cameras.video import VideoCamera
from apex_edge.errors import CalibrationError, RecordingError
from apex_edge.record.mcap_io import RecordingWriter


def write_video(path, pictures, fps=25.0, code="MJPG"):
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*code), fps, (width, height))
    assert writer.isOpened()
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path


def read_all(camera):
    with camera:
        return list(iter(lambda: camera.read(1.0), None))


def play(path, **settings):
    config = config_for(path, **settings)
    return plugins.load("cameras", config.type)(config)


def write_folder(folder, n=4, depth=True):
    (folder / "depth").mkdir(parents=True)
    for seq in range(n):
        frame = record_steps.frame(seq)
        cv2.imwrite(str(folder / f"{seq:03d}.png"), frame.colour_bgr)
        if depth:
            cv2.imwrite(str(folder / "depth" / f"{seq:03d}.png"), frame.depth_mm)
    return folder


def test_video_frames_come_in_order_with_the_time_of_their_number(tmp_path):
    path = write_video(tmp_path / "a.avi", [record_steps.picture(i) for i in range(10)])
    camera = play(path)
    frames = read_all(camera)
    assert type(camera) is VideoCamera
    assert [f.seq for f in frames] == list(range(10))
    assert np.allclose([f.t_s for f in frames], np.arange(10) / 25.0, atol=1e-6)
    assert (camera.stats.grabbed, camera.stats.delivered, camera.stats.dropped) == (10, 10, 0)


def test_exactly_repeated_pictures_are_marked_and_counted(tmp_path):
    order = [0, 1, 1, 2, 2, 2, 3]
    path = write_video(tmp_path / "a.avi", [record_steps.picture(i) for i in order])
    camera = play(path)
    flags = [f.is_repeated for f in read_all(camera)]
    assert flags == [False, False, True, False, True, True, False]
    assert camera.stats.repeated == 3


def test_video_can_be_opened_again_from_its_start(tmp_path):
    camera = play(write_video(tmp_path / "a.avi", [record_steps.picture(i) for i in range(3)]))
    assert [f.seq for f in read_all(camera)] == [f.seq for f in read_all(camera)] == [0, 1, 2]


@pytest.mark.parametrize("content", [b"", b"no video " * 100, bytes(4096)])
def test_file_that_is_no_video_is_refused_when_opened(tmp_path, content):
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"a\.mp4"):
        play(path).open()


def test_missing_video_is_refused_by_name(tmp_path):
    with pytest.raises(RecordingError, match="nowhere.mp4"):
        play(tmp_path / "nowhere.mp4").open()


def test_cut_video_says_how_many_frames_could_be_read(tmp_path):
    path = write_video(tmp_path / "a.avi", [record_steps.picture(i) for i in range(40)])
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match=r"of 40 frames|OpenCV can read"):
        read_all(play(path))


def test_video_that_is_not_open_cannot_be_read(tmp_path):
    with pytest.raises(RecordingError, match="not open"):
        play(tmp_path / "a.mp4").read(1.0)


def test_folder_gives_colour_and_depth_exactly(tmp_path):
    camera = play(write_folder(tmp_path / "a"))
    frames = read_all(camera)
    assert type(camera) is FolderCamera
    assert len(frames) == 4
    for frame in frames:
        assert np.array_equal(frame.colour_bgr, record_steps.frame(frame.seq).colour_bgr)
        assert np.array_equal(frame.depth_mm, record_steps.frame(frame.seq).depth_mm)
    assert np.allclose([f.t_s for f in frames], np.arange(4) / 30.0)


def test_timestamps_give_time_and_order(tmp_path):
    folder = write_folder(tmp_path / "a")
    text = "# made by hand\nname,t_s\n003.png,1.5\n001,2.5\n002.png,2.75\n000.png,9\n"
    (folder / "timestamps.csv").write_text(text)
    frames = read_all(play(folder))
    assert [f.t_s for f in frames] == [1.5, 2.5, 2.75, 9.0]
    assert np.array_equal(frames[0].colour_bgr, record_steps.frame(3).colour_bgr)
    assert [f.seq for f in frames] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "text, message",
    [
        ("000.png,0\n001.png,1\n002.png,2\n", "no time for the picture 003.png"),
        ("000.png,0\n001.png,0\n002.png,2\n003.png,3\n", "same time"),
        ("000.png,0\n000.png,1\n", "second time"),
        ("000.png,0\n001.png,soon\n", "expected name,t_s"),
        ("000.png,0\n001.png,nan\n", "expected name,t_s"),
    ],
)
def test_unusable_timestamps_are_refused_with_the_reason(tmp_path, text, message):
    folder = write_folder(tmp_path / "a")
    (folder / "timestamps.txt").write_text(text)
    with pytest.raises(RecordingError, match=message):
        play(folder).open()


def test_timestamps_may_be_separated_by_blanks(tmp_path):
    (tmp_path / "timestamps.txt").write_text("0.png 0.5\n\n1.png\t0.75\n")
    assert read_timestamps(tmp_path / "timestamps.txt") == {"0.png": 0.5, "1.png": 0.75}


def test_broken_picture_in_a_folder_is_named(tmp_path):
    folder = write_folder(tmp_path / "a")
    (folder / "002.png").write_bytes(b"broken")
    with pytest.raises(RecordingError, match=r"002\.png.*2 frames could be read"):
        read_all(play(folder))


@pytest.mark.parametrize("depth", [np.zeros((60, 80), np.uint16), np.zeros((120, 160), np.uint8)])
def test_depth_that_does_not_fit_is_refused(tmp_path, depth):
    folder = write_folder(tmp_path / "a")
    cv2.imwrite(str(folder / "depth" / "001.png"), depth)
    with pytest.raises(RecordingError, match=r"001\.png: depth is"):
        read_all(play(folder))


def test_missing_depth_is_none_for_that_frame(tmp_path):
    folder = write_folder(tmp_path / "a")
    (folder / "depth" / "001.png").unlink()
    frames = read_all(play(folder))
    assert [f.depth_mm is None for f in frames] == [False, True, False, False]


def test_empty_and_missing_folders_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="holds no pictures"):
        play(tmp_path).open()
    with pytest.raises(RecordingError, match="no such folder"):
        FolderCamera(CameraConfig(type="folder", path=str(tmp_path / "gone"))).open()


def test_calibration_of_a_folder_travels_with_its_frames(tmp_path):
    folder = write_folder(tmp_path / "a")
    camera = record_steps.camera_model()
    save_camera(folder / "camera.json", camera, {})
    frames = read_all(play(folder))
    assert all(f.camera.fx_px == camera.fx_px for f in frames)


def test_calibration_for_another_size_is_refused(tmp_path):
    save_camera(tmp_path / "camera.json", record_steps.camera_model(640, 480), {})
    with pytest.raises(CalibrationError, match="160x120.*640x480"):
        read_all(play(write_folder(tmp_path / "a"), calibration=str(tmp_path / "camera.json")))


def test_recording_plays_with_its_arm_and_proposal(tmp_path):
    path = tmp_path / "a.mcap"
    steps = record_steps.run(27, record_steps.camera_model())
    with RecordingWriter(path, {}, picture_format="png") as writer:
        for step in steps:
            writer.write(step)
    camera = play(path)
    assert type(camera) is McapCamera
    with camera:
        for step in steps:
            frame = camera.read(1.0)
            assert np.array_equal(frame.colour_bgr, step.frame.colour_bgr)
            assert camera.recorded.proposal == step.proposal
            assert camera.recorded.arm.t_s == step.arm.t_s
        assert camera.read(1.0) is None


def test_calibration_file_changed_by_hand_is_refused(tmp_path):
    path = tmp_path / "camera.json"
    save_camera(path, record_steps.camera_model(), {"rms_px": 0.2})
    document = json.loads(path.read_text())
    document["camera"]["fx_px"] += 1.0
    path.write_text(json.dumps(document))
    with pytest.raises(CalibrationError, match="hash"):
        play(write_folder(tmp_path / "a"), calibration=str(path)).open()


def test_picture_that_counts_as_decoded_but_is_not_there_ends_the_video(tmp_path, monkeypatch):
    path = write_video(tmp_path / "a.avi", [record_steps.picture(i) for i in range(6)])

    class Damaged:
        """What OpenCV does with some damaged MJPG frames."""

        def __init__(self, name):
            self.sound, self.n_asked = sound(name), 0

        def __getattr__(self, name):
            return getattr(self.sound, name)

        def retrieve(self):
            self.n_asked += 1
            return self.sound.retrieve() if self.n_asked < 3 else (True, None)

    sound = cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", Damaged)
    with pytest.raises(RecordingError, match="2 of 6 frames"):
        read_all(play(path))
