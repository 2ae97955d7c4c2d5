"""A toy job and the accidents it must survive; the tests and the bench run the same ones.

A driver is a process of its own, so that it and its workers can really be killed. Only processes
that were started here are.
"""

import argparse
import json
import logging
import os
import resource
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Set

import numpy as np

from apex_edge.errors import ApexError
from apex_edge.types import Array
from offline_train import jobs, shards
from offline_train.extras import module
from offline_train.job_key import JobError, job_key

LOG_VARIABLE = "APEX_TOY_LOG"
N_ITEMS = 24
SLEEP_S = 0.05
N_BEFORE = 10
"""Shards that are there before something is killed."""
LATE_S = 1.0
"""How long the late killer works first: a worker is to die after it was started."""
POISON = {3: "raises", 5: "kills"}
_SIDE = 120
_PATIENCE_S = 100.0


def toy(item: Dict[str, Any], rng: np.random.Generator) -> Dict[str, Array]:
    """Say that it was called, take its time, then compute, raise or kill its process."""
    log = os.environ.get(LOG_VARIABLE)
    if log is not None:
        with Path(log).open("a", encoding="ascii") as file:
            file.write(f"{item['index']} {os.getpid()}\n")
    time.sleep(item["sleep_s"])
    if item["kind"] == "raises":
        raise ValueError(f"item {item['index']} is poison")
    if item["kind"] == "kills late":
        time.sleep(LATE_S)
    if item["kind"] in ("kills", "kills late"):
        os.kill(os.getpid(), signal.SIGKILL)
    draw = rng.normal(size=(_SIDE, _SIDE))
    return {"product": draw @ draw.T, "index": np.array(item["index"])}


def toy_items(n: int = N_ITEMS, poison: Optional[Mapping[int, str]] = None) -> List[Dict[str, Any]]:
    """Return n items; ``poison`` says which "raises", "kills" or "kills late"."""
    kinds = poison or {}
    return [
        {"index": index, "sleep_s": SLEEP_S, "kind": kinds.get(index, "good")} for index in range(n)
    ]


@dataclass(frozen=True)
class Found:
    """What an accident left.

    Against a single-process run: shards ``n_different``, ``n_lost``; ``n_torn`` files that are not
    whole or temporary. ``n_items``, ``n_calls`` of the task in all runs, ``n_failed`` items listed,
    ``n_again`` calls for what was already there; ``exit_codes`` of the drivers in turn, ``said``
    their last words, ``took_s`` seconds.
    """

    n_different: int
    n_lost: int
    n_torn: int
    n_items: int
    n_calls: int
    n_failed: int
    n_again: int
    exit_codes: Sequence[int]
    said: str
    took_s: float


