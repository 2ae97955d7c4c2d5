"""Accidents of a run over many items: what is left must equal an undisturbed single process.

Processes are really killed, files really cut. A toy task stands for the work. Source: ours.
"""

import tempfile
from pathlib import Path
from typing import Callable, List, Sequence, Tuple

from offline_train.benchmarks.lines import Line, at_least, at_most, note
from offline_train.benchmarks.trigger import toy_jobs, toy_sweep
from offline_train.benchmarks.trigger.toy_jobs import Found

_SUITE = "scale"
_ACCIDENTS: Sequence[Tuple[str, Callable[[Path, int], Found], Sequence[int]]] = (
    ("one of two workers killed", toy_jobs.kill_one_worker, (0,)),
    ("driver killed, run again", toy_jobs.kill_the_driver, (-9, 0)),
    ("two shards damaged, run again", toy_jobs.damage_shards, (0, 0)),
    ("items that raise and kill", toy_jobs.run_poison, (1,)),
    ("disk full, run again", toy_jobs.fill_the_disk, (2, 0)),
    ("two drivers at once", toy_jobs.race_two_drivers, (0, 0)),
    ("dask, one of two workers killed", toy_jobs.kill_a_dask_worker, (0,)),
)
"""What happens, how, and the exit codes the drivers owe."""


def measure(seed: int) -> List[Line]:
    """Let each accident happen once and compare what it leaves.

    Raises
    ------
    MissingExtraError : joblib, dask or Optuna is not installed.
    """
    lines: List[Line] = []
    for what, happen, codes in _ACCIDENTS:
        with tempfile.TemporaryDirectory() as scratch:
            found = happen(Path(scratch), seed)
        lines += _lines(what, found, codes)
    with tempfile.TemporaryDirectory() as scratch:
        swept = toy_sweep.kill_a_sweeper(Path(scratch), seed)
    return [
        *lines,
        at_least(_SUITE, "sweep, worker killed: complete", swept.n_complete, toy_sweep.N_TRIALS),
        at_most(_SUITE, "sweep, worker killed: trials lost", swept.n_failed - swept.n_retried, 0),
        note(_SUITE, "sweep, worker killed: s", swept.took_s),
    ]


def _lines(what: str, found: Found, codes: Sequence[int]) -> List[Line]:
    n_wrong = sum(a != b for a, b in zip(found.exit_codes, codes))
    return [
        at_most(_SUITE, f"{what}: shards that differ", found.n_different, 0),
        at_most(_SUITE, f"{what}: shards lost", found.n_lost, 0),
        at_most(_SUITE, f"{what}: files torn or left over", found.n_torn, 0),
        at_most(_SUITE, f"{what}: wrong exit codes", n_wrong, 0),
        note(_SUITE, f"{what}: items listed as failed", found.n_failed),
        note(_SUITE, f"{what}: calls for {found.n_items} items", found.n_calls),
        note(_SUITE, f"{what}: s", found.took_s),
    ]
