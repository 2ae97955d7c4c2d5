"""What every driver gets for nothing: the grab thread, clocks, units, lens models, advice."""

import logging
import queue
import threading

import cv2
import numpy as np
import pytest
import record_steps
from hypothesis import given
from hypothesis import strategies as st

from apex_edge import plugins
from apex_edge.cameras.base import CameraConfig
from apex_edge.cameras.calibration import save_camera
from apex_edge.cameras.depth_unit import to_mm
from apex_edge.cameras.grabbing import GrabbingCamera, Shot, Source
from apex_edge.cameras.lens import from_opencv, plain_lens
from apex_edge.cameras.sdk import Sdk, how_to_install, load
from apex_edge.cameras.stamps import CaptureClock
from apex_edge.errors import CameraError
from apex_edge.twin.view import twin_camera_model

SIZE = (record_steps.WIDTH, record_steps.HEIGHT)


class ScriptedSource(Source):
    """Hands out what is put on its queue: a Shot, None for silence, or an error to raise."""

    def __init__(self, lens=None, refuses=""):
        self.script = queue.Queue()
        self.lens, self.refuses = lens, refuses
        self.is_closed = threading.Event()

    def open(self):
        if self.refuses:
            raise CameraError(self.refuses)

    def grab(self):
        try:
            item = self.script.get(timeout=0.02)
        except queue.Empty:
            return None
        if isinstance(item, Exception):
            raise item
        return item

    @property
    def intrinsics(self):
        return self.lens

    def close(self):
        self.is_closed.set()


def camera_on(source, clock=lambda: 10.0, **settings):
    config = CameraConfig(type="scripted", path="front", **settings)
    return GrabbingCamera(config, lambda: source, clock)


def shot(number, t_s=10.0, depth_mm=None):
    return Shot(t_s, record_steps.picture(number), depth_mm)


def test_depth_and_stamp_of_a_shot_reach_the_frame():
    source = ScriptedSource()
    depth_mm = np.full(SIZE[::-1], 700, np.uint16)
    with camera_on(source) as camera:
        source.script.put(shot(1, 9.95, depth_mm))
        frame = camera.read(10.0)
    assert frame.t_s == 9.95 and frame.seq == 0
    assert np.array_equal(frame.depth_mm, depth_mm)
    assert source.is_closed.is_set()


def test_every_frame_is_counted_once():
    source = ScriptedSource()
    with camera_on(source) as camera:
        source.script.put(shot(1))
        camera.read(10.0)
        source.script.put(Shot(10.0, None))
        source.script.put(shot(2))
        camera.read(10.0)
        source.script.put(shot(2))
        assert camera.read(10.0).is_repeated
    stats = camera.stats
    counts = (stats.grabbed, stats.delivered, stats.dropped, stats.repeated, stats.stale)
    assert counts == (4, 3, 1, 1, 0)


def test_device_that_fails_is_lost_with_its_reason_and_released():
    source = ScriptedSource()
    with camera_on(source) as camera:
        source.script.put(CameraError("USB went away"))
        with pytest.raises(CameraError, match="'front' was lost: USB went away"):
            camera.read(10.0)
        assert source.is_closed.wait(10.0)


def test_device_that_falls_silent_is_lost():
    source = ScriptedSource()
    times = iter(np.arange(0.0, 1e4, 0.5))
    with camera_on(source, clock=lambda: next(times), timeout_s=1.0) as camera:
        with pytest.raises(CameraError, match="was lost: it sent nothing for 1 s"):
            camera.read(10.0)
        assert source.is_closed.wait(10.0)


def test_device_that_cannot_be_opened_is_released():
    source = ScriptedSource(refuses="in use")
    with pytest.raises(CameraError, match="in use"):
        camera_on(source).open()
    assert source.is_closed.is_set()


