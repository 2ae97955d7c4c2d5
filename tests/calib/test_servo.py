"""Servo calibration from protractor readings: what is found, warned about and refused."""

import json

import cv2
import numpy as np
import pytest
import tomli

from apex_edge import documents
from apex_edge.cli import main
from apex_edge.errors import CalibrationError
from calib.servo import ServoSamples, overall, read_samples, samples_text, solve
from calib.servo_file import toml_lines
from calib.verdict import PASS, REFUSE, WARN
from firmware_bridge.arm_file import ARMS
from firmware_bridge.calibration import compare_calibration
from firmware_bridge.kinematics import ArmModel

ZERO_US, US_PER_RAD = 1512.0, 630.0
NINE_DEG = np.linspace(-70, 70, 9)


def readings(
    backlash_deg=1.2,
    noise_deg=0.15,
    angles_deg=NINE_DEG,
    bend_deg=0.0,
    us_per_rad=US_PER_RAD,
    servo_id=6,
    ways=(True, False),
    seed=0,
):
    """A servo that lags behind by half its backlash in the direction it comes from."""
    rng = np.random.RandomState(seed)
    rows = []
    for is_up in ways:
        for angle in angles_deg:
            pulse = np.rint(ZERO_US + us_per_rad * np.radians(angle))
            true = np.degrees((pulse - ZERO_US) / us_per_rad)
            lag = (-0.5 if is_up else 0.5) * backlash_deg * np.sign(us_per_rad)
            curve = bend_deg * (true / 70.0) ** 2
            rows.append((pulse, true + lag + curve + noise_deg * rng.standard_normal(), is_up))
    pulse, angle, is_up = (np.array(column) for column in zip(*rows))
    n = len(rows)
    return ServoSamples(np.full(n, servo_id), pulse, angle, is_up, np.arange(1, n + 1))


def changed(samples, **values):
    fields = {name: getattr(samples, name).copy() for name in samples.__dataclass_fields__}
    for name, (row, value) in values.items():
        fields[name][row] = value
    return ServoSamples(**fields)


@pytest.mark.parametrize("us_per_rad", [US_PER_RAD, -US_PER_RAD])
def test_map_and_backlash_are_found_within_their_stated_sd(us_per_rad):
    fit = solve(readings(us_per_rad=us_per_rad))[0]
    assert fit.verdict == PASS
    assert abs(fit.zero_ticks - ZERO_US) < 4 * fit.sd_zero_ticks
    assert abs(fit.ticks_per_rad - us_per_rad) < 4 * fit.sd_ticks_per_rad
    assert abs(fit.backlash_deg - 1.2) < 4 * fit.sd_backlash_deg
    assert max(fit.residual_up_deg, fit.residual_down_deg) <= fit.left_out_deg < 0.5


def test_stated_sd_is_honest_over_many_servos():
    errors = []
    for seed in range(200):
        fit = solve(readings(seed=seed))[0]
        errors.append(
            [
                (fit.zero_ticks - ZERO_US) / fit.sd_zero_ticks,
                (fit.ticks_per_rad - US_PER_RAD) / fit.sd_ticks_per_rad,
                (fit.backlash_deg - 1.2) / fit.sd_backlash_deg,
            ]
        )
    assert np.all(np.abs(np.std(errors, axis=0) - 1.0) < 0.3)


def test_an_outlier_is_named_and_left_out():
    samples = readings()
    fit = solve(changed(samples, angle_deg=(4, samples.angle_deg[4] + 12.0)))[0]
    assert [row for row, _ in fit.rejected] == [5]
    assert "+1" in fit.rejected[0][1]
    assert abs(fit.zero_ticks - ZERO_US) < 3.0
    assert fit.verdict == PASS


def test_contradictory_readings_are_refused():
    samples = readings()
    wild = samples.angle_deg.copy()
    wild[::3] += 15.0
    fit = solve(changed(samples, angle_deg=(slice(None), wild)))[0]
    assert fit.verdict == REFUSE
    assert any("contradict the others" in reason for reason in fit.reasons)
    assert len(fit.rejected) == 6


def test_one_direction_only_is_warned_about_and_backlash_is_not_made_up():
    fit = solve(readings(ways=(True,), angles_deg=np.linspace(-70, 70, 12)))[0]
    assert fit.verdict == WARN
    assert np.isnan(fit.backlash_deg)
    assert fit.plain()["backlash_deg"] is None
    assert any("approached up only: the backlash is not known" in r for r in fit.reasons)


def test_a_curve_is_warned_about_with_its_size():
    assert not any("not on a line" in reason for reason in solve(readings())[0].reasons)
    fit = solve(readings(bend_deg=1.5))[0]
    assert fit.verdict == WARN
    assert any("not on a line" in reason for reason in fit.reasons)
    # a parabola over a line: between its middle and its ends
    assert 1.0 < abs(fit.bend_deg) < 2.0


@pytest.mark.parametrize(
    "samples, reason",
    [
        (readings(angles_deg=np.linspace(-70, 70, 2)), "4 readings (wanted at least 6)"),
        (readings(angles_deg=np.linspace(-5, 5, 9)), "readings span"),
        (readings(noise_deg=4.0, angles_deg=np.linspace(-70, 70, 20)), "residual"),
        (readings(backlash_deg=12.0), "backlash"),
    ],
)
def test_readings_that_cannot_tell_are_refused_with_the_figure(samples, reason):
    fit = solve(samples)[0]
    assert fit.verdict == REFUSE
    assert any(reason in each for each in fit.reasons)


