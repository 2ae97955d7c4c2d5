"""The twin as a camera: time, stamps, drops and repeats."""

import threading
import time

import numpy as np
import pytest

from apex_edge import plugins
from apex_edge.cameras.twin import STEP_S, TwinCamera, TwinConfig
from apex_edge.config import structure
from apex_edge.errors import CameraError, ConfigError
from apex_edge.twin.scenarios import make
from apex_edge.twin.scene import Scenario, SceneObject
from apex_edge.twin.sensor import SensorConfig
from apex_edge.twin.world import TwinWorld

SMALL = {"width_px": 160, "height_px": 120, "focal_px": 140.0}


def rolling_world(duration_s=3.0):
    ball = SceneObject("green ball", "green", "ball", 0.015, (0.2, -0.2), (0.0, 0.1))
    return TwinWorld(Scenario("many", 1, (ball,), (), duration_s, "", "green ball", False))


def all_frames(camera):
    with camera:
        return list(iter(lambda: camera.read(1.0), None))


def test_frames_come_at_the_set_rate_until_the_scene_ends():
    config = TwinConfig(fps=20.0, jitter_s=0.0, drop_rate=0.0, repeat_rate=0.0, **SMALL)
    camera = TwinCamera(config, rolling_world())
    frames = all_frames(camera)
    assert [frame.t_s for frame in frames] == pytest.approx([k / 20.0 for k in range(61)])
    assert [frame.seq for frame in frames] == list(range(61))
    assert camera.stats.grabbed == camera.stats.delivered == 61
    assert camera.read(1.0) is None


def test_capture_instants_jitter_but_never_run_backwards():
    config = TwinConfig(jitter_s=0.01, drop_rate=0.0, repeat_rate=0.0, **SMALL)
    times = np.array([frame.t_s for frame in all_frames(TwinCamera(config, rolling_world()))])
    late = times - np.arange(len(times)) / 30.0
    assert late.std() > 0.004
    assert np.diff(times).min() > 0.0
    assert abs(late).max() <= 0.4 / 30.0 + 1e-9


def test_stamp_is_the_worlds_time_at_capture():
    world = rolling_world()
    camera = TwinCamera(TwinConfig(delay_s=0.0, **SMALL), world)
    for _ in range(20):
        frame = camera.advance()
        assert frame.t_s == world.t_s


def test_a_frame_is_handed_out_when_its_delay_has_passed():
    world = rolling_world()
    camera = TwinCamera(TwinConfig(delay_s=0.02, jitter_s=0.0, **SMALL), world)
    for _ in range(20):
        frame = camera.advance()
        assert world.t_s - frame.t_s == pytest.approx(0.02, abs=1e-9)


def test_drops_leave_gaps_and_repeats_show_the_frame_before():
    config = TwinConfig(drop_rate=0.2, repeat_rate=0.2, **SMALL)
    camera = TwinCamera(config, rolling_world(6.0))
    frames = all_frames(camera)
    stats = camera.stats
    assert stats.delivered == len(frames)
    assert stats.grabbed == stats.delivered + stats.dropped
    # 6 s at 30 Hz; jitter may push the last capture past the end of the scene.
    assert stats.grabbed in (180, 181)
    assert 0.1 < stats.dropped / stats.grabbed < 0.3
    assert stats.repeated == sum(frame.is_repeated for frame in frames)
    assert 0.1 < stats.repeated / stats.grabbed < 0.3
    gaps = np.diff([frame.seq for frame in frames])
    assert (gaps > 1).any()
    for older, newer in zip(frames, frames[1:]):
        is_same = np.array_equal(older.colour_bgr, newer.colour_bgr)
        assert is_same == newer.is_repeated


def test_same_seeds_give_the_same_frames_byte_for_byte():
    runs = []
    for seed in (4, 4, 5):
        camera = TwinCamera(TwinConfig(seed=seed, **SMALL), rolling_world(1.0))
        runs.append(
            [(f.t_s, f.colour_bgr.tobytes(), f.depth_mm.tobytes()) for f in all_frames(camera)]
        )
    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_hook_is_called_in_small_steps_up_to_each_capture():
    calls = []
    camera = TwinCamera(
        TwinConfig(delay_s=0.0, **SMALL),
        rolling_world(),
        on_step=lambda world, dt: calls.append((world.t_s, dt)),
    )
    frame = camera.advance()
    assert frame.t_s == 0.0
    assert not calls
    while frame.t_s < 1.0:
        frame = camera.advance()
    assert max(dt for _, dt in calls) <= STEP_S
    assert sum(dt for _, dt in calls) == pytest.approx(frame.t_s)
    assert [t for t, _ in calls] == sorted(t for t, _ in calls)


