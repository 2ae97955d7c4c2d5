"""Sweeps survive their workers."""

import argparse
import json

import pytest

from apex_edge.errors import ConfigError
from offline_train import sweep
from offline_train.benchmarks.trigger import toy_sweep
from offline_train.job_key import JobError
from offline_train.verbs import sweep as verb

optuna = pytest.importorskip("optuna")


def failing(trial):
    raise ValueError("never")


def test_a_killed_worker_loses_no_trial(tmp_path):
    found = toy_sweep.kill_a_sweeper(tmp_path, 3)
    assert found.n_complete == toy_sweep.N_TRIALS
    assert (found.n_lost, found.n_failed, found.n_retried) == (1, 1, 1)


def test_the_trials_are_shared_out_whole():
    assert sweep._shares(7, 3) == [3, 2, 2]
    assert sweep._shares(2, 3) == [1, 1]


def test_a_sweep_that_never_completes_a_trial_ends(tmp_path, monkeypatch):
    monkeypatch.setattr(sweep, "MAX_IDLE_ROUNDS", 1)
    monkeypatch.setattr(sweep.time, "sleep", lambda seconds: None)
    plan = sweep.Plan(f"sqlite:///{tmp_path / 'x.db'}", "failing", 1)
    with pytest.raises(JobError, match="completed no trial"):
        sweep.sweep(failing, 2, plan)


def test_a_data_base_that_cannot_be_used_is_named(tmp_path):
    plan = sweep.Plan(f"sqlite:///{tmp_path}/no/folder/x.db", "toy", 1)
    with pytest.raises(JobError, match="cannot use this data base"):
        sweep.sweep(failing, 2, plan)


def options(*arguments):
    parser = argparse.ArgumentParser()
    verb.add_arguments(parser)
    return parser.parse_args(list(map(str, arguments)))


def test_the_verb_writes_the_best_settings_and_goes_on_where_it_was(tmp_path):
    out = tmp_path / "sweep.json"
    common = ("--seed", 1, "--scenes", 150, "--out", out)
    assert verb.run(options("--trials", 1, *common)) == 0
    first = json.loads(out.read_text())
    assert verb.run(options("--trials", 2, *common)) == 0
    report = json.loads(out.read_text())
    assert (first["n_complete"], report["n_complete"]) == (1, 2)
    assert set(report["best"]) == {"strength", "limit_sd"}
    assert 0.0 < first["pr_auc"] <= report["pr_auc"] <= 1.0


def test_the_verb_refuses_senseless_options(tmp_path):
    with pytest.raises(ConfigError, match="--scenes 0"):
        verb.run(options("--seed", 1, "--scenes", 0, "--out", tmp_path / "x.json"))
    with pytest.raises(ConfigError, match="does not exist"):
        verb.run(options("--seed", 1, "--out", tmp_path / "no" / "x.json"))
