"""The pacer: steady, joined on leaving, and honest about a task that failed."""

import threading

import pytest

from apex_edge.rate import Pacer


def test_the_task_runs_until_the_context_is_left() -> None:
    enough = threading.Event()
    calls = []

    def task() -> None:
        calls.append(threading.current_thread())
        if len(calls) == 5:
            enough.set()

    with Pacer(task, 0.002):
        assert enough.wait(10.0)
    n_after = len(calls)
    assert calls[0] is not threading.current_thread()
    assert not calls[0].is_alive()
    assert len(calls) == n_after


def test_a_task_that_fails_is_reported_on_leaving() -> None:
    failed = threading.Event()

    def task() -> None:
        failed.set()
        raise ValueError("boom")

    with pytest.raises(ValueError, match="boom"), Pacer(task, 0.001):
        assert failed.wait(10.0)


def test_an_error_under_way_is_not_replaced_by_the_tasks_own() -> None:
    failed = threading.Event()

    def task() -> None:
        failed.set()
        raise ValueError("boom")

    with pytest.raises(KeyError), Pacer(task, 0.001):
        assert failed.wait(10.0)
        raise KeyError("first")


def test_missed_turns_are_skipped_not_made_up() -> None:
    now = [0.0]
    n_calls = [0]
    done = threading.Event()

    def task() -> None:
        n_calls[0] += 1
        now[0] += 10.0 if n_calls[0] == 1 else 0.0
        if n_calls[0] == 2:
            done.set()

    def clock() -> float:
        now[0] += 0.01
        return now[0]

    pacer = Pacer(task, 0.1, clock)
    with pacer:
        assert done.wait(10.0)
    assert pacer.n_late == 1
