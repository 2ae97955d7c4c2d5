"""Models and test sets from files, as an evaluation needs them. Source: ours."""

from pathlib import Path
from typing import Dict, List, Sequence

import numpy as np

from apex_edge.errors import InputError
from apex_edge.triggers import model_file
from apex_edge.types import Array
from offline_train.reports.evaluation import Data, Model
from offline_train.scenes.truth import scenario
from offline_train.trigger import data
from offline_train.trigger.observe import Observed
from offline_train.trigger.scoring import device_scorer


def models(paths: Sequence[Path]) -> Dict[str, Model]:
    """Read model documents; each goes by the name of its file without suffix.

    Raises
    ------
    WeightsError : a file is damaged.
    InputError : two files share a name.
    """
    found: Dict[str, Model] = {}
    for path in paths:
        if path.stem in found:
            raise InputError(f"{path}: another model is called {path.stem!r} too; rename one")
        fields = model_file.read(path)
        found[path.stem] = Model(fields, device_scorer(fields))
    return found


def sets(folders: Sequence[Path]) -> List[Data]:
    """Read test sets; each goes by the name of its scenario, numbered from the second on.

    Raises
    ------
    DataError : a folder is no data, or was drawn to train or to calibrate on.
    InputError : it was drawn for a study of the classifier alone.
    JobError : a shard is missing or damaged.
    """
    found: List[Data] = []
    for folder in folders:
        seen, told = data.read(folder, "test")
        watching = told.watching
        if watching is not None and (watching.stride != 1 or not watching.is_gated):
            raise InputError(
                f"{folder}: drawn without the moving gate, or not every frame; events need both"
            )
        n_before = sum(one.origin["scenario"] == told.scenario for one in found)
        name = f"{told.scenario}-{n_before + 1}" if n_before else told.scenario
        found.append(Data(name, seen, tuple(scenario(told.scenario).KINDS), data.origin(told)))
    return found


def ceiling_inputs(seen: Observed) -> Array:
    """Return all that any model may see of the rows (r, k): what the boosted trees get."""
    return np.hstack([seen.features, seen.wide])
