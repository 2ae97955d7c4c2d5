"""Which simulated interventions are safe, and which of the safe ones is better.

A candidate is safe when, on the expected path, the arm stands there ``min_slack_s`` before the
mover comes, stops it (not a glancing hit), mover and target never touch (nor would they, by
``clearance_m``, if the mover glided off the tip), and the arm keeps ``clearance_m`` from the
target, from all other objects and, when it lands, from the mover.

The score of a safe candidate, 0 to 1, is a weighted mean of (weights in ``WEIGHTS``)

* ``block``: the part of the pessimistic paths (left, right, fast) on which it is still no
  collision: it stops the mover there too, or that path misses the target anyway;
* ``slack``: the least slack over the expected and the pessimistic paths, full at 0.5 s;
* ``central``: 1 for a hit through the middle, 0 at the glance limit; a ball hit off the middle is
  deflected rather than stopped;
* ``distance``: final gap between mover and target, full at 0.1 m (the paper's only criterion);
* ``clearance``: gap of the tip beyond the least one, full at 0.02 m.

Source: descriptors from APEX section "Simulate"; the rule and the score are ours.
"""

from dataclasses import dataclass
from typing import Callable, List, Mapping, Optional, Tuple

import numpy as np

from apex_edge.simulate.problem import (
    CONTACT_EPS_M,
    NEVER,
    ArmCandidates,
    Outcomes,
    RolloutProblem,
    hypotheses,
)
from apex_edge.types import Array, Candidates, Rollouts

WEIGHTS: Mapping[str, float] = {
    "block": 0.40,
    "slack": 0.20,
    "central": 0.25,
    "distance": 0.10,
    "clearance": 0.05,
}
FULL_SLACK_S, FULL_DISTANCE_M, FULL_CLEARANCE_M = 0.5, 0.1, 0.02
# The paper shows its five best points; neighbours say the same, so ours stand this far apart.
N_BEST, BEST_SPACING_M = 5, 0.012

Simulator = Callable[[RolloutProblem, Array, Array], Outcomes]


@dataclass(frozen=True)
class _Case:
    """The safe candidates of one problem, with what is known of them on the expected path; (n,)."""

    tips_m: Array
    arrival_s: Array
    slack_s: Array
    clearance_m: Array
    final_distance_m: Array
    offset_ratio: Array


def judge(
    simulate: Simulator, problem: RolloutProblem, candidates: Candidates, arrival_s: Array
) -> Rollouts:
    """Roll out n candidates, mark the safe ones, score them and pick the best few."""
    tips = np.asarray(candidates.tip_m, dtype=np.float64)
    found = simulate(problem, tips[:, :2], arrival_s)
    clearance = clearance_m(problem, candidates, arrival_s, found)
    slack = slack_s(found, problem, arrival_s)
    is_safe = safe(problem, found, slack, clearance)
    score = np.full(len(tips), -np.inf)
    rows = np.flatnonzero(is_safe)
    if len(rows):
        columns = (tips, arrival_s, slack, clearance, found.final_distance_m, found.offset_ratio)
        score[rows] = _score(simulate, problem, _Case(*(c[rows] for c in columns)))
    return Rollouts(
        seq=problem.seq,
        t_s=problem.t_s,
        candidates=candidates,
        mover_id=problem.mover_id,
        target_id=problem.target_id,
        t_free_collision_s=float(_times_s(np.array(found.free_collision_step), problem)),
        arrival_s=arrival_s,
        is_collision=found.collision_step != NEVER,
        is_blocked=found.blocked_step != NEVER,
        t_blocked_s=_times_s(found.blocked_step, problem),
        t_collision_s=_times_s(found.collision_step, problem),
        min_distance_m=found.min_distance_m,
        t_min_s=found.min_step * problem.dt_s,
        final_distance_m=found.final_distance_m,
        slack_s=slack,
        clearance_m=clearance,
        is_safe=is_safe,
        score=score,
        best=_spread_best(tips, score),
    )


def slack_s(found: Outcomes, problem: RolloutProblem, arrival_s: Array) -> Array:
    """Return how long (n,) the arm stands before the mover comes; -inf if it never comes there."""
    is_met = found.enter_step != NEVER
    # a late arm has a negative slack; one that never arrives has -inf as well
    result: Array = np.where(is_met, found.enter_step * problem.dt_s - arrival_s, -np.inf)
    return result


def clearance_m(
    problem: RolloutProblem, candidates: Candidates, arrival_s: Array, found: Outcomes
) -> Array:
    """Return the least gap (n,) between the arm and what it must not touch, edge to edge.

    The target counts from the arm's arrival to the horizon along its own motion, the other objects
    where they are now, the mover where it is when the tip comes down. The arm is its tip and, with
    ``ArmCandidates``, the part of the hand that is lower than the object is high; balls and cubes
    are as high as they are wide.
    """
    tips = candidates.tip_m[:, :2]
    target, velocity = problem.target_pos_m[:2], problem.target_vel_m_s[:2]
    speed2 = float(velocity @ velocity)
    lean = _lean(candidates, 2.0 * problem.target_radius_m)
    gap = found.landing_gap_m
    # A moving target is taken where it is nearest to the tip, and to the end of the low hand.
    for end in [tips] if lean is None or speed2 == 0.0 else [tips, tips + lean]:
        place = target
        if speed2 > 0.0:
            since_s = np.minimum(arrival_s, problem.horizon_s)
            nearest_s = np.clip((end - target) @ velocity / speed2, since_s, problem.horizon_s)
            place = target + nearest_s[:, None] * velocity
        away = _to_segments(place, tips, lean)
        gap = np.minimum(gap, away - problem.target_radius_m - problem.tip_radius_m)
    for obstacle, radius in zip(problem.obstacle_pos_m, problem.obstacle_radius_m):
        away = _to_segments(obstacle[:2], tips, _lean(candidates, 2.0 * float(radius)))
        gap = np.minimum(gap, away - radius - problem.tip_radius_m)
    return gap


