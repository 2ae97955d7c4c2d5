"""Camera latency from a blinking or a moving target, on series and cameras of known delay."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from apex_edge import documents
from apex_edge.cameras.base import Camera
from apex_edge.cameras.twin import TwinCamera, TwinConfig
from apex_edge.cli import main
from apex_edge.errors import CalibrationError
from apex_edge.twin.scenarios import make
from apex_edge.twin.world import TwinWorld
from apex_edge.types import Frame
from calib import blink
from calib.latency import read_series, solve
from calib.verdict import PASS, REFUSE, WARN
from firmware_bridge.kinematics import ArmModel


def blinking(latency_s, seed=0, period_s=None, drop=0.05, exposure_s=0.012, seconds=20.0):
    """A light seen at 30 Hz with jitter, lost frames, exposure, drift and mains flicker."""
    rng = np.random.RandomState(seed)
    steps = rng.uniform(0.3, 0.8, 200) if period_s is None else np.full(2000, 0.5 * period_s)
    t_s = np.cumsum(steps)
    t_s = t_s[t_s < seconds]
    values = np.arange(len(t_s)) % 2 * 1.0
    shot_s = np.sort(
        np.arange(0.0, seconds, 1 / 30) + 0.002 * rng.standard_normal(int(seconds * 30))
    )
    shot_s = shot_s[rng.uniform(size=len(shot_s)) > drop]
    parts = shot_s[:, None] + np.linspace(-0.5, 0.5, 21) * exposure_s
    at = np.searchsorted(t_s, parts, side="right") - 1
    light = np.where(at >= 0, values[np.clip(at, 0, None)], 0.0).mean(axis=1)
    grey = 50 + 100 * light + 3 * rng.standard_normal(len(shot_s))
    grey += 10 * np.sin(0.5 * shot_s) + 3 * np.sin(2 * np.pi * 3.3 * shot_s)
    return (t_s, values), (shot_s + latency_s, grey)


def swinging(latency_s, hz, seed=0):
    rng = np.random.RandomState(seed)
    t_s = np.arange(0.0, 20.0, 0.02)
    shot_s = np.sort(np.arange(0.0, 20.0, 1 / 30) + 0.002 * rng.standard_normal(600))
    seen = 320 - 90 * np.sin(2 * np.pi * hz * shot_s) + 0.5 * rng.standard_normal(600)
    return (t_s, 0.5 * np.sin(2 * np.pi * hz * t_s)), (shot_s + latency_s, seen)


@pytest.mark.parametrize("latency_s", [0.0, 0.013, 0.043, 0.12, 0.4])
def test_a_blinking_light_gives_the_delay_within_a_millisecond(latency_s):
    result = solve(*blinking(latency_s))
    assert result.verdict.grade == PASS
    assert abs(result.latency_s - latency_s) < 0.001
    assert result.sd_s < 0.001
    assert result.rival < 0.7 * result.explained


@pytest.mark.parametrize("latency_s", [0.02, 0.08])
def test_a_swinging_target_gives_the_delay_whatever_side_it_moves_to(latency_s):
    result = solve(*swinging(latency_s, 0.5))
    assert result.verdict.grade == PASS
    assert abs(result.latency_s - latency_s) < 0.001


def test_stated_sd_is_honest_over_many_recordings():
    found = [solve(*blinking(0.05, seed, seconds=15.0)) for seed in range(12)]
    errors = np.array([each.latency_s - 0.05 for each in found])
    assert 0.4 < np.std(errors) / np.median([each.sd_s for each in found]) < 2.5


def test_many_lost_frames_only_make_it_less_certain():
    few, many = solve(*blinking(0.05, drop=0.0)), solve(*blinking(0.05, drop=0.6))
    assert abs(many.latency_s - 0.05) < 0.004
    assert many.sd_s > few.sd_s
    assert many.n_frames < 0.5 * few.n_frames


@pytest.mark.parametrize("period_s", [0.15, 0.3])
def test_a_signal_that_repeats_too_soon_is_refused_as_ambiguous(period_s):
    result = solve(*blinking(0.04, period_s=period_s))
    assert result.verdict.grade == REFUSE
    assert any("ambiguous" in reason for reason in result.verdict.reasons)


def test_a_fast_swing_is_ambiguous_and_less_so_when_less_delay_is_looked_for():
    assert solve(*swinging(0.06, 2.0)).verdict.grade == REFUSE
    assert solve(*swinging(0.06, 2.0), max_latency_s=0.15).verdict.grade != REFUSE


def test_frames_that_do_not_follow_the_signal_are_refused():
    signal, (stamps, grey) = blinking(0.04)
    noise = np.random.RandomState(1).standard_normal(len(grey))
    result = solve(signal, (stamps, noise))
    assert result.verdict.grade == REFUSE
    assert any("explains only" in reason for reason in result.verdict.reasons)
    still = solve(signal, (stamps, np.full(len(grey), 7.0)))
    assert still.verdict.grade == REFUSE
    assert "no change at all" in still.verdict.reasons[0]
    assert still.figures()["latency_s"] is None


def test_a_delay_beyond_what_is_looked_for_is_not_given():
    assert solve(*blinking(0.7)).verdict.grade == REFUSE


def test_two_clocks_are_noticed():
    signal, (stamps, grey) = blinking(0.0)
    result = solve(signal, (stamps - 0.06, grey))
    assert result.verdict.grade == REFUSE
    assert any("two clocks" in reason for reason in result.verdict.reasons)
    apart = solve(signal, (stamps + 1e6, grey))
    assert "0 of" in apart.verdict.reasons[0]


def test_too_few_frames_or_changes_are_refused_with_their_number():
    signal, (stamps, grey) = blinking(0.04)
    few = solve(signal, (stamps[20:40], grey[20:40]))
    assert few.verdict.grade == REFUSE
    assert "20 of 20 frames" in few.verdict.reasons[0]
    rare = solve((signal[0][:3], signal[1][:3]), (stamps, grey))
    assert rare.verdict.grade == REFUSE
    assert "2 changes" in " ".join(rare.verdict.reasons)


def test_a_short_recording_is_warned_about():
    result = solve(*blinking(0.04, seconds=6.0))
    assert result.verdict.grade == WARN


@pytest.mark.parametrize(
    "times, values, reason",
    [
        ([0.0, 1.0, 0.5], [0, 1, 0], "goes backwards"),
        ([0.0, 1.0, np.nan], [0, 1, 0], "must be finite"),
        ([0.0, 1.0], [0, 1, 0], "two equal rows"),
        ([0.0, 0.0], [0, 1], "lasts 0 s"),
        ([0.0, 5000.0], [0, 1], "in seconds"),
    ],
)
def test_series_that_cannot_be_are_refused(times, values, reason):
    good, _ = blinking(0.0)
    with pytest.raises(CalibrationError, match=reason):
        solve((np.array(times), np.array(values)), good)
    with pytest.raises(CalibrationError, match=reason):
        solve(good, (np.array(times), np.array(values)))


def test_delay_of_the_twins_camera_is_found_from_its_swinging_arm():
    arm = ArmModel.load()
    told = []

    def swing(world, dt_s):
        yaw = 0.6 * np.sin(2 * np.pi * 0.7 * world.t_s)
        world.set_arm(arm.forward(np.array([[yaw, 1.3, 1.2, -0.9]]))[0])
        told.append((world.t_s, yaw))

    config = TwinConfig(width_px=160, height_px=120, focal_px=140.0, delay_s=0.03, drop_rate=0.05)
    world = TwinWorld(replace(make("no-moving", 1), duration_s=9.0))
    delivered_s, seen = [], []
    with TwinCamera(config, world, on_step=swing) as camera:
        frame = camera.read(1.0)
        while frame is not None:
            seen.append(cv2.cvtColor(frame.colour_bgr, cv2.COLOR_BGR2GRAY).astype(np.float64))
            delivered_s.append(camera.now_s())
            frame = camera.read(1.0)
    moved = np.abs(np.array(seen) - np.median(seen, axis=0))
    moved[moved < 25.0] = 0.0
    place = (moved.sum(axis=1) @ np.arange(160)) / np.maximum(moved.sum(axis=(1, 2)), 1.0)
    signal = np.array(told).T
    result = solve((signal[0], signal[1]), (np.array(delivered_s), place), max_latency_s=0.3)
    assert not result.verdict.is_refused
    assert abs(result.latency_s - config.delay_s) < max(0.004, 3 * result.sd_s)
    assert result.sd_s < 0.01


class ScreenCamera(Camera):
    """Looks at what a blinker shows, on a simulated clock, and stamps late."""

    type = "screen"

    def __init__(self, late_s):
        super().__init__()
        self.t_s, self._late_s, self._seq = 0.0, late_s, 0
        self._shown = [(-1.0, False)]
        self._rng = np.random.RandomState(0)

    def now_s(self):
        return self.t_s

    def sleep(self, seconds):
        self.t_s += seconds

    def show(self, is_white):
        self._shown.append((self.t_s, is_white))

    def open(self):
        pass

    def close(self):
        pass

    def read(self, timeout_s):
        self._seq += 1
        shot_s = self._seq / 30.0
        self.t_s = max(self.t_s, shot_s + self._late_s)
        is_white = [white for t_s, white in self._shown if t_s <= shot_s][-1]
        picture = self._rng.normal(60.0, 3.0, (120, 160, 3))
        picture[30:80, 40:100] += 120.0 * is_white
        picture = np.clip(picture, 0, 255).astype(np.uint8)
        return Frame(self._seq, shot_s + self._late_s, picture, None, None, False)


def test_a_blinking_screen_that_fills_part_of_the_picture_gives_the_delay():
    camera = ScreenCamera(0.07)
    rng = np.random.RandomState(3)
    with camera:
        both = blink.watch(camera, camera.show, rng, camera.now_s, camera.sleep, 20.0)
    result = solve(*both)
    assert result.verdict.grade == PASS
    assert abs(result.latency_s - 0.07) < 0.004


def test_pictures_that_end_too_soon_are_told():
    camera = ScreenCamera(0.07)
    camera.read = lambda timeout_s: None
    with pytest.raises(CalibrationError, match="ended before"):
        blink.watch(camera, camera.show, np.random.RandomState(0), camera.now_s, camera.sleep, 20.0)


def write(path, series):
    path.write_text("t_s,value\n" + "".join(f"{t!r},{v!r}\n" for t, v in zip(*map(list, series))))
    return str(path)


def test_verb_writes_file_picture_and_the_line_for_the_settings(tmp_path, capsys):
    signal, response = blinking(0.043)
    events = write(tmp_path / "e.csv", (signal[0].tolist(), signal[1].tolist()))
    frames = write(tmp_path / "f.csv", (response[0].tolist(), response[1].tolist()))
    out = tmp_path / "latency.json"
    words = ["calibrate", "latency", "--events", events, "--frames", frames, "--out", str(out)]
    assert main(words) == 0
    assert "latency_s = 0.04" in capsys.readouterr().out
    assert main([*words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    document = documents.read(out, "apex-latency", 1, CalibrationError)
    assert abs(document["latency_s"] - 0.043) < 0.001
    assert told["verdict"] == document["made"]["verdict"] == PASS
    assert cv2.imread(told["picture"]) is not None


def test_verb_refuses_a_clock_that_goes_backwards_and_names_the_row(tmp_path, capsys):
    signal, response = blinking(0.043)
    stamps = response[0].tolist()
    stamps[10] = stamps[5]
    events = write(tmp_path / "e.csv", (signal[0].tolist(), signal[1].tolist()))
    frames = write(tmp_path / "f.csv", (stamps, response[1].tolist()))
    with pytest.raises(CalibrationError, match="row 11"):
        read_series(tmp_path / "f.csv")
    out = str(tmp_path / "latency.json")
    words = ["calibrate", "latency", "--events", events, "--frames", frames, "--out", out]
    assert main([*words, "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["verdict"] == REFUSE
    assert sorted(each.name for each in tmp_path.iterdir()) == ["e.csv", "f.csv"]


def test_verb_needs_both_series_or_a_camera(tmp_path, capsys):
    assert main(["calibrate", "latency", "--events", "e.csv", "--out", "o.json"]) == 2
    assert "--events and --frames or a camera" in capsys.readouterr().err