class Stage:
    """A scratch folder with one job in it: starts drivers, counts calls, compares the shards."""

    def __init__(
        self, scratch: Path, seed: int, poison: Optional[Mapping[int, str]] = None
    ) -> None:
        self.out = scratch / "job"
        self.log = scratch / "calls.log"
        self.log.touch()
        self.seed = seed
        self.poison = dict(poison or {})
        self.exit_codes: List[int] = []
        self._said = scratch / "said.txt"
        self.n_again = 0
        self._drivers: List[subprocess.Popen[bytes]] = []
        self._began_s = time.monotonic()
        self._items = toy_items(poison=self.poison)
        self._key = job_key(toy, self._items, seed)

    def start(self, n_jobs: int = 2, *more: str) -> "subprocess.Popen[bytes]":
        """Start a driver."""
        command = [sys.executable, "-c", f"from {__name__} import main; main()"]
        command += ["--out", str(self.out), "--seed", str(self.seed), "--jobs", str(n_jobs)]
        command += ["--poison", json.dumps(self.poison), *more]
        environment = {**os.environ, LOG_VARIABLE: str(self.log)}
        # a file and no pipe: the workers of a killed driver would keep that open
        with self._said.open("ab") as said:
            driver = subprocess.Popen(command, env=environment, stdout=said, stderr=said)
        self._drivers.append(driver)
        return driver

    def end(self, driver: "subprocess.Popen[bytes]") -> int:
        """Wait for a driver; note and return its exit code."""
        try:
            driver.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            driver.kill()
        self.exit_codes.append(driver.wait())
        return self.exit_codes[-1]

    def run(self, n_jobs: int = 2, *more: str) -> int:
        """Run a driver to its end and return its exit code; count calls for what was there."""
        there, n_before = self.whole(), len(self.calls())
        code = self.end(self.start(n_jobs, *more))
        self.n_again += sum(index in there for index, _ in self.calls()[n_before:])
        return code

    def calls(self) -> List[Any]:
        """Return (index, process) of each call of the task so far."""
        lines = self.log.read_text(encoding="ascii").splitlines()
        return [tuple(int(word) for word in line.split()) for line in lines]

    def whole(self) -> Set[int]:
        """Return the items whose shard is there and whole."""
        return {
            index
            for index in range(len(self._items))
            if shards.sealed_sha256(self.path(index), self._key.sha256, index) is not None
        }

    def path(self, index: int) -> Path:
        """Return the shard of an item."""
        return self.out / shards.shard_name(index)

    def n_torn(self) -> int:
        """Count files that are temporary, or are shards and not whole."""
        present = list(self.out.iterdir()) if self.out.is_dir() else []
        n_parts = sum(path.name.endswith(".part") for path in present)
        return n_parts + sum(path.suffix == ".npz" for path in present) - len(self.whole())

    def wait(self, is_so: Callable[[], bool]) -> None:
        """Wait until something is so.

        Raises
        ------
        JobError : the driver ended before.
        """
        while not is_so():
            if all(driver.poll() is not None for driver in self._drivers):
                said = self._said.read_text()
                raise JobError(f"the driver ended after {len(self.whole())} shards: {said}")
            time.sleep(0.01)

    def kill_worker(self) -> int:
        """Kill the worker that was called last, when some shards are there; return its id."""
        self.wait(lambda: len(self.whole()) >= N_BEFORE)
        worker = int(self.calls()[-1][1])
        os.kill(worker, signal.SIGKILL)
        return worker

    def end_orphans(self) -> None:
        """Kill the workers that a killed driver has left behind."""
        for worker in {process for _, process in self.calls()}:
            with suppress(ProcessLookupError):
                os.kill(worker, signal.SIGKILL)

    def found(self, n_torn: int = 0) -> Found:
        """Compare with a run in this process alone; ``n_torn`` seen on the way count too."""
        good = [index for index in range(len(self._items)) if index not in self.poison]
        n_different = n_lost = 0
        for index in good:
            wanted = toy(
                {**self._items[index], "sleep_s": 0.0}, jobs.generator((self.seed,), index)
            )
            path = self.path(index)
            if not path.exists():
                n_lost += 1
            elif path.read_bytes() != shards.encode(wanted, self._key.sha256, index):
                n_different += 1
        failed = self.out / shards.FAILED
        return Found(
            n_different=n_different,
            n_lost=n_lost,
            n_torn=n_torn + self.n_torn(),
            n_items=len(self._items),
            n_calls=len(self.calls()),
            n_failed=len(json.loads(failed.read_text())) if failed.exists() else 0,
            n_again=self.n_again,
            exit_codes=tuple(self.exit_codes),
            said=self._said.read_text(),
            took_s=time.monotonic() - self._began_s,
        )


def kill_one_worker(scratch: Path, seed: int) -> Found:
    """Kill one of two workers in the middle of a run."""
    stage = Stage(scratch, seed)
    driver = stage.start()
    stage.kill_worker()
    stage.end(driver)
    return stage.found()


def kill_the_driver(scratch: Path, seed: int) -> Found:
    """Kill the driver in the middle, leave its workers as they are, and run again."""
    stage = Stage(scratch, seed)
    driver = stage.start()
    stage.wait(lambda: len(stage.whole()) >= N_BEFORE)
    driver.kill()
    stage.end(driver)
    try:
        stage.run()
    finally:
        stage.end_orphans()
    return stage.found()


