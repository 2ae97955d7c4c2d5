"""Shards, seeds and the driver's loop, in this process or in two workers of joblib."""

import hashlib
import json
import os
from pathlib import Path

import numpy as np
import pytest

from offline_train import extras, jobs, shards
from offline_train.benchmarks.trigger import toy_jobs
from offline_train.extras import MissingExtraError
from offline_train.job_key import JobError, JobKey, generator, job_key
from offline_train.jobs import Outcome
from offline_train.trigger import seeds

pytest.importorskip("threadpoolctl")
KEY = JobKey("module.task", (1,), 3, "0" * 64)


def double(item, rng):
    return {"twice": np.array([2.0 * item]), "draw": rng.normal(size=3)}


def fussy(item, rng):
    if item == "object":
        return {"x": np.array([{}], dtype=object)}
    if item == "list":
        return [1.0]
    if item == "exit":
        raise SystemExit(3)
    return {"x": np.zeros(2)}


def interrupted(item, rng):
    if item == 2:
        raise KeyboardInterrupt
    return {"x": np.array(item)}


def moody(item, rng):
    if Path(item).exists():
        raise ValueError("not today")
    return {"x": np.zeros(1)}


def threads(item, rng):
    import threadpoolctl

    np.ones((4, 4)) @ np.ones((4, 4))
    found = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
    return {"n": np.array(found), "omp": np.array(int(os.environ["OMP_NUM_THREADS"]))}


def needy(item, rng):
    extras.module("no_such_package")
    return {}


def run(task, items, folder, seed=1, **options):
    return jobs.run(task, items, folder, seed, is_quiet=True, **options)


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_each_item_ends_in_one_shard_that_reads_back(tmp_path):
    summary = run(double, [1.0, 2.0, 5.0], tmp_path)
    assert (summary.n_items, summary.n_kept, summary.n_done) == (3, 0, 3)
    assert summary.exit_code == 0
    found = list(shards.read(tmp_path))
    assert [part["twice"][0] for part in found] == [2.0, 4.0, 10.0]
    assert np.array_equal(found[1]["draw"], generator((1,), 1).normal(size=3))
    assert sorted(content(tmp_path)) == ["0000.npz", "0001.npz", "0002.npz", "manifest.json"]


def test_one_process_and_two_give_the_same_bytes(tmp_path):
    pytest.importorskip("joblib")
    items = toy_jobs.toy_items(6)
    run(toy_jobs.toy, items, tmp_path / "one")
    run(toy_jobs.toy, items, tmp_path / "two", n_jobs=2)
    assert content(tmp_path / "one") == content(tmp_path / "two")


def test_another_seed_gives_other_draws_and_no_item_shares_one():
    draws = {
        (seed, index): generator((seed,), index).random() for seed in range(3) for index in range(3)
    }
    assert len(set(draws.values())) == 9
    # numpy pads seeds with zeros: these would be equal if the index were one more number
    assert generator((0,), 7).random() != seeds.rng("train", 7).random()


def test_a_finished_job_computes_nothing_again(tmp_path):
    run(double, [1.0, 2.0], tmp_path)
    before = content(tmp_path)
    summary = run(double, [1.0, 2.0], tmp_path)
    assert (summary.n_kept, summary.n_done) == (2, 0)
    assert content(tmp_path) == before


def test_shards_prove_themselves_without_a_manifest(tmp_path):
    run(double, [1.0, 2.0], tmp_path)
    before = content(tmp_path)
    (tmp_path / shards.MANIFEST).unlink()
    assert run(double, [1.0, 2.0], tmp_path).n_kept == 2
    assert content(tmp_path) == before


def test_a_whole_shard_that_is_not_the_manifests_is_computed_again(tmp_path):
    run(double, [1.0, 2.0], tmp_path)
    before = content(tmp_path)
    key = job_key(double, [1.0, 2.0], 1)
    forged = shards.encode({"twice": np.zeros(1)}, key.sha256, 1)
    (tmp_path / "0001.npz").write_bytes(forged)
    with pytest.raises(JobError, match="0001.npz: not what manifest.json says"):
        list(shards.read(tmp_path))
    assert run(double, [1.0, 2.0], tmp_path).n_done == 1
    assert content(tmp_path) == before


