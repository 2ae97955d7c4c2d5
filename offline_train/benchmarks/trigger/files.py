"""Bench of the model files: every spoilt one is refused by its own error, every sound one loads.

Runs on Python 3.7 with nothing but the device's packages.
"""

import tempfile
from pathlib import Path
from typing import Any, Dict, Iterator, List, Tuple

from apex_edge.errors import WeightsError
from apex_edge.triggers import model_file, weights
from offline_train.benchmarks.lines import Line, at_least, at_most
from offline_train.benchmarks.trigger import damages
from offline_train.trigger.seeds import rng

SUITE = "files"
N_MUTATIONS = 1500
"""Random mutations of each sound file."""


def measure(seed: int) -> List[Line]:
    """Load sound, spoilt and randomly changed files; count what becomes of them."""
    documents = sound_documents(seed)
    tally = {"spoilt": Tally(), "mutated": Tally()}
    n_sound, n_loaded = 0, 0
    with tempfile.TemporaryDirectory() as folder:
        for number, (kind, fields) in enumerate(sorted(documents.items())):
            for suffix, form in ((".json", model_file.as_json), (".npz", model_file.as_npz)):
                path, sound = Path(folder) / f"model{suffix}", form(fields)
                path.write_bytes(sound)
                n_sound += 1
                n_loaded += weights.load(path).threshold == fields["threshold"]["logit"]
                for data in _spoilt(kind, fields, suffix):
                    tally["spoilt"].take(path, data, fields)
                random = rng("bench", seed, 2 * number + (suffix == ".npz"))
                for _ in range(N_MUTATIONS):
                    tally["mutated"].take(path, damages.mutated(sound, random), fields)
    lines = [at_least(SUITE, "sound files that load, of " + str(n_sound), n_loaded, n_sound)]
    for name, found in tally.items():
        lines += found.lines(name)
    return lines


def sound_documents(seed: int) -> Dict[str, Dict[str, Any]]:
    """Return a linear and a graph document: the shipped ones; no graph shipped = a made one."""
    linear = model_file.read(weights.SHIPPED)
    if weights.SHIPPED_GRAPH.exists():
        return {"linear": linear, "graph": model_file.read(weights.SHIPPED_GRAPH)}
    return {"linear": linear, "graph": damages.made_graph(linear, seed)}


class Tally:
    """How many files were refused as they should be, and what else happened."""

    def __init__(self) -> None:
        self.n_files = self.n_refused = self.n_harmless = self.n_accepted = self.n_other = 0

    def take(self, path: Path, data: bytes, fields: Dict[str, Any]) -> None:
        """Write and load one file; a change that leaves the content as it was is harmless."""
        path.write_bytes(data)
        self.n_files += 1
        outcome = _outcome(path, fields)
        self.n_refused += outcome == "refused"
        self.n_harmless += outcome == "harmless"
        self.n_accepted += outcome == "accepted"
        self.n_other += outcome == "other"

    def lines(self, name: str) -> List[Line]:
        """Return the lines of the bench."""
        wanted = self.n_files - self.n_harmless
        what = f"{name} files refused by WeightsError, of {wanted}"
        return [
            at_least(SUITE, what, self.n_refused, wanted, "{:.0f}"),
            at_most(SUITE, f"{name} files that load with other content", self.n_accepted, 0),
            at_most(SUITE, f"{name} files that raise anything else", self.n_other, 0),
        ]


def _outcome(path: Path, fields: Dict[str, Any]) -> str:
    try:
        weights.load(path)
        return "harmless" if model_file.read(path) == fields else "accepted"
    except WeightsError:
        return "refused"
    except Exception:  # noqa: BLE001  this is what is counted
        return "other"


def _spoilt(kind: str, fields: Dict[str, Any], suffix: str) -> Iterator[bytes]:
    for apply, _ in damages.damages_of(kind).values():
        yield damages.damaged(fields, apply, suffix)
    form: Tuple[Any, Any] = (model_file.as_json, damages.OF_JSON)
    if suffix == ".npz":
        form = (model_file.as_npz, damages.OF_NPZ)
    for spoil in form[1].values():
        yield spoil(form[0](fields))
