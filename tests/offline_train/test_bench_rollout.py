"""``apex bench rollout``: figures come from really running, and a difference is found out."""

import argparse
import dataclasses
import json

import numpy as np
import pytest

from apex_edge.errors import InputError
from apex_edge.simulate.candidates import candidate_grid
from apex_edge.simulate.kernel import KernelSim
from apex_edge.simulate.problem import NEVER
from firmware_bridge.kinematics import ArmModel
from offline_train.benchmarks import rollout


@pytest.fixture(scope="module")
def arm():
    return ArmModel.load()


@pytest.fixture(scope="module")
def grid(arm):
    return candidate_grid(arm, 300)


def options(*words):
    parser = argparse.ArgumentParser()
    rollout.add_arguments(parser)
    return parser.parse_args([str(w) for w in words])


class KernelThatMissesOne(KernelSim):
    """A kernel with a fault: the last of its blockers never blocks."""

    def outcomes(self, problem, tip_xy_m, arrival_s):
        found = super().outcomes(problem, tip_xy_m, arrival_s)
        blocked = found.blocked_step.copy()
        hit = np.flatnonzero(blocked != NEVER)
        blocked[hit[-1:]] = NEVER
        return dataclasses.replace(found, blocked_step=blocked)


class KernelThatIsOffByAHair(KernelSim):
    """A kernel with a fault: every final distance is 1 um too long."""

    def outcomes(self, problem, tip_xy_m, arrival_s):
        found = super().outcomes(problem, tip_xy_m, arrival_s)
        return dataclasses.replace(found, final_distance_m=found.final_distance_m + 1e-6)


def test_the_report_holds_times_of_all_forms_and_full_agreement(tmp_path, capsys):
    file = tmp_path / "rollout.json"
    assert rollout.run(options("--json", file, "--scenes", 8, "--seed", 3)) == 0
    report = json.loads(file.read_text())
    assert report["n_candidates"] == 1412
    assert report["agreement"]["n_scenes"] == 8
    assert report["agreement"]["n_rollouts"] == 8 * 1412
    assert report["agreement"]["n_different_flags"] == 0
    assert set(report["cpu_ms"]) == set(report["times_the_kernel"])
    assert all(ms > 0.0 for ms in report["cpu_ms"].values())
    # hundreds of times in truth; no machine is so strange that the plain loop wins
    assert report["times_the_kernel"]["plain loop, dt 0.01"] > 5.0
    assert "0 flags and 0 distances differ" in capsys.readouterr().out


def test_all_kinds_of_outcome_occur_in_the_comparison(grid):
    found = rollout.compare(grid, seed=1, n_scenes=60)
    assert found.is_full
    assert min(found.n_collided, found.n_blocked, found.n_safe) > 100


def test_the_same_seed_compares_on_the_same_scenes(grid):
    assert rollout.compare(grid, 5, 4) == rollout.compare(grid, 5, 4)
    assert rollout.compare(grid, 5, 4) != rollout.compare(grid, 6, 4)


@pytest.mark.parametrize("faulty", [KernelThatMissesOne, KernelThatIsOffByAHair])
def test_a_back_end_that_differs_is_found_out(grid, monkeypatch, faulty):
    monkeypatch.setattr(rollout, "KernelSim", faulty)
    found = rollout.compare(grid, seed=1, n_scenes=12)
    assert not found.is_full


def test_a_difference_gives_exit_code_1_and_is_in_the_report(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(rollout, "KernelSim", KernelThatMissesOne)
    monkeypatch.setattr(rollout, "cpu_time_ms", lambda call: 1.0)
    file = tmp_path / "rollout.json"
    assert rollout.run(options("--json", file, "--scenes", 8)) == 1
    assert json.loads(file.read_text())["agreement"]["is_full"] is False
    assert "OTHER FLAGS" in capsys.readouterr().out


def test_the_plain_loop_finds_what_the_kernel_finds(arm, grid):
    problem = rollout.head_on(arm)
    arrival_s = rollout.from_home_s(arm, grid)
    found = KernelSim().outcomes(problem, grid.tip_m[:, :2], arrival_s)
    by_loop = rollout.plain_loop(problem, grid.tip_m[:, :2], arrival_s)
    assert [c for c, _, _ in by_loop] == (found.collision_step != NEVER).tolist()
    assert [b for _, b, _ in by_loop] == (found.blocked_step != NEVER).tolist()
    np.testing.assert_allclose([d for _, _, d in by_loop], found.final_distance_m, atol=1e-9)
    assert any(b for _, b, _ in by_loop)


def test_cpu_time_grows_with_the_work():
    short = rollout.cpu_time_ms(lambda: sum(range(2000)))
    long = rollout.cpu_time_ms(lambda: sum(range(200000)))
    assert long > 5.0 * short > 0.0


def test_a_missing_folder_is_refused_before_anything_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(rollout, "measure", None)  # would fail if it were called
    with pytest.raises(InputError, match="does not exist"):
        rollout.run(options("--json", tmp_path / "nowhere" / "x.json"))
    assert list(tmp_path.iterdir()) == []


def test_no_scenes_at_all_are_refused():
    with pytest.raises(InputError, match="at least 1"):
        rollout.run(options("--scenes", 0))
