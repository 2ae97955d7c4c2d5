"""What tells one job from another: its task, root seed and items; and its random numbers.

Source: ours.
"""

import dataclasses
import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, Sequence, Union

import numpy as np

from apex_edge.errors import ApexError
from apex_edge.types import Array

Task = Callable[[Any, np.random.Generator], Dict[str, Array]]


class JobError(ApexError):
    """Report a job that cannot go on: a foreign or unusable folder, a full disk, lost workers."""

    slug = "job"


@dataclass(frozen=True)
class JobKey:
    """What a folder of shards belongs to.

    ``task`` dotted name, ``seed`` root seed, ``n_items``, ``items_sha256`` of all items.
    """

    task: str
    seed: Sequence[int]
    n_items: int
    items_sha256: str

    def fields(self) -> Dict[str, Any]:
        """Return the key as JSON values."""
        return {
            "task": self.task,
            "seed": list(self.seed),
            "n_items": self.n_items,
            "items_sha256": self.items_sha256,
        }

    @property
    def sha256(self) -> str:
        """Return the hash that is sealed into each shard."""
        text = json.dumps(self.fields(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()


def job_key(task: Task, items: Sequence[Any], seed: Union[int, Sequence[int]]) -> JobKey:
    """Return what names this job: the task, the root seed and a hash of the items.

    Raises
    ------
    JobError : the task is no module-level function, the seed negative, an item not plain.
    """
    name = getattr(task, "__qualname__", "<none>")
    if "<" in name or "." in name:
        raise JobError(f"task {task!r}: must be a function at the top level of a module")
    numbers = (seed,) if isinstance(seed, int) else tuple(int(number) for number in seed)
    if not numbers or min(numbers) < 0:
        raise JobError(f"seed {seed!r}: expected one or more numbers, 0 or more")
    digest = hashlib.sha256()
    for index, item in enumerate(items):
        try:
            digest.update(json.dumps(item, sort_keys=True, default=_plain).encode() + b"\n")
        except (TypeError, ValueError) as error:
            raise JobError(f"item {index}: cannot be told from others: {error}") from error
    return JobKey(f"{task.__module__}.{name}", numbers, len(items), digest.hexdigest())


def generator(seed: Sequence[int], index: int) -> np.random.Generator:
    """Return the generator of an item.

    The index is a spawn key and not one more number of the seed: numpy pads seeds with zeros, so
    [seed, index] would be the generator [seed, index, 0] of ``trigger.seeds`` as well.
    """
    return np.random.default_rng(np.random.SeedSequence(list(seed), spawn_key=(index,)))


def _plain(value: Any) -> Any:
    """Return what JSON can hold of an item's dataclass, array, number or path."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {part.name: getattr(value, part.name) for part in dataclasses.fields(value)}
        return {"type": type(value).__qualname__, **fields}
    if isinstance(value, np.ndarray):
        return {"dtype": value.dtype.str, "shape": value.shape, "values": value.tolist()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} is not plain")
