"""A full disk, two drivers in one folder, and Ctrl-C."""

import pytest

from offline_train.benchmarks.trigger import toy_jobs

pytest.importorskip("joblib")


def test_a_full_disk_is_said_and_leaves_nothing_half_written(tmp_path):
    found = toy_jobs.fill_the_disk(tmp_path, 3)
    assert (found.n_different, found.n_lost, found.n_torn) == (0, 0, 0), found.said
    assert found.exit_codes == (2, 0)
    assert "JobError" in found.said and "cannot write" in found.said


def test_two_drivers_at_once_tear_no_file(tmp_path):
    found = toy_jobs.race_two_drivers(tmp_path, 3)
    assert (found.n_different, found.n_lost, found.n_torn) == (0, 0, 0), found.said
    assert found.exit_codes == (0, 0)


def test_ctrl_c_leaves_whole_files_and_the_next_run_goes_on(tmp_path):
    found = toy_jobs.interrupt_the_driver(tmp_path, 3)
    assert (found.n_different, found.n_lost, found.n_torn, found.n_again) == (0, 0, 0, 0), (
        found.said
    )
    assert found.exit_codes == (-2, 0)
