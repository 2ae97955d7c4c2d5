"""Sweep over settings with Optuna: worker processes that may die, a data base that may not.

Each round the trials still wanted are shared out among the workers. A trial that dies with its
worker stops sending its heartbeat, is marked as failed and put into the queue again with the same
settings. With one worker the same seed tries the same settings; with several the order in which
they finish steers the sampler. Source: ours.
"""

import multiprocessing
import time
import warnings
from dataclasses import dataclass
from typing import Any, Callable, Dict, List

import numpy as np

from offline_train.extras import module
from offline_train.job_key import JobError
from offline_train.jobs import MAX_IDLE_ROUNDS

Objective = Callable[[Any], float]

HEARTBEAT_S = 5
_BUSY_S = 60.0
"""How long a worker waits for another's write to an SQLite file."""


@dataclass(frozen=True)
class Swept:
    """Outcome: ``n_complete`` trials, ``n_lost`` workers that died, the ``best`` settings."""

    n_complete: int
    n_lost: int
    best_value: float
    best: Dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """What a worker needs to know; ``name`` of the study in the data base ``storage`` (a URL)."""

    storage: str
    name: str
    seed: int
    heartbeat_s: int = HEARTBEAT_S


def sweep(objective: Objective, n_trials: int, plan: Plan, n_jobs: int = 1) -> Swept:
    """Maximise ``objective(trial)`` until ``n_trials`` are complete, earlier runs included.

    ``objective`` is a function of a module, or a ``functools.partial`` of one.

    Raises
    ------
    JobError : the data base cannot be used, or round after round completes nothing.
    MissingExtraError : Optuna is not installed.
    """
    if n_trials < 1 or n_jobs < 1 or plan.seed < 0:
        raise JobError(f"{n_trials} trials, {n_jobs} jobs, seed {plan.seed}: too small a number")
    study = _open(plan)
    n_idle = n_lost = 0
    n_complete = _n_complete(study)
    while n_complete < n_trials:
        if n_idle == MAX_IDLE_ROUNDS:
            raise JobError(
                f"{plan.name}: {n_idle} rounds completed no trial ({n_complete} of {n_trials}); "
                "what stopped the workers is above"
            )
        n_dead = _round(objective, plan, _shares(n_trials - n_complete, n_jobs), n_complete)
        if n_dead:
            # not before its heartbeat is overdue does a trial count as dead
            time.sleep(2 * plan.heartbeat_s + 1)
            _fail_stale(study)
        n_before, n_complete = n_complete, _n_complete(study)
        n_lost += n_dead
        n_idle = 0 if n_complete > n_before else n_idle + 1
    return Swept(n_complete, n_lost, float(study.best_value), dict(study.best_params))


def _shares(n_trials: int, n_jobs: int) -> List[int]:
    """Return how many trials each worker takes, none of them 0."""
    shares = [n_trials // n_jobs + (worker < n_trials % n_jobs) for worker in range(n_jobs)]
    return [share for share in shares if share]


def _round(objective: Objective, plan: Plan, shares: List[int], n_complete: int) -> int:
    """Let each worker do its share; return how many did not come to their end."""
    context = multiprocessing.get_context("spawn")
    workers = []
    for number, share in enumerate(shares):
        sequence = np.random.SeedSequence(plan.seed, spawn_key=(n_complete, number))
        sampler_seed = int(sequence.generate_state(1)[0])
        arguments = (objective, plan, share, sampler_seed)
        workers.append(context.Process(target=_work, args=arguments))
    try:
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
    finally:
        for worker in workers:
            if worker.is_alive():
                worker.terminate()
    return sum(worker.exitcode != 0 for worker in workers)


def _work(objective: Objective, plan: Plan, n_trials: int, sampler_seed: int) -> None:
    """Do some trials; the body of a worker process."""
    optuna = module("optuna")
    sampler = optuna.samplers.TPESampler(seed=sampler_seed)
    _open(plan, sampler).optimize(objective, n_trials=n_trials)


def _open(plan: Plan, sampler: Any = None) -> Any:
    """Return the study, made if it is not there.

    Raises
    ------
    JobError : the data base cannot be used.
    """
    optuna = module("optuna")
    sql_error = module("sqlalchemy.exc").SQLAlchemyError
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    # the heartbeat has been "experimental" since 2021
    warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
    is_file = plan.storage.startswith("sqlite")
    try:
        storage = optuna.storages.RDBStorage(
            plan.storage,
            engine_kwargs={"connect_args": {"timeout": _BUSY_S}} if is_file else None,
            heartbeat_interval=plan.heartbeat_s,
            heartbeat_stale_trial_callback=optuna.storages.RetryHeartbeatStaleTrialCallback(),
        )
        return optuna.create_study(
            storage=storage,
            study_name=plan.name,
            direction="maximize",
            sampler=sampler,
            load_if_exists=True,
        )
    except (sql_error, optuna.exceptions.StorageInternalError, ImportError) as error:
        # no more than the end of the URL: what stands before it may hold a password
        where = plan.storage.rpartition("@")[2]
        raise JobError(f"{where}: cannot use this data base: {error}") from error


def _fail_stale(study: Any) -> None:
    module("optuna").storages.fail_stale_trials(study)


def _n_complete(study: Any) -> int:
    state = module("optuna").trial.TrialState.COMPLETE
    return len(study.get_trials(deepcopy=False, states=(state,)))
