"""``apex bench hand-eye`` measures true errors and counts what became of spoilt files."""

import json

import numpy as np

from apex_edge.cli import main
from calib.pose_pairs import pairs_text
from offline_train.benchmarks import hand_eye


def test_more_poses_give_a_smaller_true_error_and_one_axis_is_always_refused(monkeypatch):
    few, many, one_axis = (
        hand_eye.simulated_row(name, 5) for name in ("5 poses", "25 poses", "15 poses, one axis")
    )
    assert many["error_mm"] < few["error_mm"]
    assert many["sd_mm"] < few["sd_mm"]
    assert one_axis["refuse"] == 5
    assert one_axis["error_mm"] is None


def test_bench_prints_both_tables_and_writes_its_figures(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(hand_eye, "SETUPS", {"10 poses": {"n": 10}})
    kinds = ("a cell is nan", "two rows swapped")
    monkeypatch.setattr(hand_eye, "SPOILS", {kind: hand_eye.SPOILS[kind] for kind in kinds})
    pairs, figures = tmp_path / "pairs.csv", tmp_path / "figures.json"
    pairs.write_text(pairs_text(hand_eye.simulate(16, np.random.RandomState(0))))
    words = ["--runs", "2", "--copies", "2", "--pairs", str(pairs), "--json", str(figures)]
    assert main(["bench", "hand-eye", *words]) == 0
    printed = capsys.readouterr().out
    assert "in all: 2 refused, 2 right, 0 wrong" in printed
    found = json.loads(figures.read_text())
    assert found["spoilt"]["two rows swapped"]["right"] == 2
    assert found["simulated"][0]["n_runs"] == 2


def test_a_wrong_result_fails_the_bench(monkeypatch, capsys):
    monkeypatch.setattr(hand_eye, "SETUPS", {})
    swapped = hand_eye.SPOILS["two rows swapped"]
    monkeypatch.setattr(hand_eye, "SPOILS", {"two rows swapped": swapped})
    monkeypatch.setattr(hand_eye, "RIGHT_MM", 0.0)
    assert main(["bench", "hand-eye", "--runs", "1", "--copies", "1"]) == 1