def interrupt_the_driver(scratch: Path, seed: int) -> Found:
    """Interrupt the driver as Ctrl-C does, and run again."""
    stage = Stage(scratch, seed)
    driver = stage.start()
    stage.wait(lambda: len(stage.whole()) >= N_BEFORE)
    driver.send_signal(signal.SIGINT)
    stage.end(driver)
    n_torn = stage.n_torn()
    stage.run()
    return stage.found(n_torn)


def damage_shards(scratch: Path, seed: int) -> Found:
    """Cut one shard of a finished job, and flip a bit of another; run again."""
    stage = Stage(scratch, seed)
    stage.run()
    with stage.path(3).open("r+b") as file:
        file.truncate(1000)
    data = bytearray(stage.path(7).read_bytes())
    data[500] ^= 1
    stage.path(7).write_bytes(bytes(data))
    stage.run(1)
    return stage.found()


def run_poison(scratch: Path, seed: int) -> Found:
    """Run a job with an item that raises and one that kills its worker."""
    stage = Stage(scratch, seed, POISON)
    stage.run()
    return stage.found()


def run_poison_on_dask(scratch: Path, seed: int) -> Found:
    """Run the same on a dask cluster that reports the first death.

    By default it tries an item on four workers; a local cluster ran out of workers that way, since
    one that dies while it is being started is not started again (dask 2026.8.0).
    """
    stage = Stage(scratch, seed, {3: "raises", 5: "kills late"})
    with dask_cluster(stage.log, n_forgiven=0) as address:
        stage.run(1, "--scheduler", address)
    return stage.found()


def fill_the_disk(scratch: Path, seed: int) -> Found:
    """Let no file grow beyond half a shard, as a full disk would; then run without that limit."""
    stage = Stage(scratch, seed)
    stage.run(2, "--max-bytes", "60000")
    n_torn = stage.n_torn()
    stage.run()
    return stage.found(n_torn)


def race_two_drivers(scratch: Path, seed: int) -> Found:
    """Run two drivers at once on one folder, looking all the time for files that are not whole."""
    stage = Stage(scratch, seed)
    drivers = [stage.start(2), stage.start(1)]
    n_torn = 0
    while any(driver.poll() is None for driver in drivers):
        for path in stage.out.glob("*.npz"):
            n_torn += shards.sealed_sha256(path, stage._key.sha256, int(path.stem)) is None
        time.sleep(0.02)
    for driver in drivers:
        stage.end(driver)
    return stage.found(n_torn)


def kill_a_dask_worker(scratch: Path, seed: int) -> Found:
    """Kill one of the two worker processes of a dask cluster in the middle of a run."""
    stage = Stage(scratch, seed)
    with dask_cluster(stage.log) as address:
        driver = stage.start(1, "--scheduler", address)
        stage.kill_worker()
        stage.end(driver)
    return stage.found()


@contextmanager
def dask_cluster(log: Path, n_forgiven: int = 3) -> Iterator[str]:
    """Give the address of a scheduler on 127.0.0.1 with two worker processes.

    It gives an item up when more than ``n_forgiven`` workers died with it.
    """
    distributed = module("distributed")
    # a worker's death, which is the point, would fill the screen
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    forgiven = {"distributed.scheduler.allowed-failures": n_forgiven}
    with module("dask.config").set(forgiven), distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        env={LOG_VARIABLE: str(log)},
        silence_logs=logging.CRITICAL,
    ) as cluster:
        yield str(cluster.scheduler_address)


def main() -> None:
    """Run the toy job as a driver of its own; say the error, if any, on standard error."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--scheduler")
    parser.add_argument("--poison", default="{}")
    parser.add_argument("--max-bytes", type=int)
    args = parser.parse_args()
    if args.max_bytes is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (args.max_bytes, args.max_bytes))
    poison = {int(index): kind for index, kind in json.loads(args.poison).items()}
    try:
        summary = jobs.run(
            toy, toy_items(poison=poison), args.out, args.seed, args.jobs, args.scheduler
        )
    except ApexError as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        sys.exit(error.exit_code)
    print(json.dumps(asdict(summary)))
    sys.exit(summary.exit_code)