@pytest.mark.parametrize(
    ("task", "items", "seed", "what"),
    [
        (double, [1.0, 2.0], 2, "seed"),
        (double, [1.0, 3.0], 1, "items_sha256"),
        (fussy, [1.0, 2.0], 1, "task"),
    ],
)
def test_the_folder_of_another_job_is_refused_and_left_as_it_was(tmp_path, task, items, seed, what):
    run(double, [1.0, 2.0], tmp_path)
    before = content(tmp_path)
    with pytest.raises(JobError, match=f"another job \\(other {what}\\)"):
        run(task, items, tmp_path, seed)
    assert content(tmp_path) == before


def test_shards_of_another_job_are_refused_without_a_manifest_too(tmp_path):
    run(double, [1.0, 2.0], tmp_path)
    (tmp_path / shards.MANIFEST).unlink()
    before = content(tmp_path)
    with pytest.raises(JobError, match="not of this job"):
        run(double, [1.0, 2.0], tmp_path, seed=2)
    assert content(tmp_path) == before


def test_a_job_that_takes_the_folder_meanwhile_is_noticed(tmp_path):
    run(double, [1.0], tmp_path)
    with pytest.raises(JobError, match="another job was started"):
        shards.write_manifest(tmp_path, shards.Manifest(KEY.fields()))


def test_an_unreadable_manifest_is_named(tmp_path):
    run(double, [1.0], tmp_path)
    (tmp_path / shards.MANIFEST).write_text("{")
    with pytest.raises(JobError, match="manifest.json: not a manifest"):
        run(double, [1.0], tmp_path)


@pytest.mark.parametrize("kind", ["object", "list", "exit"])
def test_what_is_no_dict_of_plain_arrays_is_listed_and_skipped(tmp_path, kind):
    summary = run(fussy, ["good", kind, "good"], tmp_path)
    assert (summary.failed, summary.exit_code) == ((1,), 1)
    (entry,) = json.loads((tmp_path / shards.FAILED).read_text())
    assert (entry["index"], entry["n_tries"]) == (1, jobs.MAX_TRIES)
    assert entry["seed"] == {"entropy": [1], "spawn_key": [1]}
    with pytest.raises(JobError, match="0001.npz: missing"):
        list(shards.read(tmp_path))
    assert len(list(shards.read(tmp_path, is_partial_ok=True))) == 2


def test_an_item_that_works_at_last_is_no_longer_listed(tmp_path):
    mood, out = tmp_path / "mood", tmp_path / "out"
    mood.touch()
    assert run(moody, [str(mood)], out).exit_code == 1
    assert "not today" in (out / shards.FAILED).read_text()
    mood.unlink()
    assert run(moody, [str(mood)], out).exit_code == 0
    assert not (out / shards.FAILED).exists()


