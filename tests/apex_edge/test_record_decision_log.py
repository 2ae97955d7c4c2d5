import json
import math
from dataclasses import replace

import numpy as np
import pytest
import record_steps

from apex_edge.errors import RecordingError
from apex_edge.record.decision_log import DecisionLog, to_json_line
from apex_edge.record.tracks_csv import TracksCsv


def write_log(path, steps):
    with DecisionLog(path) as log:
        for step in steps:
            log.write(step)
    return path.read_bytes()


def test_equal_runs_give_equal_bytes(tmp_path):
    camera = record_steps.camera_model()
    first = write_log(tmp_path / "a.jsonl", record_steps.run(40, camera))
    second = write_log(tmp_path / "b.jsonl", record_steps.run(40, camera))
    assert first == second
    assert first.count(b"\n") == 40


def test_wall_times_never_enter_the_log():
    step = record_steps.step(25)
    later = replace(
        step,
        timing_s={"perceive": 9.0},
        ack=replace(step.ack, t_sent_s=99.0),
        proposal=replace(step.proposal, latency_s=7.0),
    )
    assert to_json_line(later) == to_json_line(step)


def test_another_decision_is_another_line():
    step = record_steps.step(25)
    other = replace(step, decision=replace(step.decision, index=step.decision.index + 1))
    assert to_json_line(other) != to_json_line(step)


def test_last_bits_of_a_number_do_not_show():
    step = record_steps.step(25, record_steps.camera_model())
    tracks = step.tracks
    wobbled = replace(step, tracks=replace(tracks, pos_m=tracks.pos_m * (1.0 + 1e-15)))
    assert to_json_line(wobbled) == to_json_line(step)
    negative_zero = replace(step, tracks=replace(tracks, vel_m_s=tracks.vel_m_s * -0.0))
    zero = replace(step, tracks=replace(tracks, vel_m_s=tracks.vel_m_s * 0.0))
    assert to_json_line(negative_zero) == to_json_line(zero)


def test_line_is_strict_json_and_says_what_was_decided():
    step = record_steps.step(25, record_steps.camera_model())

    def refuse(constant):
        raise AssertionError(constant)

    entry = json.loads(to_json_line(step), parse_constant=refuse)
    assert entry["decision"]["action"] == "intervene"
    assert entry["decision"]["target_m"] == pytest.approx(step.decision.target_m)
    assert entry["rollouts"]["n"] == len(step.rollouts.is_safe)
    assert entry["rollouts"]["n_safe"] == int(step.rollouts.is_safe.sum())
    assert entry["rollouts"]["best"] == step.rollouts.best.tolist()
    assert entry["hazards"][0]["ttc_s"] == pytest.approx(float(step.hazards.ttc_s[0]))
    assert [track["name"] for track in entry["tracks"]] == ["green", "red"]
    assert entry["command"]["duration_s"] == [0.6]


def test_unknown_numbers_are_null():
    entry = json.loads(to_json_line(record_steps.step(0)))
    assert math.isinf(record_steps.step(0).decision.ttc_s)
    assert entry["decision"]["ttc_s"] is None
    assert entry["tracks"][0]["pos_m"] == [None, None, None]


def test_most_urgent_edges_come_first_whatever_their_order():
    step = record_steps.step(25)
    n = 8
    rng = np.random.RandomState(3)
    probability = rng.rand(n)
    is_fired = probability > 0.6
    fields = {
        "mover_id": np.arange(n),
        "target_id": np.arange(n) + 10,
        "probability": probability,
        "is_fired": is_fired,
        "is_fallback": np.zeros(n, dtype=bool),
    }
    for name in ("dca_m", "tca_s", "ttc_s", "ttc_early_s", "sigma_m"):
        fields[name] = rng.rand(n)
    hazards = replace(step.hazards, **fields)
    turned = replace(hazards, **{name: values[::-1] for name, values in fields.items()})
    line = to_json_line(replace(step, hazards=hazards))
    assert line == to_json_line(replace(step, hazards=turned))
    edges = json.loads(line)["hazards"]
    assert len(edges) == 5
    assert [e["mover"] for e in edges] == np.argsort(-probability)[:5].tolist()