def test_readings_in_no_order_are_refused_as_not_one_way():
    samples = readings()
    mixed = np.random.RandomState(2).permutation(samples.angle_deg)
    fit = solve(changed(samples, angle_deg=(slice(None), mixed)))[0]
    assert fit.verdict == REFUSE
    assert any("follows the ticks one way in only" in reason for reason in fit.reasons)


def test_every_reading_at_one_pulse_is_refused():
    samples = readings()
    fit = solve(changed(samples, ticks=(slice(None), 1500.0)))[0]
    assert fit.verdict == REFUSE


def test_servos_of_one_file_are_fitted_each_for_itself():
    both = [
        np.concatenate(columns)
        for columns in zip(
            *(
                [getattr(s, name) for name in s.__dataclass_fields__]
                for s in (readings(), readings(servo_id=3, us_per_rad=-600.0, seed=1))
            )
        )
    ]
    fits = solve(ServoSamples(*both))
    assert [fit.servo_id for fit in fits] == [3, 6]
    assert fits[0].ticks_per_rad == pytest.approx(-600.0, abs=5.0)
    assert overall(fits).grade == PASS


def test_lines_for_the_arm_file_make_an_arm_that_loads(tmp_path):
    arm = ArmModel.load()
    fits = solve(readings())
    new = tomli.loads("\n".join(toml_lines(fits, arm)))["joints"]["yaw"]
    # the shifted zero leaves one limit beyond 2500 us: a narrower one is given with it
    assert new["high_rad"] < arm.limits_rad[0, 1]
    text = (ARMS / "armpi-mini.toml").read_text()
    head, tail = text.split("[joints.yaw]")
    section, rest = tail.split("[joints.shoulder]")
    for key, value in new.items():
        lines = [line for line in section.splitlines() if not line.startswith(f"{key} =")]
        section = "\n".join([*lines, f"{key} = {value}", ""])
    path = tmp_path / "mine.toml"
    path.write_text(f"{head}[joints.yaw]\n{section}\n[joints.shoulder]{rest}")
    mine = ArmModel.load(path)
    assert mine.ticks_per_rad[0] == pytest.approx(US_PER_RAD, abs=3.0)


def test_file_survives_writing_and_reading(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text(samples_text(readings()))
    again = read_samples(path)
    assert np.allclose(again.angle_deg, readings().angle_deg, atol=1e-4)
    assert (again.is_up == readings().is_up).all()


@pytest.mark.parametrize(
    "row, reason",
    [
        ("6,1500,0,sideways", "direction must be up or down"),
        ("6,1500,nan,up", "angle_deg"),
        ("6,nan,0,up", "ticks"),
        ("6,15000,0,up", "outside"),
        ("six,1500,0,up", "expected servo_id"),
        ("6,1500,0", "3 columns, expected 4"),
    ],
)
def test_a_row_that_cannot_be_is_refused_with_its_number(tmp_path, row, reason):
    path = tmp_path / "s.csv"
    path.write_text(f"servo_id,ticks,angle_deg,direction\n6,1500,0,up\n{row}\n")
    with pytest.raises(CalibrationError, match=reason) as error:
        read_samples(path)
    assert "row 2" in str(error.value)


def test_a_header_alone_is_refused(tmp_path):
    path = tmp_path / "s.csv"
    path.write_text("servo_id,ticks,angle_deg,direction\n")
    with pytest.raises(CalibrationError, match="no sample"):
        read_samples(path)


def test_verb_writes_file_picture_and_the_lines_to_paste(tmp_path, capsys):
    samples, out = tmp_path / "s.csv", tmp_path / "servo.json"
    samples.write_text(samples_text(readings()))
    words = ["calibrate", "servo", "--samples", str(samples), "--out", str(out), "--json"]
    assert main(words) == 0
    told = json.loads(capsys.readouterr().out)
    document = documents.read(out, "apex-servo", 2, CalibrationError)
    assert told["verdict"] == PASS
    assert document["servos"][0]["joint"] == "yaw"
    assert "[joints.yaw]" in document["toml"]
    assert told["toml"].startswith(document["toml"])
    assert cv2.imread(told["picture"]) is not None


def test_the_lines_that_the_verb_prints_make_an_arm_that_agrees_with_its_calibration(
    tmp_path, capsys
):
    samples, out = tmp_path / "s.csv", tmp_path / 'my "own".json'
    samples.write_text(samples_text(readings()))
    assert main(["calibrate", "servo", "--samples", str(samples), "--out", str(out)]) == 0
    told = capsys.readouterr().out.split("data file:\n")[1].split("wrote ")[0]
    mine = tmp_path / "mine.toml"
    mine.write_text(f'like = "armpi-mini"\n{told}')
    troubles, notes = compare_calibration(ArmModel.load(mine))
    assert troubles == []
    assert len(notes) == 3  # joints that were not measured
    mine.write_text(mine.read_text().replace("offset_ticks = 0.0", "offset_ticks = -1.0"))
    assert "yaw (id 6) has zero_ticks" in compare_calibration(ArmModel.load(mine))[0][0]


def test_verb_refuses_and_writes_nothing(tmp_path, capsys):
    samples = tmp_path / "s.csv"
    samples.write_text(samples_text(readings(angles_deg=np.linspace(-5, 5, 9))))
    out = str(tmp_path / "servo.json")
    assert main(["calibrate", "servo", "--samples", str(samples), "--out", out, "--json"]) == 2
    captured = capsys.readouterr()
    assert json.loads(captured.out)["verdict"] == REFUSE
    assert "span" in captured.err
    assert [each.name for each in tmp_path.iterdir()] == ["s.csv"]
