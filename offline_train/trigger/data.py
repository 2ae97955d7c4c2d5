"""Data folders: shards of what was drawn, and a description of what they were drawn for.

A folder holds the scenes of one purpose only, and says which: a fit refuses what was drawn to
calibrate or to test, and the other way round. Scenes of the benches are never stored. The
description and the shards are tied together by a hash, so neither can be swapped. Source: ours.
"""

import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple, Union

import numpy as np

from apex_edge.errors import InputError
from apex_edge.triggers.base import TriggerConfig
from apex_edge.triggers.features import FEATURE_SET, FEATURE_VERSION
from apex_edge.triggers.wide import WIDE_SET, WIDE_VERSION
from apex_edge.types import Array
from offline_train import jobs, shards
from offline_train.job_key import Task, generator, job_key
from offline_train.scenes import star
from offline_train.scenes.truth import LOOK_AHEAD_S, scenario
from offline_train.trigger import seeds
from offline_train.trigger.fit import ROWS_PER_PAIR, thin
from offline_train.trigger.observe import Observed, Watching, join, observe
from offline_train.trigger.soft import soften

DESCRIPTION = "description.json"
FORMAT = "apex-edge-data"
FORMAT_VERSION = 1
STORED_PURPOSES = ("train", "calibration", "test")
SCENES_EACH = 250
"""Scenes, or star graphs, of one shard."""
WATCHED, STARS = "watched", "stars"
STAR_SETS: Dict[str, Callable[..., star.StarSet]] = {
    "paper-star": star.draw_paper_stars,
    "leak-free": star.draw_hard_stars,
}
_STAR_VERSION = 1


class DataError(InputError):
    """Refuse a data folder: missing, damaged, of another form, or drawn for another purpose."""

    slug = "data"


@dataclass(frozen=True)
class Description:
    """What a folder holds.

    ``kind`` "watched" (``Observed`` rows of a scenario) or "stars" (a ``StarSet`` of exact graphs
    that nobody watches); ``scenario`` and its ``version``; ``purpose``, ``seed``, ``n_scenes``;
    ``watching`` None for stars; ``only_contacts`` scenes without any contact were dropped;
    ``features`` names and versions what the rows hold.
    """

    kind: str
    scenario: str
    version: int
    purpose: str
    seed: int
    n_scenes: int
    watching: Optional[Watching] = None
    only_contacts: bool = False
    features: str = ""


@dataclass(frozen=True)
class Part:
    """One shard to draw: ``n_scenes`` of all that the description names."""

    description: Description
    n_scenes: int


def describe(
    name: str,
    purpose: str,
    seed: int,
    n_scenes: int,
    watching: Optional[Watching] = None,
    only_contacts: bool = False,
) -> Description:
    """Describe scenes to be drawn; ``name`` is a scenario or one of ``STAR_SETS``.

    Raises
    ------
    DataError : the purpose is not stored, a number makes no sense, or stars should be watched.
    PluginError : no scenario of that name.
    """
    if purpose not in STORED_PURPOSES:
        raise DataError(f"purpose {purpose!r}: only {', '.join(STORED_PURPOSES)} data is stored")
    if seed < 0 or n_scenes < 1:
        raise DataError(f"seed {seed}, {n_scenes} scenes: expected 0 or more, and 1 or more")
    if name in STAR_SETS:
        if watching is not None or only_contacts:
            raise DataError(f"{name}: star graphs are exact; noise, fps and window mean nothing")
        return Description(STARS, name, _STAR_VERSION, purpose, seed, n_scenes)
    watching = watching if watching is not None else Watching()
    check_watching(watching)
    if watching.n_rollouts and purpose != "train":
        raise DataError(
            f"purpose {purpose}: soft labels are for scenes to learn from; truth judges"
        )
    return Description(
        WATCHED,
        name,
        scenario(name).VERSION,
        purpose,
        seed,
        n_scenes,
        watching,
        only_contacts,
        _features(watching),
    )


