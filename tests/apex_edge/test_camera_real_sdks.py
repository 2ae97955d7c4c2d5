"""The drivers on the makers' own packages, where they are installed; no camera is needed.

RealSense: the SDK's software device records a file and the driver plays it through the SDK's real
pipeline and alignment. OAK and Orbbec: the SDK's own frames, pipelines and empty device lists.
"""

import importlib
import time
from datetime import timedelta

import cv2
import numpy as np
import pytest

from apex_edge.cameras import oak, orbbec, realsense
from apex_edge.cameras.base import CameraConfig
from apex_edge.errors import CameraError

WIDTH, HEIGHT = 320, 240
NEAR_MM, FAR_MM = 600, 1000
SHIFT_M = 0.05


def installed(module):
    try:
        return importlib.import_module(module)
    except ImportError as error:  # not there, or without a shared library that it needs
        return pytest.skip(f"{module}: {error}")


@pytest.fixture
def rs():
    return installed("pyrealsense2")


@pytest.fixture
def dai():
    return installed("depthai")


@pytest.fixture
def ob():
    found = installed("pyorbbecsdk")
    found.Context.set_logger_to_console(found.OBLogLevel.NONE)
    found.Context.set_logger_to_file(found.OBLogLevel.NONE, "")
    return found


# --- RealSense -----------------------------------------------------------------------------


def rs_stream(rs, kind, uid, bytes_per_pixel, form, focal_px):
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy = WIDTH, HEIGHT, focal_px, focal_px
    lens.ppx, lens.ppy = WIDTH / 2, HEIGHT / 2
    lens.model, lens.coeffs = rs.distortion.brown_conrady, [0.0] * 5
    stream = rs.video_stream()
    stream.type, stream.index, stream.uid = kind, 0, uid
    stream.width, stream.height, stream.fps = WIDTH, HEIGHT, 30
    stream.bpp, stream.fmt, stream.intrinsics = bytes_per_pixel, form, lens
    return stream


def rs_frame(rs, profile, pixels, number, stamp_ms):
    frame = rs.software_video_frame()
    frame.pixels, frame.bpp = pixels, pixels.nbytes // (WIDTH * HEIGHT)
    frame.stride = WIDTH * frame.bpp
    frame.timestamp, frame.domain = stamp_ms, rs.timestamp_domain.hardware_clock
    frame.frame_number, frame.profile = number, profile.as_video_stream_profile()
    if pixels.dtype == np.uint16:
        frame.depth_units = 0.0001
    return frame


def rs_recording(rs, folder, n_frames=12):
    """Record a near square before a far wall, seen by two lenses 5 cm apart; units of 0.1 mm."""
    device = rs.software_device()
    depth_sensor, colour_sensor = device.add_sensor("Depth"), device.add_sensor("Color")
    depth = depth_sensor.add_video_stream(
        rs_stream(rs, rs.stream.depth, 1, 2, rs.format.z16, 250.0)
    )
    depth_sensor.add_read_only_option(rs.option.depth_units, 0.0001)
    colour = colour_sensor.add_video_stream(
        rs_stream(rs, rs.stream.color, 2, 3, rs.format.bgr8, 300.0)
    )
    offset = rs.extrinsics()
    offset.rotation, offset.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [SHIFT_M, 0.0, 0.0]
    depth.register_extrinsics_to(colour, offset)
    try:
        path = folder / "made.db3"
        recorder = rs.recorder(str(path), device)
    except RuntimeError:  # before version 2.58 the SDK recorded bags
        path = folder / "made.bag"
        recorder = rs.recorder(str(path), device)
    kept = rs.frame_queue(50)
    for sensor in recorder.query_sensors():
        sensor.open(sensor.get_stream_profiles())
        sensor.start(kept)
    range_01mm = np.full((HEIGHT, WIDTH), 10 * FAR_MM, np.uint16)
    range_01mm[100:140, 140:180] = 10 * NEAR_MM
    for number in range(n_frames):
        picture = np.full((HEIGHT, WIDTH, 3), 50 + number, np.uint8)
        stamp_ms = 5000.0 + 40.0 * number
        depth_sensor.on_video_frame(rs_frame(rs, depth, range_01mm, number, stamp_ms))
        colour_sensor.on_video_frame(rs_frame(rs, colour, picture, number, stamp_ms))
        time.sleep(0.04)
    for sensor in recorder.query_sensors():
        sensor.stop()
        sensor.close()
    return path


def rs_config(path, **settings):
    return CameraConfig(
        type="realsense", path=str(path), width=WIDTH, height=HEIGHT, max_age_s=10.0, **settings
    )


def test_realsense_pictures_come_once_with_aligned_depth_in_mm(rs, tmp_path):
    source = realsense.RealSenseSource(rs_config(rs_recording(rs, tmp_path)), time.monotonic)
    source.open()
    shots, n_silent = [], 0
    while n_silent < 5:
        shot = source.grab()
        n_silent = 0 if shot is not None else n_silent + 1
        shots += [] if shot is None else [shot]
    lens = source.intrinsics
    source.close()
    shades = [int(shot.colour_bgr[0, 0, 0]) for shot in shots]
    assert len(shades) >= 6 and shades == sorted(set(shades))
    steps_s = np.diff([shot.t_s for shot in shots])
    assert np.all(steps_s > 0.0)
    # the device's own steps, less what the clocks' offset is still found to be smaller
    made_s = 0.040 * np.diff(shades)
    assert np.all(steps_s <= made_s + 1e-6) and steps_s.sum() >= 0.25 * made_s.sum()
    assert (lens.width_px, lens.fx_px, lens.cx_px) == (WIDTH, 300.0, WIDTH / 2)
    depths = [shot.depth_mm for shot in shots if shot.depth_mm is not None]
    assert depths
    for depth_mm in depths:
        assert depth_mm.shape == (HEIGHT, WIDTH) and depth_mm.dtype == np.uint16
        near = np.argwhere(depth_mm == NEAR_MM)
        # depth lens f = 250: the square spans x -0.048..0.048 m; the colour lens sees it 5 cm aside
        left_px = WIDTH / 2 + 300.0 * (-20 / 250.0 * 0.001 * NEAR_MM + SHIFT_M) / (0.001 * NEAR_MM)
        assert abs(near[:, 1].min() - left_px) <= 1.5
        assert abs(np.median(depth_mm[depth_mm > 0]) - FAR_MM) <= 1