def test_log_appears_only_when_whole(tmp_path):
    path = tmp_path / "d.jsonl"
    log = DecisionLog(path)
    log.write(record_steps.step(0))
    assert not path.exists()
    log.close()
    assert path.exists()
    assert [p.name for p in tmp_path.iterdir()] == ["d.jsonl"]


def test_failed_run_leaves_no_half_log_and_the_old_one_untouched(tmp_path):
    path = tmp_path / "d.jsonl"
    path.write_text("old\n")
    with pytest.raises(ZeroDivisionError), DecisionLog(path) as log:
        log.write(record_steps.step(0))
        raise ZeroDivisionError
    assert path.read_text() == "old\n"
    assert [p.name for p in tmp_path.iterdir()] == ["d.jsonl"]


def test_interrupted_run_keeps_what_was_decided(tmp_path):
    path = tmp_path / "d.jsonl"
    with pytest.raises(KeyboardInterrupt), DecisionLog(path) as log:
        log.write(record_steps.step(0))
        raise KeyboardInterrupt
    assert path.read_text().count("\n") == 1


def test_missing_folder_is_refused_by_name(tmp_path):
    with pytest.raises(RecordingError, match="gone"):
        DecisionLog(tmp_path / "gone" / "d.jsonl")


def test_tracks_table_has_pixels_and_where_calibrated_metres(tmp_path):
    step = record_steps.step(3, record_steps.camera_model())
    for is_calibrated in (False, True):
        with TracksCsv(tmp_path / "t.csv", is_calibrated) as table:
            table.write(step)
        lines = (tmp_path / "t.csv").read_text().splitlines()
        head = "frame,t_s,name,track_id,x_px,y_px,area_px2,status"
        if is_calibrated:
            head += ",x_m,y_m,z_m,vx_m_s,vy_m_s,vz_m_s"
            head += ",x_sd_m,y_sd_m,z_sd_m,vx_sd_m_s,vy_sd_m_s,vz_sd_m_s"
        assert lines[0] == head
        row = dict(zip(lines[0].split(","), lines[1].split(",")))
        assert len(lines) == 3
        assert (row["frame"], row["name"], row["track_id"], row["status"]) == (
            "3",
            "green",
            "1",
            "seen",
        )
        assert float(row["x_px"]) == pytest.approx(step.tracks.centre_px[0, 0], abs=1e-3)
        if is_calibrated:
            assert float(row["x_m"]) == pytest.approx(step.tracks.pos_m[0, 0], abs=1e-6)
            assert float(row["vy_m_s"]) == pytest.approx(-0.06)
            assert float(row["x_sd_m"]) == pytest.approx(1e-3)


def test_lost_track_has_empty_cells_instead_of_numbers(tmp_path):
    step = record_steps.step(3)
    lost = replace(
        step.tracks,
        status=np.array([2, 1]),
        centre_px=np.full((2, 2), np.nan),
        area_px2=np.full(2, np.nan),
    )
    with TracksCsv(tmp_path / "t.csv", is_calibrated=False) as table:
        table.write(replace(step, tracks=lost))
    rows = [line.split(",") for line in (tmp_path / "t.csv").read_text().splitlines()[1:]]
    assert rows[0][4:] == ["", "", "", "lost"]
    assert rows[1][4:] == ["", "", "", "predicted"]


def test_name_with_a_comma_stays_one_cell(tmp_path):
    import csv

    step = record_steps.step(3)
    named = replace(step, tracks=replace(step.tracks, name=('a,"b"', "red")))
    with TracksCsv(tmp_path / "t.csv", is_calibrated=False) as table:
        table.write(named)
    with (tmp_path / "t.csv").open(newline="") as file:
        assert [row["name"] for row in csv.DictReader(file)] == ['a,"b"', "red"]
