"""The features of the trainer's interpreter against those of the device's, Python 3.7.

Both run the same source; numpy, its summation and the C library differ. The trainer writes random
pairs and its features to a file, and the 3.7 interpreter of the checkout (``.venv37``) works them
out again in a process of its own. Source: ours.
"""

import subprocess
import sys
import tempfile
from dataclasses import fields
from pathlib import Path
from typing import Dict, List, Mapping

import numpy as np

from apex_edge.triggers.approach import Pairs, closest
from apex_edge.triggers.features import edge_features
from apex_edge.triggers.wide import wide_features
from apex_edge.triggers.windows import WINDOWS, fit_lines
from apex_edge.types import Array
from offline_train.benchmarks.lines import Line, at_most
from offline_train.benchmarks.trigger.pair_cases import (
    FRAME_S,
    HORIZON_S,
    random_pairs,
    random_windows,
)
from offline_train.trigger.seeds import rng

SUITE = "parity"
GOAL = 1e-9
N_PAIRS = 3000
_ROOT = Path(__file__).resolve().parents[3]
_DEVICE = _ROOT / ".venv37" / "bin" / "python"
_LONGEST_S = 120.0
_MODULE = "offline_train.benchmarks.trigger.feature_parity"


def feature_parity_lines(seed: int) -> List[Line]:
    """Return the largest difference per set, relative to the value where that is above 1."""
    if not _DEVICE.exists():
        reason = f"no device interpreter at {_DEVICE.relative_to(_ROOT)}"
        return [Line(SUITE, "features, trainer against Python 3.7", reason)]
    with tempfile.TemporaryDirectory() as folder:
        source, result = Path(folder) / "pairs.npz", Path(folder) / "device.npz"
        cases = _cases(seed)
        np.savez(str(source), **cases)
        command = [str(_DEVICE), "-m", _MODULE, str(source), str(result)]
        done = subprocess.run(
            command,
            cwd=str(_ROOT),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=_LONGEST_S,
        )
        if done.returncode:
            reason = done.stdout.decode("utf-8", "replace").strip().splitlines()[-1:]
            return [Line(SUITE, "features, Python 3.7 failed", " ".join(reason), "", False)]
        with np.load(str(result), allow_pickle=False) as device:
            found = {name: device[name] for name in device.files}
    lines = []
    for name, mine in _answers(cases).items():
        gap = np.abs(mine - found[name]) / np.maximum(np.abs(mine), 1.0)
        what = f"{name}, trainer against Python 3.7, {len(mine)} pairs"
        lines.append(at_most(SUITE, what, float(gap.max()), GOAL, "{:.1e}"))
    return lines


def _cases(seed: int) -> Dict[str, Array]:
    """Return the raw inputs as arrays by name."""
    generator = rng("bench", seed)
    cases = _laid_out("one.", random_pairs(generator, N_PAIRS, slowing_share=0.3))
    for number, pairs in enumerate(random_windows(generator, N_PAIRS)):
        cases.update(_laid_out(f"window{number}.", pairs))
    jitter = generator.uniform(-0.2, 0.2, (N_PAIRS, max(WINDOWS)))
    cases["t_s"] = (np.arange(max(WINDOWS)) + jitter) * FRAME_S
    cases["xy"] = generator.normal(size=(N_PAIRS, max(WINDOWS), 2)) * 0.1
    cases["sd"] = generator.uniform(0.0005, 0.003, N_PAIRS)
    return cases


def _answers(cases: Mapping[str, Array]) -> Dict[str, Array]:
    """Return what this interpreter makes of them."""
    pairs = _taken("one.", cases)
    windows = [_taken(f"window{number}.", cases) for number in range(len(WINDOWS))]
    lines = fit_lines(cases["t_s"], cases["xy"], cases["sd"])
    fitted = [lines.position, lines.velocity, lines.cov.reshape(len(lines.cov), -1)]
    return {
        "fused12 features": edge_features(pairs, closest(pairs, HORIZON_S), HORIZON_S),
        "wide features": wide_features(windows, HORIZON_S),
        "line fits": np.concatenate(fitted, axis=1),
    }


def _laid_out(prefix: str, pairs: Pairs) -> Dict[str, Array]:
    return {prefix + spec.name: getattr(pairs, spec.name) for spec in fields(Pairs)}


def _taken(prefix: str, cases: Mapping[str, Array]) -> Pairs:
    return Pairs(**{spec.name: cases[prefix + spec.name] for spec in fields(Pairs)})


def _answer_file(source: str, result: str) -> None:
    with np.load(source, allow_pickle=False) as stored:
        cases = {name: stored[name] for name in stored.files}
    np.savez(result, **_answers(cases))


if __name__ == "__main__":
    _answer_file(sys.argv[1], sys.argv[2])