def test_realsense_recording_that_ends_is_a_lost_camera(rs, tmp_path):
    path = rs_recording(rs, tmp_path, n_frames=6)
    with realsense.RealSenseCamera(rs_config(path, timeout_s=0.5)) as camera:
        with pytest.raises(CameraError, match="was lost: it sent nothing for 0.5 s"):
            for _ in range(100):
                assert camera.read(10.0).colour_bgr.shape == (HEIGHT, WIDTH, 3)
        assert camera.stats.grabbed >= 2


def test_realsense_without_a_camera_is_said(rs):
    with pytest.raises(CameraError, match="no RealSense camera is plugged in"):
        realsense.RealSenseCamera(CameraConfig(type="realsense")).open()


@pytest.mark.parametrize(
    "model", ["brown_conrady", "modified_brown_conrady", "inverse_brown_conrady"]
)
def test_realsense_lens_bends_as_the_sdk_does(rs, model):
    found = rs.intrinsics()
    found.width, found.height, found.fx, found.fy = 640, 480, 600.0, 605.0
    found.ppx, found.ppy = 322.0, 237.0
    found.model = getattr(rs.distortion, model)
    found.coeffs = [-0.05, 0.06, 0.0005, -0.0008, -0.02]
    lens = realsense._lens(rs, found)
    worst = 0.0
    for x, y in ((10.0, 10.0), (320.0, 240.0), (600.0, 30.0), (50.0, 450.0)):
        point = np.array([rs.rs2_deproject_pixel_to_point(found, [x, y], 1.0)])
        matrix = np.array([[lens.fx_px, 0, lens.cx_px], [0, lens.fy_px, lens.cy_px], [0, 0, 1]])
        pixel, _ = cv2.projectPoints(point, np.zeros(3), np.zeros(3), matrix, lens.dist)
        worst = max(worst, float(np.hypot(*(pixel.ravel() - (x, y)))))
    assert worst <= 0.1


# --- OAK -----------------------------------------------------------------------------------


def test_oak_pipeline_is_one_that_depthai_accepts(dai):
    pipeline = oak.build_pipeline(dai, CameraConfig(type="oak", width=640, fps=25.0))
    nodes = [node["name"] for _, node in pipeline.serializeToJson()["pipeline"]["nodes"]]
    assert sorted(nodes) == sorted(
        ["ColorCamera", "MonoCamera", "MonoCamera", "StereoDepth", "Sync", "XLinkOut"]
    )


def test_oak_stamps_are_on_the_capture_clock(dai):
    before_s = time.monotonic()
    now_s = dai.Clock.now().total_seconds()
    assert before_s <= now_s <= time.monotonic()


def test_oak_pair_becomes_a_shot(dai):
    colour, depth, pair = dai.ImgFrame(), dai.ImgFrame(), dai.MessageGroup()
    colour.setType(dai.ImgFrame.Type.YUV420p)
    colour.setWidth(64)
    colour.setHeight(32)
    colour.setData(np.full(64 * 32 * 3 // 2, 128, np.uint8))
    colour.setTimestamp(timedelta(seconds=12.5))
    depth.setType(dai.ImgFrame.Type.RAW16)
    depth.setWidth(64)
    depth.setHeight(32)
    depth.setData(np.full((32, 64), 1234, np.uint16).view(np.uint8).ravel())
    pair["colour"], pair["depth"] = colour, depth
    shot = oak.read_pair(dai, pair)
    assert shot.t_s == pytest.approx(12.5, abs=1e-6)
    assert shot.colour_bgr.shape == (32, 64, 3) and shot.colour_bgr.dtype == np.uint8
    assert shot.depth_mm.shape == (32, 64) and np.all(shot.depth_mm == 1234)


def test_oak_without_a_camera_is_said(dai):
    with pytest.raises(CameraError, match="OAK camera '' cannot be opened"):
        oak.OakCamera(CameraConfig(type="oak")).open()


# --- Orbbec --------------------------------------------------------------------------------


def test_orbbec_frames_become_pictures(ob):
    colour = ob.ColorFrame.create_video_frame(
        ob.OBFrameType.COLOR_FRAME, ob.OBFormat.RGB, 16, 8
    ).as_color_frame()
    rgb = np.zeros((8, 16, 3), np.uint8)
    rgb[..., 0] = 200
    colour.update_data(rgb.tobytes())
    picture = orbbec.colour_picture(ob, colour)
    assert picture.shape == (8, 16, 3) and picture[0, 0].tolist() == [0, 0, 200]
    depth = ob.DepthFrame.create_video_frame(
        ob.OBFrameType.DEPTH_FRAME, ob.OBFormat.Y16, 16, 8
    ).as_depth_frame()
    depth.set_value_scale(0.5)
    depth.update_data(np.full((8, 16), 3000, np.uint16).tobytes())
    assert np.all(orbbec.depth_picture(depth) == 1500)


def test_orbbec_without_a_camera_is_said(ob):
    with pytest.raises(CameraError, match="no Orbbec camera"):
        orbbec.OrbbecCamera(CameraConfig(type="orbbec")).open()
