"""Travel calibration from recorded steps: what is found, warned about and refused."""

import json
import math

import cv2
import numpy as np
import pytest
import tomli

from apex_edge import documents
from apex_edge.cli import main
from apex_edge.errors import CalibrationError
from calib.travel import gather, overall, read_samples, record, samples_text, solve
from calib.travel_file import toml_lines
from calib.verdict import PASS, REFUSE
from firmware_bridge.kinematics import ArmModel

DEAD_S, RATE, TAU, ACCEL = 0.035, 3.4, 0.04, 30.0
TURNS_DEG = (30, -45, 70, -90, 60, -25)


def servo_way(turn_rad, times_s, kind):
    """Integrate a servo in steps of 0.1 ms: rate limit, then a lag or a limit of acceleration."""
    dt, target = 1e-4, abs(turn_rad)
    position = speed = ramp = 0.0
    grid, ways = np.arange(-0.05, times_s[-1] + dt, dt), []
    for t in grid:
        if t >= DEAD_S:
            if kind == "lag":
                ramp = min(ramp + RATE * dt, target)
                position += (ramp - position) * dt / TAU
            else:
                brake = math.sqrt(2.0 * ACCEL * max(target - position, 0.0))
                speed = min(speed + ACCEL * dt, RATE, brake)
                position = min(position + speed * dt, target)
        ways.append(position)
    return np.sign(turn_rad) * np.interp(times_s, grid, ways)


def recorded(
    kind="lag", noise_deg=0.1, every_s=0.015, turns_deg=TURNS_DEG, watch_s=1.2, servo_id=6
):
    rng = np.random.RandomState(5)
    steps, at = [], 0.2
    for turn in np.radians(turns_deg):
        t_s = np.arange(-0.03, watch_s, every_s) + 0.3 * every_s * rng.uniform(size=1)
        angle = at + servo_way(turn, t_s, kind)
        noise = np.radians(noise_deg) * rng.standard_normal(len(t_s))
        steps.append((servo_id, np.column_stack([t_s, angle + noise])))
        at += turn
    return gather(steps)


def test_rate_lag_and_dead_time_of_a_lagging_servo_are_found():
    fit = solve(recorded("lag"))[0]
    assert (fit.verdict, fit.kind) == (PASS, "lag")
    assert fit.rate_rad_s == pytest.approx(RATE, rel=0.01)
    assert fit.time_constant_s == pytest.approx(TAU, abs=0.003)
    assert fit.dead_s == pytest.approx(DEAD_S, abs=0.003)
    assert abs(fit.rate_rad_s - RATE) < 5 * fit.sd_rate_rad_s
    assert math.isnan(fit.accel_rad_s2)


def test_rate_acceleration_and_dead_time_of_a_trapezoid_are_found():
    fit = solve(recorded("trapezoid"))[0]
    assert (fit.verdict, fit.kind) == (PASS, "trapezoid")
    assert fit.rate_rad_s == pytest.approx(RATE, rel=0.01)
    assert fit.accel_rad_s2 == pytest.approx(ACCEL, rel=0.05)
    assert fit.dead_s == pytest.approx(DEAD_S, abs=0.003)


@pytest.mark.parametrize("kind", ["lag", "trapezoid"])
def test_the_arm_file_tells_when_a_turn_that_was_not_recorded_arrives(tmp_path, kind):
    new = tomli.loads("\n".join(toml_lines(solve(recorded(kind)), ArmModel.load())))
    path = tmp_path / "mine.toml"
    joint = new["joints"]["yaw"]
    path.write_text(
        f'like = "armpi-mini"\nlag_s = {new["lag_s"]}\n[joints.yaw]\n'
        f"rate_rad_s = {joint['rate_rad_s']}\naccel_rad_s2 = {joint['accel_rad_s2']}\n"
    )
    arm = ArmModel.load(path)
    for turn in np.radians([50.0, 110.0]):
        told_s = arm.travel_time_s(np.zeros(4), np.array([[turn, 0, 0, 0]]))[0] + arm.lag_s
        t_s = np.arange(0.0, 2.0, 1e-3)
        is_off = np.abs(servo_way(turn, t_s, kind) - turn) > np.radians(1.0)
        arrived_s = t_s[np.flatnonzero(is_off)[-1] + 1]
        # never promised early by more than a hundredth, and at most 50 ms on the safe side
        assert -0.01 < told_s - arrived_s < 0.05