def check_watching(watching: Watching) -> None:
    """Refuse a way of watching that cannot be.

    Raises
    ------
    DataError : a range is empty or out of reason.
    """
    ranges = {
        "noise_m": (watching.noise_m, 1e-6, 0.1),
        "fps": (watching.fps, 1.0, 240.0),
        "window": (watching.window, 3, watching.n_frames),
    }
    for name, ((low, high), least, most) in ranges.items():
        if not least <= low <= high <= most:
            raise DataError(f"{name} {low:g} to {high:g}: expected within {least:g} to {most:g}")
    if not 1 <= watching.stride <= watching.n_frames:
        raise DataError(f"stride {watching.stride}: expected 1 to {watching.n_frames}")
    if not 0 <= watching.n_rollouts <= 1000:
        raise DataError(f"n_rollouts {watching.n_rollouts}: expected 0 to 1000")
    if not 0.0 < watching.horizon_s <= LOOK_AHEAD_S:
        raise DataError(f"horizon_s {watching.horizon_s:g}: expected above 0, up to {LOOK_AHEAD_S}")


def write(
    description: Description,
    folder: Union[str, Path],
    n_jobs: int = 1,
    scheduler: Optional[str] = None,
    is_quiet: bool = False,
) -> jobs.Summary:
    """Draw what is described into a folder, or finish what was begun there.

    Raises
    ------
    DataError : the folder holds other data.
    JobError : it cannot be written, or workers keep dying.
    MissingExtraError : joblib or dask is not installed.
    """
    folder = Path(folder)
    if (folder / DESCRIPTION).exists() and read_description(folder) != description:
        raise DataError(f"{folder}: holds other data; choose another folder or delete this one")
    task, items, root = _job(description)
    # Opened first, so that the description never lands in a folder of another job.
    shards.open_folder(folder.resolve(), job_key(task, items, root))
    text = json.dumps(_plain(description), indent=1, sort_keys=True) + "\n"
    shards.write_whole(folder / DESCRIPTION, text.encode())
    return jobs.run(task, items, folder, root, n_jobs, scheduler, is_quiet)


def draw(description: Description) -> Observed:
    """Return the rows that ``write`` would put into a folder of a scenario, in this process."""
    _, items, root = _job(description)
    parts = (draw_watched(part, generator(root, index)) for index, part in enumerate(items))
    return join([Observed.from_arrays(arrays) for arrays in parts])


def origin(description: Description) -> Dict[str, Any]:
    """Return what a model document says of the scenes it was certified or tested on."""
    return {
        "scenario": description.scenario,
        "version": description.version,
        "purpose": description.purpose,
        "seed": description.seed,
        "n_scenes": description.n_scenes,
        "only_contacts": description.only_contacts,
    }


def read(folder: Union[str, Path], purpose: Optional[str] = None) -> Tuple[Observed, Description]:
    """Return the rows of a folder of a scenario; ``purpose`` refuses what was drawn for another.

    Raises
    ------
    DataError : no such data, of star graphs, or of another purpose.
    JobError : a shard is missing or damaged.
    """
    description = _expect(folder, WATCHED, purpose)
    parts = [Observed.from_arrays(arrays) for arrays in shards.read(folder)]
    return join(parts), description


def read_stars(
    folder: Union[str, Path], purpose: Optional[str] = None
) -> Tuple[star.StarSet, Description]:
    """Return the graphs of a folder of stars; ``purpose`` refuses what was drawn for another.

    Raises
    ------
    DataError : no such data, of a watched scenario, or of another purpose.
    JobError : a shard is missing or damaged.
    """
    description = _expect(folder, STARS, purpose)
    tables = list(shards.read(folder))
    names = [spec.name for spec in fields(star.StarSet)]
    columns = {name: np.concatenate([table[name] for table in tables]) for name in names}
    return star.StarSet(**columns), description


