"""Processes are really killed and files really cut; the shards must equal an undisturbed run."""

import pytest

from offline_train.benchmarks.trigger import toy_jobs

pytest.importorskip("joblib")


def assert_equal_to_one_process(found):
    assert (found.n_different, found.n_lost, found.n_torn) == (0, 0, 0), found.said


def test_a_killed_worker_costs_the_items_it_held_and_nothing_else(tmp_path):
    found = toy_jobs.kill_one_worker(tmp_path, 3)
    assert_equal_to_one_process(found)
    assert found.exit_codes == (0,)
    assert '"n_lost": 1' in found.said
    assert found.n_calls <= found.n_items + 2


def test_after_a_killed_driver_only_what_is_missing_is_computed(tmp_path):
    found = toy_jobs.kill_the_driver(tmp_path, 3)
    assert_equal_to_one_process(found)
    assert found.exit_codes == (-9, 0)
    assert found.n_again == 0
    assert found.n_calls <= found.n_items + 4


def test_damaged_shards_are_noticed_and_computed_again(tmp_path):
    found = toy_jobs.damage_shards(tmp_path, 3)
    assert_equal_to_one_process(found)
    assert found.n_calls == found.n_items + 2


def test_poison_is_tried_three_times_listed_and_skipped(tmp_path):
    found = toy_jobs.run_poison(tmp_path, 3)
    assert_equal_to_one_process(found)
    assert found.exit_codes == (1,)
    assert found.n_failed == 2