def test_camera_can_be_opened_again_after_a_loss():
    sources = [ScriptedSource(), ScriptedSource()]
    made = iter(sources)
    camera = GrabbingCamera(CameraConfig(path="front"), lambda: next(made), lambda: 10.0)
    camera.open()
    sources[0].script.put(CameraError("gone"))
    with pytest.raises(CameraError, match="gone"):
        camera.read(10.0)
    camera.open()
    sources[1].script.put(shot(3))
    assert camera.read(10.0).seq == 0
    camera.close()
    assert all(source.is_closed.is_set() for source in sources)


@pytest.mark.parametrize("focal_px, n_warnings", [(500.0, 1), (553.0, 0)])
def test_calibration_of_another_lens_is_warned_of_once(tmp_path, caplog, focal_px, n_warnings):
    save_camera(tmp_path / "camera.json", twin_camera_model(*SIZE, 560.0), {})
    source = ScriptedSource(plain_lens(SIZE, (focal_px, focal_px), (SIZE[0] / 2, SIZE[1] / 2)))
    caplog.set_level(logging.WARNING)
    with camera_on(source, calibration=str(tmp_path / "camera.json")) as camera:
        for number in range(3):
            source.script.put(shot(number))
            assert camera.read(10.0).camera is not None
        assert camera.intrinsics.fx_px == focal_px
    assert len([r for r in caplog.records if "focal length" in r.message]) == n_warnings


def test_live_cameras_are_known_as_such():
    types = plugins.names("cameras")
    live = {name for name in types if plugins.load("cameras", name).is_live}
    assert live == {"live", "realsense", "oak", "orbbec", "picamera2"}


# --- clocks --------------------------------------------------------------------------------


def test_wall_stamp_keeps_its_age():
    clock = CaptureClock(0.03, wall=lambda: 1000.5)
    assert clock.from_wall(1000.46, 7.0, is_arrival=False) == pytest.approx(6.96)
    assert clock.from_wall(1000.46, 7.0, is_arrival=True) == pytest.approx(6.93)


@pytest.mark.parametrize("wall_s", [5000.0, 20.0])
def test_wall_clock_that_was_set_does_not_move_the_stamps(wall_s):
    walls = iter([1000.05, wall_s])
    clock = CaptureClock(0.0, wall=lambda: next(walls))
    assert clock.from_wall(1000.0, 7.0, is_arrival=False) == pytest.approx(6.95)
    # by its own stamp it is 0.033 s younger, and it came after 0.033 s
    assert clock.from_wall(1000.033, 7.033, is_arrival=False) == pytest.approx(7.033)


def test_device_stamps_lose_the_jitter_of_their_arrival():
    clock, rng = CaptureClock(0.01), np.random.RandomState(0)
    device_s = 50.0 + 0.033 * np.arange(200)
    delay_s = 0.02 + rng.exponential(0.01, 200)
    found = [clock.from_device(s, s - 40.0 + d) for s, d in zip(device_s, delay_s)]
    truth = device_s - 40.0 + delay_s.min() - 0.01
    assert np.max(np.abs(np.array(found[100:]) - truth[100:])) <= 0.001


def test_picture_that_was_held_up_does_not_look_fresh():
    clock = CaptureClock(0.0)
    clock.from_device(1.0, 100.0)
    assert clock.from_device(1.1, 103.1) == pytest.approx(100.1)


def test_device_clock_that_starts_anew_is_followed():
    clock = CaptureClock(0.0)
    clock.from_device(5000.0, 100.0)
    assert clock.from_device(0.5, 101.0) == pytest.approx(101.0)


def test_quartz_that_runs_slow_is_followed():
    clock = CaptureClock(0.0)
    now_s = np.arange(0.0, 120.0, 0.1)
    found = [clock.from_device(t * (1.0 - 5e-5), t) for t in now_s]
    assert np.max(now_s - np.array(found)) <= 0.0015


# --- units, lenses, advice -----------------------------------------------------------------


