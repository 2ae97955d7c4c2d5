"""What would happen with no arm: the truth that a closed-loop run is judged against."""

import math
from dataclasses import dataclass

from apex_edge.twin.scene import Scenario
from apex_edge.twin.world import TwinWorld

VISIBLE_SPEED_M_S = 0.02
SAMPLE_S = 0.01


@dataclass(frozen=True)
class FreeRun:
    """Outcome of a scene left alone.

    ``t_contact_s`` mover meets target (inf when never); ``visible_s`` for how long before that
    the mover had been seen to move (speed above 0.02 m/s; 0 when it never touches);
    ``min_gap_m`` smallest distance between the outlines of the two (inf when nobody is named).
    """

    t_contact_s: float
    visible_s: float
    min_gap_m: float


def free_run(scenario: Scenario) -> FreeRun:
    """Run a scene to its end with no arm and report on its mover and target."""
    world = TwinWorld(scenario)
    mover, target = scenario.mover, scenario.target
    if not mover or not target:
        return FreeRun(math.inf, 0.0, math.inf)
    pair = frozenset((mover, target))
    first_seen_s = math.inf
    smallest = world.gap_m(mover, target)
    while world.t_s < scenario.duration_s and pair not in world.contacts:
        if first_seen_s == math.inf and world.speed_m_s(mover) > VISIBLE_SPEED_M_S:
            first_seen_s = world.t_s
        world.step(SAMPLE_S)
        smallest = min(smallest, world.gap_m(mover, target))
        if world.is_at_rest:
            break
    if pair not in world.contacts:
        return FreeRun(math.inf, 0.0, smallest)
    t_contact_s = world.contacts[pair]
    return FreeRun(t_contact_s, max(0.0, t_contact_s - first_seen_s), min(smallest, 0.0))
