"""The drivers on stand-ins for the makers' packages: stamps, units, alignment, losing the device.

What the real packages do is in test_camera_real_sdks.py.
"""

import sys

import camera_sdks
import cv2
import numpy as np
import pytest
from camera_sdks import HEIGHT, WIDTH, Script, Taken

from apex_edge import plugins
from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.oak import OakSource, scale_for
from apex_edge.cameras.orbbec import OrbbecSource, colour_picture
from apex_edge.cameras.picamera2 import Picamera2Source
from apex_edge.cameras.realsense import RealSenseSource
from apex_edge.errors import CameraError

NOW_S = 50.0
WALL_S = 1000.0
DRIVERS = ["realsense", "oak", "orbbec", "picamera2"]
MODULES = {
    "realsense": ("pyrealsense2", camera_sdks.realsense),
    "oak": ("depthai", camera_sdks.depthai),
    "orbbec": ("pyorbbecsdk", camera_sdks.orbbec),
    "picamera2": ("picamera2", camera_sdks.picamera2),
}


@pytest.fixture
def install(monkeypatch):
    """Put a stand-in where the driver imports its maker's package."""

    def put(name, script, **how):
        module, make = MODULES[name]
        monkeypatch.setitem(sys.modules, module, make(script, **how))

    return put


def config(name, **settings):
    return CameraConfig(type=name, width=WIDTH, height=HEIGHT, **settings)


def opened(source):
    source.open()
    return source


# --- all of them ---------------------------------------------------------------------------


@pytest.mark.parametrize("name", DRIVERS)
def test_unplugged_device_ends_the_camera_and_is_released(install, name):
    script = Script([RuntimeError("device disconnected")])
    install(name, script)
    camera = plugins.load("cameras", name)(config(name))
    camera.open()
    thread = camera._thread
    with pytest.raises(CameraError, match="was lost.*device disconnected"):
        camera.read(10.0)
    thread.join(10.0)
    assert not thread.is_alive()
    assert (script.n_opened, script.n_closed) == (1, 1)


@pytest.mark.parametrize("name", DRIVERS)
def test_device_that_only_falls_silent_is_lost_as_well(install, name):
    script = Script([])
    install(name, script)
    camera = plugins.load("cameras", name)(config(name, timeout_s=0.05))
    with camera, pytest.raises(CameraError, match="sent nothing for 0.05 s"):
        camera.read(10.0)
    assert script.n_closed == 1


@pytest.mark.parametrize("name", DRIVERS)
def test_closing_twice_closes_the_device_once(install, name):
    script = Script([])
    install(name, script)
    camera = plugins.load("cameras", name)(config(name))
    camera.open()
    camera.close()
    camera.close()
    assert script.n_closed == 1


# --- RealSense -----------------------------------------------------------------------------


def realsense(install, frames, latency_s=0.0, **how):
    install("realsense", Script(frames), **how)
    settings = config("realsense", latency_s=latency_s)
    return opened(RealSenseSource(settings, lambda: NOW_S, wall=lambda: WALL_S))


@pytest.mark.parametrize(
    "domain, age_s", [("global_time", 0.05), ("system_time", 0.08), ("hardware_clock", 0.03)]
)
def test_realsense_stamp_is_read_by_its_domain(install, domain, age_s):
    # arrival stamps lose the calibrated latency; a device's own clock starts at its first arrival
    taken = Taken(1, WALL_S - 0.05)
    source = realsense(install, [taken], latency_s=0.03, domain=domain)
    assert source.grab().t_s == pytest.approx(NOW_S - age_s)


def test_realsense_depth_unit_is_the_sensors(install):
    depth = np.array([[0, 4000, 65535, 65534]], np.uint16)
    shot = realsense(install, [Taken(1, WALL_S, depth)], unit_m=0.00025).grab()
    assert shot.depth_mm.tolist() == [[0, 1000, 65535, 16384]]


def test_realsense_picture_that_comes_twice_is_taken_once(install):
    source = realsense(install, [Taken(1, WALL_S), Taken(1, WALL_S), Taken(2, WALL_S)])
    assert [source.grab() is None for _ in range(3)] == [False, True, False]


def test_realsense_depth_of_another_moment_is_left_out(install):
    late = Taken(1, WALL_S, depth_stamp_s=WALL_S - 0.033)
    shot = realsense(install, [late]).grab()
    assert shot.colour_bgr is not None and shot.depth_mm is None


def test_realsense_frames_outlive_the_buffers_of_the_sdk(install):
    taken = Taken(7, WALL_S)
    shot = realsense(install, [taken]).grab()
    taken.picture[:] = 0
    taken.depth[:] = 0
    assert np.all(shot.colour_bgr == 7) and np.all(shot.depth_mm == 500)


def test_realsense_serial_number_picks_the_device(install):
    script = Script([])
    install("realsense", script)
    opened(RealSenseSource(config("realsense", path="8123"), lambda: NOW_S))
    assert script.serial == "8123"


def test_realsense_lens_is_offered(install):
    lens = realsense(install, []).intrinsics
    assert (lens.width_px, lens.height_px, lens.fx_px, lens.cy_px) == (WIDTH, HEIGHT, 60.0, 24.0)
    assert not lens.dist.any()


def test_realsense_that_is_not_plugged_in_is_said_at_once(install):
    with pytest.raises(CameraError, match="no RealSense camera is plugged in"):
        realsense(install, [], n_devices=0)


# --- OAK -----------------------------------------------------------------------------------


def test_oak_stamp_is_the_middle_of_the_exposure(install):
    install("oak", Script([Taken(1, 40.0)]), exposure_s=0.02)
    shot = opened(OakSource(config("oak"), lambda: NOW_S)).grab()
    assert shot.t_s == pytest.approx(39.99)
    assert np.all(shot.depth_mm == 500)


