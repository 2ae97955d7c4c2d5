"""The same shards from a dask cluster of two processes, also when one of them is killed."""

import socket

import pytest

from offline_train import jobs
from offline_train.benchmarks.trigger import toy_jobs
from offline_train.job_key import JobError

distributed = pytest.importorskip("distributed")


def test_a_killed_dask_worker_costs_no_shard(tmp_path):
    found = toy_jobs.kill_a_dask_worker(tmp_path, 3)
    assert (found.n_different, found.n_lost, found.n_torn) == (0, 0, 0), found.said
    assert found.exit_codes == (0,)


def test_poison_on_dask_is_listed_and_the_rest_finished(tmp_path):
    found = toy_jobs.run_poison_on_dask(tmp_path, 3)
    assert (found.n_different, found.n_lost, found.n_torn) == (0, 0, 0), found.said
    assert found.exit_codes == (1,)
    assert found.n_failed == 2


def test_a_cluster_without_workers_is_given_up(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "NO_WORKERS_S", 0.5)
    with distributed.LocalCluster(
        n_workers=0, host="127.0.0.1", dashboard_address="127.0.0.1:0", silence_logs=50
    ) as cluster, pytest.raises(JobError, match="no worker for"):
        address = cluster.scheduler_address
        jobs.run(toy_jobs.toy, toy_jobs.toy_items(2), tmp_path, 1, scheduler=address)


def test_a_scheduler_that_does_not_answer_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(jobs, "_CONNECT_S", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(JobError, match="no dask scheduler answers"):
            jobs.run(toy_jobs.toy, toy_jobs.toy_items(2), tmp_path, 1, scheduler=address)


def test_a_scheduler_that_goes_away_is_said_and_what_is_done_stays(tmp_path):
    stage = toy_jobs.Stage(tmp_path, 3)
    with toy_jobs.dask_cluster(stage.log) as address:
        driver = stage.start(1, "--scheduler", address)
        stage.wait(lambda: len(stage.whole()) >= 6)
    assert stage.end(driver) == 2
    assert stage.n_torn() == 0
    assert stage.run(1) == 0
    found = stage.found()
    assert (found.n_different, found.n_lost, found.n_again) == (0, 0, 0), found.said
    assert "JobError: --scheduler" in found.said
