"""Ten thousand malformed inputs: typed errors, nothing, or what is really there; never a crash.

Case ``i`` of a seed is always the same: its kind is the i-th of a fixed round, its damage drawn
from (seed, i). The cases run in child processes, real ones that run this very command, because a
decoder that crashes takes its process along: that is counted as a failure of the case, and the
rest goes on. Source: ours.
"""

import collections
import faulthandler
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import IO, Any, Counter, Dict, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np

from apex_edge.verbs.progress import Progress
from offline_train.benchmarks.lines import Line, at_most
from offline_train.benchmarks.perception import bad_calibrations, bad_files, bad_frames, judge

N_CASES = 10_000
MAX_CHILDREN = 2
SILENCE_S = 60.0  # no case takes a hundredth of that
POLL_S = 0.1
N_SHOWN = 12
MADE_UP, UNHANDLED, CRASHED, HUNG = "made up", "unhandled exception", "crash", "hung"
FAILURES = (MADE_UP, UNHANDLED, CRASHED, HUNG)
_COSTLY = ("command: replay", "command: calibrate hand-eye")  # ten times the others
FILE_CASES = {**bad_files.FILE_CASES, **bad_calibrations.installed()}
_PLAIN = [*bad_frames.FRAME_CASES, *(n for n in FILE_CASES if n not in _COSTLY)]
ROUND: Tuple[str, ...] = (*_PLAIN, *_PLAIN, *(n for n in _COSTLY if n in FILE_CASES))


class Outcome(NamedTuple):
    """What came of one case; ``detail`` says what was wrong."""

    index: int
    kind: str
    result: str
    detail: str = ""


def kind_of(index: int) -> str:
    """Return the kind of the i-th case."""
    return ROUND[index % len(ROUND)]


def run_case(seed: int, index: int, folder: Path) -> Outcome:
    """Run one case in a folder of its own, which is emptied first."""
    kind = kind_of(index)
    rng = np.random.RandomState([seed, index])
    try:
        if kind in bad_frames.FRAME_CASES:
            return Outcome(index, kind, bad_frames.FRAME_CASES[kind](rng))
        bad_files.clear(folder)
        return Outcome(index, kind, FILE_CASES[kind](rng, folder))
    except judge.MadeUp as finding:
        return Outcome(index, kind, MADE_UP, str(finding))
    except Exception as error:  # noqa: BLE001 - to find what nobody expects is what this is for
        return Outcome(index, kind, UNHANDLED, f"{type(error).__name__}: {error}"[:300])


def run_part(seed: int, indices: Sequence[int], results: Path) -> None:
    """Run cases in this process; each is named in ``results`` before and after it ran."""
    faulthandler.enable()
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as top, results.open("a", encoding="utf-8") as file:
        for index in indices:
            _tell(file, {"begins": index})
            _tell(file, run_case(seed, index, Path(top) / "case")._asdict())


def _tell(file: IO[str], values: Dict[str, Any]) -> None:
    file.write(json.dumps(values) + "\n")
    file.flush()


def command(seed: int, first: int, last: int, results: Path) -> List[str]:
    """Return the command of a child that runs the cases ``first`` to before ``last``."""
    verb = [sys.executable, "-m", "apex_edge.cli", "bench", "perception", "--suite", "malformed"]
    return [*verb, "--seed", str(seed), "--part", f"{first}:{last}", "--results", str(results)]


