"""A toy sweep one of whose workers dies in the middle of a trial; for the tests and the bench."""

import functools
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from offline_train.extras import module
from offline_train.sweep import Plan, sweep

N_TRIALS = 12
_AT_TRIAL = 4


@dataclass(frozen=True)
class FoundTrials:
    """What the sweep left: trials ``n_complete``, ``n_failed``, ``n_retried`` of those failed.

    ``n_lost`` workers that died, ``best_x`` the best setting, ``took_s`` seconds.
    """

    n_complete: int
    n_failed: int
    n_retried: int
    n_lost: int
    best_x: float
    took_s: float


def toy_objective(trial: Any, mark: str) -> float:
    """Score x by its distance from 1; the first that gets to trial 4 kills its process."""
    x = trial.suggest_float("x", -3.0, 3.0)
    time.sleep(0.05)
    if trial.number >= _AT_TRIAL and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return -float((x - 1.0) ** 2)


def kill_a_sweeper(scratch: Path, seed: int) -> FoundTrials:
    """Sweep with two workers, one of which is killed while it holds a trial."""
    began_s = time.monotonic()
    plan = Plan(f"sqlite:///{scratch / 'sweep.db'}", f"toy-{seed}", seed, heartbeat_s=1)
    objective = functools.partial(toy_objective, mark=str(scratch / "killed"))
    swept = sweep(objective, N_TRIALS, plan, n_jobs=2)
    optuna = module("optuna")
    trials = optuna.load_study(study_name=plan.name, storage=plan.storage).trials
    state = optuna.trial.TrialState
    complete = [trial.params["x"] for trial in trials if trial.state == state.COMPLETE]
    failed = [trial.params["x"] for trial in trials if trial.state == state.FAIL]
    return FoundTrials(
        n_complete=len(complete),
        n_failed=len(failed),
        n_retried=sum(x in complete for x in failed),
        n_lost=swept.n_lost,
        best_x=swept.best["x"],
        took_s=time.monotonic() - began_s,
    )
