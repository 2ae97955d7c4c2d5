"""Run one task over many items: the only file that knows joblib and dask.

Item i draws from a generator of the root seed and i, never of the worker, and ends in one sealed
shard, so the result is the same for one process, several, or a cluster. What is there and whole is
not computed again; a worker that dies costs the items it held; an item that fails or kills its
worker three times is listed in ``failed.json`` and skipped. Bytes are equal on machines with the
same processor features and libraries: BLAS picks its kernels by the processor. Source: ours.
"""

import hashlib
import json
import os
import time
import traceback
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import (
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from apex_edge.errors import ApexError
from apex_edge.verbs.progress import Progress
from offline_train import shards
from offline_train.extras import MissingExtraError, module
from offline_train.job_key import JobError, JobKey, Task, generator, job_key

MAX_TRIES = 3
"""Tries of an item that raises, or that kills its worker when it has it alone."""
MAX_IDLE_ROUNDS = 5
"""Rounds in a row that finish nothing before the job gives up."""
NO_WORKERS_S = 60.0
"""How long a cluster may be without any worker: those that died may be started again."""
_SAVE_S = 2.0
_POLL_S = 0.05
_CONNECT_S = 10.0
_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_KILLED = (
    "its worker died, alone with it: no traceback; out of memory or a crash in compiled code\n"
)


@dataclass(frozen=True)
class Summary:
    """What a run did: items in all, shards ``kept`` from before and ``done`` now.

    ``failed`` indices that ``failed.json`` describes; ``n_lost`` workers that died on the way.
    """

    n_items: int
    n_kept: int
    n_done: int
    failed: Tuple[int, ...]
    n_lost: int

    @property
    def exit_code(self) -> int:
        """Return 0 when every item has its shard, else 1."""
        return 1 if self.failed else 0


@dataclass(frozen=True)
class Outcome:
    """How one item ended: ``sha256`` of its shard, ``error`` text, or ``n_lost`` workers died."""

    index: int
    sha256: str = ""
    error: str = ""
    n_lost: int = 0


@dataclass(frozen=True)
class Job:
    """What a worker needs beside the item."""

    task: Task
    key: JobKey
    folder: str


Engine = Callable[[Job, Sequence[Any], Sequence[int]], Iterator[Outcome]]


def run(
    task: Task,
    items: Sequence[Any],
    out_dir: Union[str, Path],
    seed: Union[int, Sequence[int]],
    n_jobs: int = 1,
    scheduler: Optional[str] = None,
    is_quiet: bool = False,
) -> Summary:
    """Bring every item to a shard in ``out_dir``, computing only what is missing or not whole.

    Parameters
    ----------
    task : module-level function ``(item, generator) -> dict of named arrays``.
    items : plain values, dataclasses or arrays; they must hold all that a result depends on (also
        the version of the code behind it), for a folder is known by its task, seed and items.
    seed : root seed, one number or several, 0 or more.
    n_jobs : processes here; 1 computes in this one, where an item that kills it ends the run.
    scheduler : address of a dask scheduler (``tcp://host:port``) whose workers share ``out_dir``.

    Raises
    ------
    JobError : the folder is another job's or not writable, the disk is full, workers keep dying.
    MissingExtraError : joblib or dask is not installed.
    """
    folder = Path(out_dir).resolve()
    job = Job(task, job_key(task, items, seed), str(folder))
    driver = _Driver(job, items)
    driver.look(shards.open_folder(folder, job.key).shards)
    n_kept = len(driver.done)
    try:
        with _engine(n_jobs, scheduler) as engine, Progress("shards", len(items), is_quiet) as bar:
            for _ in range(n_kept):
                bar.advance()
            driver.finish(engine, bar.advance)
    finally:
        shards.sweep_parts(folder)
        driver.save()
    return Summary(len(items), n_kept, driver.n_done, tuple(driver.failed()), driver.n_lost)


def compute(job: Job, index: int, item: Any) -> Outcome:
    """Run the task on one item and write its shard; in whatever process this is.

    Raises
    ------
    JobError : the shard cannot be written; that is the folder's fault and not the item's.
    """
    limit = module("threadpoolctl").threadpool_limits
    try:
        with _thread_variables("1"), limit(1):
            arrays = job.task(item, generator(job.key.seed, index))
        data = shards.encode(arrays, job.key.sha256, index)
    except MissingExtraError:
        raise
    except (Exception, SystemExit):
        return Outcome(index, error=traceback.format_exc())
    shards.write_whole(Path(job.folder) / shards.shard_name(index), data)
    return Outcome(index, sha256=hashlib.sha256(data).hexdigest())


class _Driver:
    """What the driving process knows of a run; its shards count when it can see them whole."""

    def __init__(self, job: Job, items: Sequence[Any]) -> None:
        self.job = job
        self.items = items
        self.done: Dict[str, str] = {}
        self.n_done = 0
        self.n_lost = 0
        self._folder = Path(job.folder)
        self._tries: Dict[int, int] = {}
        self._texts: Dict[int, str] = {}
        self._saved_s = time.monotonic()

    def look(self, known: Mapping[str, str]) -> None:
        """Believe each shard that is whole and, if the manifest ``known`` has it, as it says."""
        for index in range(len(self.items)):
            name = shards.shard_name(index)
            found = self._seen(index)
            if found is not None and known.get(name, found) == found:
                self.done[name] = found

    def failed(self) -> List[int]:
        """Return the items that have failed too often."""
        return sorted(index for index, n in self._tries.items() if n >= MAX_TRIES)

    def finish(self, engine: Engine, advance: Callable[[], None]) -> None:
        """Go round until each item is done or has failed too often.

        Raises
        ------
        JobError : round after round finishes nothing, or a shard cannot be written.
        """
        n_idle = 0
        while self._open():
            if n_idle == MAX_IDLE_ROUNDS:
                raise JobError(
                    f"{self._folder}: {n_idle} rounds finished nothing: {self.n_lost} workers "
                    f"died, {len(self._open())} items are open; look whether memory ran out and "
                    "whether all workers share this folder, then run again"
                )
            n_before, lost = self.n_done, []
            for outcome in engine(self.job, self.items, self._open()):
                if outcome.n_lost:
                    lost.append(outcome)
                else:
                    self._take(outcome, advance)
            # of items on one dead worker each tells of it; at least one there was
            self.n_lost += max((outcome.n_lost for outcome in lost), default=0)
            for outcome in lost:
                self._alone(engine, outcome.index, advance)
            n_idle = 0 if self.n_done > n_before else n_idle + 1

    def save(self) -> None:
        """Write the manifest, and ``failed.json`` or its absence.

        Raises
        ------
        JobError : the disk refuses, or another job has taken the folder.
        """
        shards.write_manifest(self._folder, shards.Manifest(self.job.key.fields(), self.done))
        self._saved_s = time.monotonic()
        listed = [
            {
                "index": index,
                "seed": {"entropy": list(self.job.key.seed), "spawn_key": [index]},
                "n_tries": self._tries[index],
                "traceback": self._texts[index],
            }
            for index in self.failed()
        ]
        path = self._folder / shards.FAILED
        if listed:
            shards.write_whole(path, (json.dumps(listed, indent=1) + "\n").encode())
        elif path.exists():
            path.unlink()

    def _open(self) -> List[int]:
        failed = set(self.failed())
        return [
            index
            for index in range(len(self.items))
            if index not in failed and shards.shard_name(index) not in self.done
        ]

    def _seen(self, index: int) -> Optional[str]:
        path = self._folder / shards.shard_name(index)
        return shards.sealed_sha256(path, self.job.key.sha256, index)

    def _alone(self, engine: Engine, index: int, advance: Callable[[], None]) -> None:
        """Try an item that lost its worker with none beside it: now it alone is to blame."""
        found = self._seen(index)
        if found is not None:
            self._take(Outcome(index, sha256=found), advance)
            return
        while self._tries.get(index, 0) < MAX_TRIES:
            (outcome,) = engine(self.job, self.items, [index])
            if not outcome.n_lost:
                self._take(outcome, advance)
                return
            self.n_lost += outcome.n_lost
            self._fail(index, _KILLED, outcome.n_lost)

    def _take(self, outcome: Outcome, advance: Callable[[], None]) -> None:
        if outcome.error:
            self._fail(outcome.index, outcome.error)
        elif self._seen(outcome.index) == outcome.sha256:
            self.done[shards.shard_name(outcome.index)] = outcome.sha256
            self.n_done += 1
            advance()
        if time.monotonic() - self._saved_s > _SAVE_S:
            self.save()

    def _fail(self, index: int, text: str, n_tries: int = 1) -> None:
        self._tries[index] = self._tries.get(index, 0) + n_tries
        self._texts[index] = text


@contextmanager
def _engine(n_jobs: int, scheduler: Optional[str]) -> Iterator[Engine]:
    """Give the function that computes some indices and yields outcomes as they come."""
    if n_jobs < 1:
        raise JobError(f"n_jobs {n_jobs}: expected 1 or more")
    if scheduler is not None:
        with _dask(scheduler) as engine:
            yield engine
    elif n_jobs > 1:
        yield _loky(n_jobs)
    else:
        module("threadpoolctl")
        yield _here


def _here(job: Job, items: Sequence[Any], indices: Sequence[int]) -> Iterator[Outcome]:
    return (compute(job, index, items[index]) for index in indices)


def _loky(n_jobs: int) -> Engine:
    """Return the engine of processes on this machine."""
    joblib = module("joblib")
    broken = module("joblib.externals.loky.process_executor").BrokenProcessPool

    def engine(job: Job, items: Sequence[Any], indices: Sequence[int]) -> Iterator[Outcome]:
        started: Dict[int, None] = {}

        def calls() -> Iterable[Any]:
            for index in indices:
                started[index] = None
                yield joblib.delayed(compute)(job, index, items[index])

        # max_nbytes: no memory maps, which a killed driver would leave in /dev/shm.
        pool = joblib.Parallel(
            n_jobs,
            backend="loky",
            return_as="generator_unordered",
            batch_size=1,
            max_nbytes=None,
        )
        try:
            for outcome in pool(calls()):
                started.pop(outcome.index)
                yield outcome
        except broken:
            # One dead process ends the whole call: what was started and not given back is lost.
            for index in list(started):
                yield Outcome(index, n_lost=1)

    return engine


@contextmanager
def _dask(address: str) -> Iterator[Engine]:
    """Give the engine of a dask cluster.

    Not through joblib's dask backend: with joblib 1.6.0 that waits forever for a task that dask
    has given up (4 workers died with it); the error never reaches joblib's callback.
    """
    distributed = module("distributed")
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:  # its TimeoutError is an OSError
        raise JobError(f"--scheduler {address}: no dask scheduler answers: {error}") from error

    def engine(job: Job, items: Sequence[Any], indices: Sequence[int]) -> Iterator[Outcome]:
        index_of = {
            client.submit(compute, job, index, items[index], pure=False): index for index in indices
        }
        ended = distributed.as_completed(
            list(index_of), loop=client.loop, with_results=True, raise_errors=False
        )
        alive_s = time.monotonic()
        while index_of:
            batch = ended.next_batch(block=False)
            if batch or _has_workers(client, address):
                alive_s = time.monotonic()
            elif time.monotonic() - alive_s > NO_WORKERS_S:
                raise JobError(f"--scheduler {address}: no worker for {NO_WORKERS_S:.0f} s")
            # not by the status of the future: that is "pending" again when the worker dies after
            # its result was fetched
            for future, result in batch:
                yield _dask_outcome(index_of.pop(future), result, address)
            if not batch:
                time.sleep(_POLL_S)

    with client:
        yield engine


def _has_workers(client: Any, address: str) -> bool:
    try:
        return bool(client.ncores())
    except OSError as error:
        raise JobError(f"--scheduler {address}: it went away: {error}; run again") from error


def _dask_outcome(index: int, result: Any, address: str) -> Outcome:
    """Return what a future gave, an outcome or (type, error, trace); raise any other error."""
    if isinstance(result, Outcome):
        return result
    error = result[1] if isinstance(result, tuple) else result
    if isinstance(error, module("distributed").KilledWorker):
        return Outcome(index, n_lost=error.allowed_failures + 1)
    if isinstance(error, ApexError):
        raise error
    raise JobError(f"--scheduler {address}: item {index}: {type(error).__name__} {error}")


@contextmanager
def _thread_variables(value: str) -> Iterator[None]:
    """Set the number of threads for libraries that are first imported inside the block.

    One for a task: the order of a parallel sum, and so its last digit, depends on the number.
    """
    kept = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update({name: value for name in _THREAD_VARIABLES})
    try:
        yield
    finally:
        for name, old in kept.items():
            if old is None:
                del os.environ[name]
            else:
                os.environ[name] = old