class Child:
    """One process at a time that works through a range of cases, started anew after a crash."""

    def __init__(self, seed: int, first: int, last: int, folder: Path) -> None:
        self._seed, self._next, self._last = seed, first, last
        self._results = folder / f"{first}.jsonl"
        self._noise = folder / f"{first}.err"
        self._results.touch()
        self._n_read = 0
        self._running = -1
        self._heard_s = time.monotonic()
        self._process = self._start()

    def outcomes(self) -> Iterator[Outcome]:
        """Yield what has come in since the last call, crashes and silence included."""
        is_over = self._process.poll() is not None
        with self._results.open(encoding="utf-8") as file:
            file.seek(self._n_read)
            for line in iter(file.readline, ""):
                if not line.endswith("\n"):
                    break
                self._n_read += len(line.encode("utf-8"))
                values = json.loads(line)
                self._heard_s = time.monotonic()
                if "begins" in values:
                    self._running = values["begins"]
                    continue
                self._running, self._next = -1, values["index"] + 1
                yield Outcome(**values)
        yield from self._after_silence(is_over)

    @property
    def is_done(self) -> bool:
        """Say whether every case has an outcome."""
        return self._next >= self._last

    def stop(self) -> None:
        """End the process."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()

    def _after_silence(self, is_over: bool) -> Iterator[Outcome]:
        is_hung = not is_over and time.monotonic() - self._heard_s > SILENCE_S
        if self.is_done or not (is_over or is_hung):
            return
        self.stop()
        index = self._running if self._running >= 0 else self._next
        code = self._process.returncode
        said = self._noise.read_bytes()[-400:].decode("utf-8", "replace")
        result = HUNG if is_hung else CRASHED
        yield Outcome(index, kind_of(index), result, f"{_name_of(code)}: {said}")
        self._running, self._next = -1, index + 1
        if not self.is_done:
            self._process = self._start()

    def _start(self) -> "subprocess.Popen[bytes]":
        self._heard_s = time.monotonic()
        env = dict(os.environ, OPENCV_FFMPEG_LOGLEVEL="-8", OPENCV_LOG_LEVEL="SILENT")
        with self._noise.open("wb") as noise:
            return subprocess.Popen(
                command(self._seed, self._next, self._last, self._results),
                stdin=subprocess.DEVNULL,
                stdout=noise,
                stderr=noise,
                env=env,
            )


def _name_of(code: int) -> str:
    if code >= 0:
        return f"exit code {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def campaign(seed: int, n_cases: int, is_quiet: bool = False) -> List[Outcome]:
    """Run the cases 0 .. n_cases - 1 in child processes and return what came of each."""
    n_children = max(1, min(MAX_CHILDREN, os.cpu_count() or 1, n_cases // 50))
    edges = np.linspace(0, n_cases, n_children + 1).astype(int).tolist()
    outcomes: List[Outcome] = []
    with tempfile.TemporaryDirectory() as top, Progress("cases", n_cases, is_quiet) as progress:
        children = [Child(seed, a, b, Path(top)) for a, b in zip(edges, edges[1:])]
        try:
            while not all(child.is_done for child in children):
                time.sleep(POLL_S)
                for child in children:
                    for outcome in child.outcomes():
                        outcomes.append(outcome)
                        progress.advance()
        finally:
            for child in children:
                child.stop()
    return sorted(outcomes)


def measure(seed: int, n_cases: int, is_quiet: bool = False) -> List[Line]:
    """Run the campaign and return one line per kind and the total."""
    return lines_of(seed, campaign(seed, n_cases, is_quiet))


def lines_of(seed: int, outcomes: Sequence[Outcome]) -> List[Line]:
    """Return what came of each kind, a failure of each sort, and whether the promise is kept."""
    by_kind: Dict[str, Counter[str]] = {}
    for outcome in outcomes:
        by_kind.setdefault(outcome.kind, collections.Counter())[outcome.result] += 1
    lines = [_kind_line(kind, by_kind[kind]) for kind in dict.fromkeys(ROUND) if kind in by_kind]
    failures = [outcome for outcome in outcomes if outcome.result in FAILURES]
    shown = {(o.kind, o.result, o.detail.split(":")[0]): o for o in reversed(failures)}
    for outcome in sorted(shown.values())[:N_SHOWN]:
        what = f"  case {outcome.index} of seed {seed} ({outcome.kind})"
        lines.append(Line("malformed", what, f"{outcome.result}: {outcome.detail}"))
    what = f"failures in {len(outcomes)} malformed inputs"
    return [*lines, at_most("malformed", what, len(failures), 0.0, "{:.0f}")]


def _kind_line(kind: str, counts: "Counter[str]") -> Line:
    told = ", ".join(f"{n} {result}" for result, n in sorted(counts.items()))
    n_failures = sum(counts[result] for result in FAILURES)
    return Line("malformed", kind, told, "no failure", n_failures == 0, dict(counts))