@pytest.mark.parametrize(
    "samples, reason",
    [
        (recorded(turns_deg=(40,)), "1 steps from rest to rest (wanted at least 2)"),
        (recorded(turns_deg=(5, -5, 5, -5)), "the largest step turns"),
        (recorded(every_s=0.1), "s apart"),
        (recorded(watch_s=0.3), "still moves"),
        (recorded(noise_deg=4.0), "residual|still moves"),
    ],
)
def test_steps_that_cannot_tell_are_refused_with_the_figure(samples, reason):
    fit = solve(samples)[0]
    assert fit.verdict == REFUSE
    assert any(part in each for each in fit.reasons for part in reason.split("|"))


def test_steps_that_begin_in_motion_are_left_out_and_said():
    samples = recorded()
    late = (samples.step == 2) & (samples.t_s <= 0.02)
    kept = type(samples)(*(getattr(samples, n)[~late] for n in samples.__dataclass_fields__))
    fit = solve(kept)[0]
    assert fit.n_steps == len(TURNS_DEG) - 1
    assert any("without rest before and after" in each for each in fit.reasons)
    assert fit.rate_rad_s == pytest.approx(RATE, rel=0.01)


def test_a_clock_that_runs_ahead_of_the_command_is_told():
    samples = recorded()
    early = type(samples)(samples.servo_id, samples.step, samples.t_s - 0.06, samples.angle_deg)
    assert any("before the command" in each for each in solve(early)[0].reasons)


def test_servos_of_one_file_are_fitted_each_for_itself():
    both = [
        np.concatenate([getattr(s, name) for s in (recorded(), recorded("trapezoid", servo_id=3))])
        for name in recorded().__dataclass_fields__
    ]
    fits = solve(type(recorded())(*both))
    assert [(each.servo_id, each.kind) for each in fits] == [(3, "trapezoid"), (6, "lag")]
    assert overall(fits).grade == PASS


def test_a_live_arm_is_watched_from_the_command_on():
    now = {"t": 10.0, "sent": math.inf}

    def clock():
        return now["t"]

    def move():
        now["t"] += 0.002
        now["sent"] = now["t"]

    def read():
        now["t"] += 0.01
        since = now["t"] - 0.005 - now["sent"]
        return math.nan if 0.3 < since < 0.33 else float(np.clip(2.0 * since, 0.0, 1.0))

    samples = record(move, read, clock, 0.8)
    assert samples[0].tolist() == [0.0, 0.0]
    assert np.isfinite(samples).all()
    rising = (samples[:, 1] > 0) & (samples[:, 1] < 1)
    assert np.allclose(samples[rising, 1], 2.0 * samples[rising, 0], atol=1e-9)


def test_file_survives_writing_and_reading(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(samples_text(recorded()))
    again = read_samples(path)
    assert np.allclose(again.angle_deg, recorded().angle_deg, atol=1e-4)
    assert (again.step == recorded().step).all()


@pytest.mark.parametrize(
    "row, reason",
    [
        ("6.5,0,0.1,3", "whole numbers"),
        ("300,0,0.1,3", "ids 1..253"),
        ("6,0,nan,3", "not a finite number"),
        ("6,0,9000,3", "allowed are -60..600 s"),
        ("6,0,0.1", "3 columns, expected 4"),
    ],
)
def test_a_row_that_cannot_be_is_refused_with_its_number(tmp_path, row, reason):
    path = tmp_path / "s.csv"
    path.write_text(f"servo_id,step,t_s,angle_deg\n6,0,0.0,0\n{row}\n")
    with pytest.raises(CalibrationError, match=reason) as error:
        read_samples(path)
    assert "row 2" in str(error.value)


def test_verb_writes_file_picture_and_the_lines_to_paste(tmp_path, capsys):
    samples, out = tmp_path / "s.csv", tmp_path / "travel.json"
    samples.write_text(samples_text(recorded()))
    words = ["calibrate", "travel", "--samples", str(samples), "--out", str(out), "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    document = documents.read(out, "apex-travel", 1, CalibrationError)
    assert told["verdict"] == PASS
    assert document["servos"][0]["joint"] == "yaw"
    assert "[joints.yaw]" in document["toml"] == told["toml"]
    assert cv2.imread(told["picture"]) is not None


def test_verb_refuses_and_writes_nothing(tmp_path, capsys):
    samples = tmp_path / "s.csv"
    samples.write_text(samples_text(recorded(turns_deg=(5, -5))))
    out = str(tmp_path / "travel.json")
    assert main(["calibrate", "travel", "--samples", str(samples), "--out", out, "--json"]) == 2
    assert json.loads(capsys.readouterr().out)["verdict"] == REFUSE
    assert [each.name for each in tmp_path.iterdir()] == ["s.csv"]