@pytest.mark.parametrize(
    "width, scale", [(320, (1, 3)), (640, (1, 3)), (1000, (1, 2)), (1280, (2, 3)), (4000, (1, 1))]
)
def test_oak_picture_is_the_nearest_size_there_is(width, scale):
    assert scale_for(width) == scale


def test_oak_lens_is_offered_unless_it_is_a_fisheye(install):
    install("oak", Script([]))
    assert opened(OakSource(config("oak"), lambda: NOW_S)).intrinsics.fx_px == 450.0
    install("oak", Script([]), model="fisheye")
    assert opened(OakSource(config("oak"), lambda: NOW_S)).intrinsics is None


def test_other_major_version_of_depthai_is_named(monkeypatch):
    module = type(sys)("depthai")
    module.node, module.__version__ = type(sys)("node"), "3.12.0"
    monkeypatch.setitem(sys.modules, "depthai", module)
    with pytest.raises(CameraError, match=r"depthai 3.12.0 is installed.*needs depthai>=2.24,<3"):
        OakSource(config("oak"), lambda: NOW_S).open()


# --- Orbbec --------------------------------------------------------------------------------


@pytest.mark.parametrize("is_global, age_s", [(True, 0.05), (False, 0.08)])
def test_orbbec_stamp_is_the_global_one_where_there_is_one(install, is_global, age_s):
    install("orbbec", Script([Taken(1, WALL_S - 0.05)]), is_global=is_global)
    settings = config("orbbec", latency_s=0.03)
    source = opened(OrbbecSource(settings, lambda: NOW_S, wall=lambda: WALL_S))
    assert source.grab().t_s == pytest.approx(NOW_S - age_s)


def test_orbbec_depth_unit_is_the_frames(install):
    install("orbbec", Script([Taken(1, WALL_S)]), scale=0.2)
    source = opened(OrbbecSource(config("orbbec"), lambda: NOW_S, wall=lambda: WALL_S))
    assert np.all(source.grab().depth_mm == 100)


@pytest.mark.parametrize("kind", ["BGR", "RGB", "MJPG", "YUYV"])
def test_orbbec_colour_formats_become_bgr(kind):
    picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    picture[:] = (40, 90, 200)
    data = {
        "BGR": picture,
        "RGB": picture[..., ::-1],
        "MJPG": cv2.imencode(".jpg", picture)[1],
        "YUYV": yuyv(picture),
    }[kind]
    ob = camera_sdks.orbbec(Script([]))
    frame = camera_sdks.SimpleNamespace(
        get_width=lambda: WIDTH,
        get_height=lambda: HEIGHT,
        get_format=lambda: kind,
        get_data=lambda: np.ascontiguousarray(data).ravel(),
    )
    found = colour_picture(ob, frame)
    assert found.shape == picture.shape
    assert np.max(np.abs(found.astype(int) - picture)) <= 6


def test_orbbec_frame_that_was_cut_short_is_dropped():
    ob = camera_sdks.orbbec(Script([]))
    frame = camera_sdks.SimpleNamespace(
        get_width=lambda: WIDTH,
        get_height=lambda: HEIGHT,
        get_format=lambda: "RGB",
        get_data=lambda: np.zeros(100, np.uint8),
    )
    assert colour_picture(ob, frame) is None


def test_orbbec_without_the_size_asked_for_says_so(install):
    install("orbbec", Script([]), offered="H264")
    with pytest.raises(CameraError, match=f"no colour of {WIDTH}x{HEIGHT} at 30 Hz"):
        OrbbecSource(config("orbbec"), lambda: NOW_S).open()


def yuyv(picture):
    """Pack a picture of one colour."""
    planes = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420).ravel()
    packed = np.empty((HEIGHT, WIDTH, 2), np.uint8)
    packed[..., 0] = planes[0]
    packed[:, 0::2, 1], packed[:, 1::2, 1] = planes[HEIGHT * WIDTH], planes[-1]
    return packed


# --- Pi cameras ----------------------------------------------------------------------------


def pi_camera(install, frames, **how):
    script = Script(frames)
    install("picamera2", script, **how)
    # 30 s of the time since boot were spent asleep
    return script, opened(
        Picamera2Source(config("picamera2"), lambda: NOW_S, since_boot=lambda: NOW_S + 30.0)
    )


def test_pi_camera_stamp_is_the_middle_of_the_exposure_without_the_time_asleep(install):
    script, source = pi_camera(install, [Taken(1, NOW_S + 30.5)], exposure_us=20000)
    assert source.grab().t_s == pytest.approx(NOW_S + 0.49)
    assert script.n_released == 1


def test_pi_picture_begun_before_the_camera_was_opened_is_left_out(install):
    script, source = pi_camera(install, [Taken(1, NOW_S + 30.005), Taken(2, NOW_S + 30.04)])
    assert source.grab() is None
    assert np.all(source.grab().colour_bgr == 2)
    assert script.n_released == 2


def test_pi_camera_keeps_no_old_picture_for_the_next_request(install):
    script, _ = pi_camera(install, [])
    assert script.wanted["queue"] is False
    assert script.wanted["main"] == {"size": (WIDTH, HEIGHT), "format": "RGB888"}


def test_request_that_pi_camera_did_not_answer_is_taken_back(install):
    script, source = pi_camera(install, [None])
    assert source.grab() is None
    assert script.n_cancelled == 1


@pytest.mark.parametrize("path, words", [("1", "Pi camera 1 cannot be opened"), ("x", "by number")])
def test_pi_camera_that_is_not_there_is_named(install, path, words):
    install("picamera2", Script([]))
    with pytest.raises(CameraError, match=words):
        Picamera2Source(config("picamera2", path=path), lambda: NOW_S).open()