def _lean(candidates: Candidates, height_m: float) -> Optional[Array]:
    """Return the way (n, 2) on the table from the tip to where the hand rises over a height."""
    if not isinstance(candidates, ArmCandidates):
        return None
    hand = candidates.wrist_m - candidates.tip_m
    share = (height_m - candidates.tip_m[:, 2]) / np.maximum(hand[:, 2], 1e-6)
    lean: Array = hand[:, :2] * np.clip(share, 0.0, 1.0)[:, None]
    return lean


def _to_segments(point: Array, start: Array, span: Optional[Array]) -> Array:
    """Return the distances (n,) from points (2,) or (n, 2) to the segments start + [0, 1] span."""
    x, y = point[..., 0] - start[:, 0], point[..., 1] - start[:, 1]
    if span is not None:
        length2 = np.maximum(span[:, 0] * span[:, 0] + span[:, 1] * span[:, 1], 1e-12)
        share = np.clip((x * span[:, 0] + y * span[:, 1]) / length2, 0.0, 1.0)
        x, y = x - share * span[:, 0], y - share * span[:, 1]
    result: Array = np.hypot(x, y)
    return result


def safe(problem: RolloutProblem, found: Outcomes, slack: Array, clearance: Array) -> Array:
    """Return which candidates (n,) are safe on the expected path; see the module."""
    is_safe: Array = (
        (found.blocked_step != NEVER)
        & (found.collision_step == NEVER)
        & (found.offset_ratio <= problem.glance_ratio + CONTACT_EPS_M)
        & (found.deflected_gap_m >= problem.clearance_m - CONTACT_EPS_M)
        & (slack >= problem.min_slack_s - CONTACT_EPS_M)
        & (clearance >= problem.clearance_m - CONTACT_EPS_M)
    )
    return is_safe


def _score(simulate: Simulator, problem: RolloutProblem, case: _Case) -> Array:
    """Score the safe candidates; see the module."""
    least_slack = case.slack_s
    n_held = np.zeros(len(case.slack_s))
    variants = hypotheses(problem)
    for variant in variants:
        found = simulate(variant, case.tips_m[:, :2], case.arrival_s)
        is_held, slack = _holds(found, variant, case.arrival_s)
        n_held += is_held
        least_slack = np.minimum(least_slack, slack)
    gap = case.final_distance_m - problem.contact_m
    spare = case.clearance_m - problem.clearance_m
    parts = {
        "block": n_held / len(variants) if variants else np.ones(len(n_held)),
        "slack": np.clip(least_slack / FULL_SLACK_S, 0.0, 1.0),
        "central": np.clip(1.0 - case.offset_ratio / problem.glance_ratio, 0.0, 1.0),
        "distance": np.clip(gap / FULL_DISTANCE_M, 0.0, 1.0),
        "clearance": np.clip(spare / FULL_CLEARANCE_M, 0.0, 1.0),
    }
    total: Array = np.zeros(len(n_held))
    for name, weight in WEIGHTS.items():
        total += weight * parts[name]
    return total


def _holds(found: Outcomes, variant: RolloutProblem, arrival_s: Array) -> Tuple[Array, Array]:
    """Say on which candidates (n,) a pessimistic path does no harm, and with what slack.

    The slack of a candidate which such a path does not need, because it misses the target, is inf.
    """
    is_hit = found.collision_step != NEVER
    slack = slack_s(found, variant, arrival_s)
    is_stopped = (found.blocked_step != NEVER) & (slack >= 0.0)
    is_stopped &= (found.offset_ratio <= variant.glance_ratio) & (found.deflected_gap_m > 0.0)
    if found.free_collision_step == NEVER:
        is_landed_on = (found.landing_gap_m < 0.0) & ~is_stopped
        return ~is_hit & ~is_landed_on, np.full(len(slack), np.inf)
    return ~is_hit & is_stopped, slack


def _times_s(step: Array, problem: RolloutProblem) -> Array:
    result: Array = np.where(step == NEVER, np.inf, step * problem.dt_s)
    return result


def _spread_best(tips_m: Array, score: Array) -> Array:
    """Return up to N_BEST indices of finite scores, best first, apart where there is a choice."""
    rows = np.flatnonzero(score > -np.inf)
    rows = rows[np.argsort(-score[rows], kind="stable")]
    x, y = tips_m[rows, 0], tips_m[rows, 1]
    is_apart = np.ones(len(rows), dtype=bool)
    chosen: List[int] = []
    while len(chosen) < N_BEST and is_apart.any():
        place = int(np.argmax(is_apart))
        chosen.append(place)
        is_apart &= np.hypot(x - x[place], y - y[place]) >= BEST_SPACING_M
        is_apart[place] = False
    rest = [place for place in range(min(N_BEST, len(rows))) if place not in chosen]
    chosen += rest[: N_BEST - len(chosen)]  # too few are apart: fill up with the next best
    best: Array = rows[np.sort(np.array(chosen, dtype=np.int64))]
    return best