@given(st.integers(0, 65535), st.sampled_from([0.0001, 0.00025, 0.001, 0.0010000000475, 0.004]))
def test_depth_units_become_millimetres(raw, unit_m):
    mm = int(to_mm(np.array([[raw]], np.uint16), unit_m)[0, 0])
    if raw in (0, 65535):
        assert mm == raw
    elif raw * unit_m > 65.534:
        assert mm == 65535
    else:
        assert abs(mm - 1000.0 * raw * unit_m) <= 0.51


def test_rational_lens_is_met_by_five_coefficients():
    lens = plain_lens((640, 360), (450.0, 450.0), (321.0, 178.0))
    rational = np.array([2.1, -1.0, 0.0004, -0.0003, 0.2, 2.0, -0.9, 0.1, 0, 0, 0, 0, 0, 0])
    five = from_opencv(lens, rational)
    points = np.random.RandomState(0).uniform(-0.5, 0.5, (50, 2)) * (640 / 450.0, 360 / 450.0)
    points = np.column_stack([points, np.ones(50)])
    matrix, still = np.diag([450.0, 450.0, 1.0]), np.zeros(3)
    one, _ = cv2.projectPoints(points, still, still, matrix, rational)
    two, _ = cv2.projectPoints(points, still, still, matrix, five)
    assert np.max(np.abs(one - two)) <= 0.1


def test_five_coefficients_stay_as_they_are():
    lens = plain_lens((640, 360), (450.0, 450.0), (321.0, 178.0))
    assert from_opencv(lens, [0.1, -0.2, 0.01, 0.02, 0.3, 0.0, 0.0, 0.0]).tolist() == [
        *(0.1, -0.2, 0.01, 0.02, 0.3)
    ]


def sdk_of(name):
    return __import__(f"apex_edge.cameras.{name}", fromlist=["SDK"]).SDK


@pytest.mark.parametrize(
    "name, python, machine, words",
    [
        ("realsense", (3, 11), "x86_64", ["pip install 'pyrealsense2'"]),
        ("realsense", (3, 7), "armv7l", ["none for Python 3.7 on armv7l", "from source", "OAK-D"]),
        ("oak", (3, 7), "armv7l", ["pip install 'depthai>=2.24,<3'"]),
        ("oak", (3, 12), "riscv64", ["none for Python 3.12 on riscv64"]),
        ("orbbec", (3, 11), "aarch64", ["pip install 'pyorbbecsdk2>=2.0'"]),
        ("orbbec", (3, 7), "x86_64", ["none for Python 3.7 on x86_64", "64-bit"]),
        ("picamera2", (3, 11), "aarch64", ["apt-get install -y python3-picamera2"]),
        ("picamera2", (3, 7), "armv7l", ["none for Python 3.7", "live"]),
        ("picamera2", (3, 11), "x86_64", ["on a Raspberry Pi only"]),
    ],
)
def test_advice_fits_python_and_machine(name, python, machine, words):
    advice = how_to_install(sdk_of(name), python, machine)
    assert all(word in advice for word in words), advice


@pytest.mark.parametrize("name", ["realsense", "oak", "orbbec", "picamera2"])
def test_driver_that_is_not_installed_says_what_to_install(name, monkeypatch):
    sdk = sdk_of(name)
    monkeypatch.setitem(__import__("sys").modules, sdk.module, None)
    camera = plugins.load("cameras", name)(CameraConfig(type=name))
    with pytest.raises(CameraError, match=f"camera type '{name}'.*(install|there is none)"):
        camera.open()


def test_missing_shared_library_is_not_taken_for_a_missing_package(tmp_path, monkeypatch):
    (tmp_path / "half_there_sdk.py").write_text(
        "raise ImportError('libusb-1.0.so.0: cannot open shared object file')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    sdk = Sdk("half_there_sdk", "x", ("x86_64",), (3, 7), "", "install it with: apt libusb")
    with pytest.raises(CameraError, match="cannot start: libusb.*apt libusb"):
        load(sdk, "half")