def read_description(folder: Union[str, Path]) -> Description:
    """Return what a folder says of itself, checked against its shards.

    Raises
    ------
    DataError : there is none, it is damaged, of another format, or does not belong to the shards.
    """
    path = Path(folder) / DESCRIPTION
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(
            f"{path}: cannot be read: {error}; make data with: apex train generate"
        ) from error
    if not isinstance(content, dict) or content.pop("format", None) != FORMAT:
        raise DataError(f"{path}: not a description of data")
    version = content.pop("format_version", None)
    if version != FORMAT_VERSION:
        raise DataError(f"{path}: version {version}, expected {FORMAT_VERSION}; generate it anew")
    try:
        description = _from_plain(content)
        task, items, root = _job(description)
    except (KeyError, TypeError, ValueError) as error:
        raise DataError(f"{path}: damaged: {error!r}; generate it anew") from error
    manifest = shards.read_manifest(Path(folder))
    if manifest is None or manifest.job != job_key(task, items, root).fields():
        raise DataError(f"{path}: does not describe the shards beside it; generate them anew")
    return description


def draw_watched(part: Part, random: np.random.Generator) -> Dict[str, Array]:
    """Draw one shard of a scenario: the task of the job.

    Raises
    ------
    DataError : this machine has another version of the scenario or of the features.
    """
    wanted = part.description
    watching = wanted.watching if wanted.watching is not None else Watching()
    known = describe(
        wanted.scenario,
        wanted.purpose,
        wanted.seed,
        wanted.n_scenes,
        watching,
        wanted.only_contacts,
    )
    if known != wanted:
        raise DataError(f"{wanted.scenario}: this worker would draw {known}, wanted is {wanted}")
    config = TriggerConfig()
    seen = observe(random, wanted.scenario, part.n_scenes, watching, config, wanted.only_contacts)
    if watching.n_rollouts:
        seen = seen.take(thin(seen.pair, ROWS_PER_PAIR, wanted.seed))
        seen = soften(seen, np.arange(len(seen.pair)), random, watching.n_rollouts)
    return seen.to_arrays()


def draw_stars(part: Part, random: np.random.Generator) -> Dict[str, Array]:
    """Draw one shard of star graphs: the task of the job."""
    return dict(vars(STAR_SETS[part.description.scenario](random, part.n_scenes)))


def _features(watching: Watching) -> str:
    narrow = f"{FEATURE_SET} {FEATURE_VERSION}"
    return f"{narrow}, {WIDE_SET} {WIDE_VERSION}" if watching.is_wide else narrow


def _job(description: Description) -> Tuple[Task, List[Part], Sequence[int]]:
    """Return task, items and root seed; the purpose is part of the seed, so none share scenes."""
    task = draw_stars if description.kind == STARS else draw_watched
    starts = range(0, description.n_scenes, SCENES_EACH)
    sizes = [min(SCENES_EACH, description.n_scenes - first) for first in starts]
    root = (seeds.PURPOSES.index(description.purpose), description.seed)
    return task, [Part(description, n) for n in sizes], root


def _expect(folder: Union[str, Path], kind: str, purpose: Optional[str]) -> Description:
    description = read_description(folder)
    if description.kind != kind:
        raise DataError(f"{folder}: holds {description.kind} data, expected {kind}")
    if purpose is not None and description.purpose != purpose:
        raise DataError(
            f"{folder}: drawn for {description.purpose}, expected {purpose}; what is learnt, "
            "certified and tested on the same scenes proves nothing"
        )
    if description.only_contacts and purpose in ("train", "test"):
        raise DataError(
            f"{folder}: holds only scenes that end in contact; neither a probability nor false "
            "alarms can be learnt or counted on them"
        )
    return description


def _plain(description: Description) -> Dict[str, Any]:
    return dict(asdict(description), format=FORMAT, format_version=FORMAT_VERSION)


def _from_plain(content: Dict[str, Any]) -> Description:
    watching = content.pop("watching")
    if watching is not None:
        lists = {key: tuple(v) if isinstance(v, list) else v for key, v in watching.items()}
        watching = Watching(**lists)
    return Description(watching=watching, **content)