def test_ctrl_c_leaves_whole_files_and_their_manifest(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run(interrupted, [0, 1, 2, 3], tmp_path)
    assert sorted(content(tmp_path)) == ["0000.npz", "0001.npz", "manifest.json"]
    assert set(shards.read_manifest(tmp_path).shards) == {"0000.npz", "0001.npz"}


def test_a_task_computes_on_one_thread_and_the_setting_is_put_back(tmp_path):
    before = os.environ.get("OMP_NUM_THREADS")
    run(threads, [0], tmp_path)
    (found,) = shards.read(tmp_path)
    assert set(found["n"].tolist()) == {1} and found["omp"] == 1
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_a_missing_package_ends_the_run_and_is_no_items_fault(tmp_path, monkeypatch):
    monkeypatch.setitem(extras.EXTRA_OF, "no_such_package", "graph")
    with pytest.raises(MissingExtraError, match=r"apex-edge\[graph\]"):
        run(needy, [1, 2], tmp_path)
    assert not (tmp_path / shards.FAILED).exists()


def test_shards_that_cannot_be_seen_from_here_end_in_an_error(tmp_path):
    driver = jobs._Driver(jobs.Job(double, KEY, str(tmp_path)), [1.0, 2.0, 3.0])
    rounds = []

    def elsewhere(job, items, indices):
        rounds.append(list(indices))
        return (Outcome(index, sha256="f" * 64) for index in indices)

    with pytest.raises(JobError, match="5 rounds finished nothing"):
        driver.finish(elsewhere, lambda: None)
    assert rounds == [[0, 1, 2]] * jobs.MAX_IDLE_ROUNDS


def test_who_dies_beside_a_killer_is_not_blamed(tmp_path):
    job = jobs.Job(double, KEY, str(tmp_path))
    driver = jobs._Driver(job, [1.0, 2.0, 3.0])
    alone = []

    def engine(job, items, indices):
        if len(indices) > 1:
            yield from (Outcome(index, n_lost=1) for index in indices)
            return
        alone.extend(indices)
        (index,) = indices
        yield Outcome(index, n_lost=1) if index == 1 else jobs.compute(job, index, items[index])

    driver.finish(engine, lambda: None)
    assert driver.failed() == [1]
    assert alone == [0, 1, 1, 1, 2]
    assert sorted(driver.done) == ["0000.npz", "0002.npz"]


def test_parts_of_dead_writers_go_and_those_being_written_stay(tmp_path):
    stale = tmp_path / ".0003.npz.abc.part"
    stale.write_bytes(b"half")
    live = tmp_path / ".0004.npz.def.part"
    with shards._locked(live):
        shards.sweep_parts(tmp_path)
        assert live.exists() and not stale.exists()
    shards.sweep_parts(tmp_path)
    assert not live.exists()


@pytest.mark.parametrize("where", ["a file", "/proc/nowhere/job"])
def test_a_folder_that_cannot_be_is_named(tmp_path, where):
    folder = where if where.startswith("/") else tmp_path / where
    if folder != where:
        folder.write_text("not a folder")
    with pytest.raises(JobError, match="cannot make this folder"):
        run(double, [1.0], folder)


def test_a_damaged_shard_is_never_taken_for_whole(tmp_path):
    path = tmp_path / "0002.npz"
    data = shards.encode({"a": np.arange(5.0)}, KEY.sha256, 2)
    path.write_bytes(data)
    sha256 = hashlib.sha256(data).hexdigest()
    assert shards.sealed_sha256(path, KEY.sha256, 2) == sha256
    assert shards.sealed_sha256(path, KEY.sha256, 1) is None
    assert shards.sealed_sha256(path, "1" * 64, 2) is None
    for at in range(0, len(data), 7):
        damaged = bytearray(data)
        damaged[at] ^= 1
        path.write_bytes(bytes(damaged))
        assert shards.sealed_sha256(path, KEY.sha256, 2) is None
        path.write_bytes(data[:at])
        assert shards.sealed_sha256(path, KEY.sha256, 2) is None


def test_the_order_of_names_does_not_change_the_bytes():
    one, two = np.arange(3), np.ones((2, 2))
    assert shards.encode({"a": one, "b": two}, "0", 0) == shards.encode(
        {"b": two, "a": one}, "0", 0
    )


@pytest.mark.parametrize(
    ("task", "items", "seed"),
    [
        (lambda item, rng: {}, [1], 1),
        (toy_jobs.Stage.run, [1], 1),
        (double, [object()], 1),
        (double, [1], -1),
        (double, [1], ()),
    ],
)
def test_what_cannot_name_a_job_is_refused(tmp_path, task, items, seed):
    with pytest.raises(JobError):
        run(task, items, tmp_path / "job", seed)
    assert not (tmp_path / "job").exists()


def test_a_job_knows_its_items_by_value():
    outcome = Outcome(1, "a")
    for one, other in [
        (np.arange(3), np.arange(4)),
        (np.float64(1), np.float64(2)),
        (outcome, Outcome(2, "a")),
    ]:
        key = job_key(double, [one], 1)
        assert key == job_key(double, [one], 1)
        assert key != job_key(double, [other], 1)


def test_no_processes_are_refused(tmp_path):
    with pytest.raises(JobError, match="n_jobs 0"):
        run(double, [1.0], tmp_path, n_jobs=0)
