"""Many seeded scenes as fast as the machine allows, and the counts that come of them."""

import math
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from typing import Any, Callable, Dict, List, Optional, Sequence, Tuple

from apex_edge.assemble import ApexConfig, Kit
from apex_edge.closed_loop import SceneOutcome, ScenePlayer
from apex_edge.twin.scenarios import make
from apex_edge.types import Step

Task = Tuple[str, int]

# One per worker process, made by _start_worker.
_player: Optional[ScenePlayer] = None


@dataclass(frozen=True)
class KindCounts:
    """Counts over all scenes of one kind.

    ``n_would_collide`` touch with no arm, ``n_eligible`` of these with the mover visibly in motion
    for at least 1.5 s before; ``n_prevented*`` of these without a collision; ``n_target_touched``
    the arm itself touched the protected object.
    """

    n_scenes: int
    n_interventions: int
    n_collisions: int
    n_false_interventions: int
    n_would_collide: int
    n_prevented: int
    n_eligible: int
    n_prevented_eligible: int
    n_target_touched: int


def count(outcomes: Sequence[SceneOutcome]) -> KindCounts:
    """Count what became of some scenes."""
    threatened = [o for o in outcomes if o.would_collide]
    eligible = [o for o in threatened if o.is_eligible]
    return KindCounts(
        n_scenes=len(outcomes),
        n_interventions=sum(o.is_intervention for o in outcomes),
        n_collisions=sum(o.is_collision for o in outcomes),
        n_false_interventions=sum(o.is_false_intervention for o in outcomes),
        n_would_collide=len(threatened),
        n_prevented=sum(not o.is_collision for o in threatened),
        n_eligible=len(eligible),
        n_prevented_eligible=sum(not o.is_collision for o in eligible),
        n_target_touched=sum(o.is_target_touched for o in outcomes),
    )


def tasks(kinds: Sequence[str], n_scenes: int, seed: int) -> List[Task]:
    """List the scenes of one run: ``n_scenes`` of each kind, seeds of their own."""
    return [(kind, 1000 * seed + i) for kind in kinds for i in range(n_scenes)]


def play_all(
    config: ApexConfig,
    todo: Sequence[Task],
    n_jobs: int,
    on_outcome: Callable[[SceneOutcome], None],
) -> List[SceneOutcome]:
    """Play scenes in ``n_jobs`` processes; the outcomes come in the order of ``todo``.

    Raises
    ------
    ApexError : whatever a scene raised.
    """
    outcomes: List[SceneOutcome] = []
    if n_jobs == 1:
        _start_worker(config)
        for task in todo:
            outcomes.append(_play(task))
            on_outcome(outcomes[-1])
        return outcomes
    context = get_context("spawn")
    with ProcessPoolExecutor(n_jobs, context, _start_worker, (config,)) as pool:
        for outcome in pool.map(_play, todo):
            outcomes.append(outcome)
            on_outcome(outcome)
    return outcomes


def as_json(outcomes: Sequence[SceneOutcome], seed: int) -> Dict[str, Any]:
    """Return counts by kind and every scene as plain values; times that never came are null."""
    kinds = list(dict.fromkeys(o.kind for o in outcomes))
    return {
        "format": "apex-edge-demo",
        "format_version": 1,
        "seed": seed,
        "counts": {k: asdict(count([o for o in outcomes if o.kind == k])) for k in kinds},
        "scenes": [_scene_json(outcome) for outcome in outcomes],
    }


def _scene_json(outcome: SceneOutcome) -> Dict[str, Any]:
    return {
        "kind": outcome.kind,
        "seed": outcome.seed,
        "mode": outcome.mode,
        "is_collision": outcome.is_collision,
        "is_target_touched": outcome.is_target_touched,
        "is_intervention": outcome.is_intervention,
        "is_false_intervention": outcome.is_false_intervention,
        "is_eligible": outcome.is_eligible,
        "n_moves": outcome.n_moves,
        "source": outcome.source,
        "free_contact_s": _number(outcome.free.t_contact_s),
        "visible_s": _number(outcome.free.visible_s),
        "trigger_s": _number(outcome.times.trigger_s),
        "reflex_ready_s": _number(outcome.times.reflex_s),
        "command_sent_s": _number(outcome.times.command_s),
        "arm_arrived_s": _number(outcome.times.arrived_s),
        "duration_s": _number(outcome.duration_s),
    }


def _number(value: float) -> Optional[float]:
    return round(value, 6) if math.isfinite(value) else None


def _start_worker(config: ApexConfig) -> None:
    global _player
    _player = ScenePlayer(Kit.from_config(config), os.environ)


def _play(task: Task) -> SceneOutcome:
    assert _player is not None
    return _player.play(make(*task), _ignore, is_real_time=False)


def _ignore(_: Step) -> None:
    """Keep nothing of a step; the outcome is all a fast run is after."""