def test_arm_set_by_the_hook_is_in_the_world_and_in_the_picture():
    points = np.array([(0, 0, 0.09), (0.05, 0, 0.1), (0.12, 0, 0.09), (0.18, 0.0, 0.005)])
    config = TwinConfig(drop_rate=0.0, repeat_rate=0.0, **SMALL)
    scenario = make("collision", 3)
    bare = TwinCamera(config, TwinWorld(scenario))
    armed = TwinCamera(config, TwinWorld(scenario), on_step=lambda world, dt: world.set_arm(points))
    pairs = [(bare.advance(), armed.advance()) for _ in range(2)]
    assert np.array_equal(pairs[0][0].colour_bgr, pairs[0][1].colour_bgr)
    assert not np.array_equal(pairs[1][0].colour_bgr, pairs[1][1].colour_bgr)


def test_frame_carries_its_calibration_and_depth():
    frame = TwinCamera(TwinConfig(), rolling_world()).advance()
    assert frame.colour_bgr.shape == (480, 640, 3)
    assert frame.colour_bgr.dtype == np.uint8
    assert frame.depth_mm.shape == (480, 640)
    assert frame.depth_mm.dtype == np.uint16
    assert frame.camera.fx_px == 560.0


class FastClock:
    """Real seconds, run faster, so that the test is short."""

    def __init__(self, rate):
        self.rate = rate

    def __call__(self):
        return time.monotonic() * self.rate


def test_real_time_twin_follows_the_clock_to_the_end_of_the_scene():
    main = threading.get_ident()
    threads = set()
    config = TwinConfig(drop_rate=0.0, repeat_rate=0.0, fps=10.0, **SMALL)
    camera = TwinCamera(
        config,
        rolling_world(2.0),
        on_step=lambda world, dt: threads.add(threading.get_ident()),
        clock=FastClock(4.0),
    )
    assert camera.is_real_time
    frames = []
    with camera:
        while True:
            frame = camera.read(10.0)
            if frame is None:
                break
            assert frame.t_s <= camera.now_s() + 1e-6
            frames.append(frame)
    times = [frame.t_s for frame in frames]
    assert times == sorted(times)
    assert len(times) >= 2
    assert 1.9 <= camera.world.t_s <= 2.1
    assert camera.stats.grabbed == camera.stats.delivered + camera.stats.dropped
    assert camera.stats.delivered == len(frames)
    assert main not in threads
    assert len(threads) == 1


def test_real_time_twin_can_be_closed_early_and_twice_but_not_reopened():
    camera = TwinCamera(TwinConfig(**SMALL), rolling_world(60.0), clock=time.monotonic)
    camera.open()
    assert camera.read(10.0) is not None
    camera.close()
    camera.close()
    assert camera.world.t_s < 60.0
    with pytest.raises(CameraError, match="make a new one"):
        camera.open()


def test_error_in_the_hook_reaches_the_reader():
    def fail(world, dt):
        raise RuntimeError("servo lost")

    camera = TwinCamera(TwinConfig(**SMALL), rolling_world(), on_step=fail, clock=FastClock(4.0))
    with camera, pytest.raises(RuntimeError, match="servo lost"):
        while camera.read(10.0) is not None:
            pass


def test_stalled_clock_is_a_camera_error():
    camera = TwinCamera(TwinConfig(**SMALL), rolling_world(), clock=lambda: 0.0)
    with camera:
        camera.read(10.0)  # the frame at time zero
        with pytest.raises(CameraError, match="no frame for 0.05 s"):
            camera.read(0.05)


def test_real_time_twin_refuses_to_be_stepped_by_hand():
    camera = TwinCamera(TwinConfig(**SMALL), rolling_world(), clock=time.monotonic)
    with pytest.raises(CameraError, match="steps itself"):
        camera.advance()
    with pytest.raises(CameraError, match="is it open"):
        camera.read(0.01)


def test_settings_are_strict():
    built = structure(TwinConfig, {"fps": 15.0, "sensor": {"gain": 1.2}}, "apex.toml [twin]")
    assert built == TwinConfig(fps=15.0, sensor=SensorConfig(gain=1.2))
    with pytest.raises(ConfigError, match="drop_rate = 1.5 is outside"):
        structure(TwinConfig, {"drop_rate": 1.5}, "apex.toml [twin]")
    with pytest.raises(ConfigError, match="did you mean 'jitter_s'"):
        structure(TwinConfig, {"jiter_s": 0.0}, "apex.toml [twin]")


def test_twin_is_registered_as_a_camera():
    assert plugins.load("cameras", "twin") is TwinCamera
