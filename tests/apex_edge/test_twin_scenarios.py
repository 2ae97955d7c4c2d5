"""Scenes keep the promise of their kind, for every seed."""

import math
from functools import lru_cache

import numpy as np
import pytest

from apex_edge.errors import InputError
from apex_edge.twin.palette import PALETTE
from apex_edge.twin.scenarios import KINDS, make
from apex_edge.twin.scene import TABLE_X_M, TABLE_Y_M, HandMotion
from apex_edge.twin.truth import free_run
from apex_edge.twin.view import is_in_view, twin_camera_model
from apex_edge.twin.world import TwinWorld

SEEDS = range(1, 51)
FEW_SEEDS = range(1, 21)
scene = lru_cache(maxsize=None)(make)
outcome = lru_cache(maxsize=None)(free_run)
TIP_RADIUS_M = 0.012


@pytest.mark.parametrize(("kind", "is_seen_in_time"), [("collision", True), ("late-start", False)])
def test_colliding_scenes_touch_and_are_seen_in_time_or_late_as_promised(kind, is_seen_in_time):
    runs = [outcome(scene(kind, seed)) for seed in SEEDS]
    assert all(2.0 <= run.t_contact_s <= 6.5 for run in runs)
    assert all((run.visible_s >= 1.5) is is_seen_in_time for run in runs)
    assert all(run.min_gap_m <= 0.0 for run in runs)


def test_collision_scenes_leave_room_for_the_arm_before_contact():
    for seed in SEEDS:
        scenario = scene("collision", seed)
        world = TwinWorld(scenario)
        red = scenario.find(scenario.target)
        pair = frozenset((scenario.mover, scenario.target))
        has_room = False
        while pair not in world.contacts:
            world.step(0.02)
            at = world.objects.pos_m[world.names.index(scenario.mover), :2]
            free_m = world.gap_m(scenario.mover, scenario.target)
            to_red = np.array(red.pos_m) - at
            ahead = at + to_red / np.linalg.norm(to_red) * (red.radius_m + 0.5 * free_m)
            radius, yaw = math.hypot(*ahead), math.atan2(ahead[1], ahead[0])
            is_reachable = 0.08 <= radius <= 0.198 and abs(yaw) <= math.pi / 2
            has_room = has_room or (is_reachable and free_m >= 2 * TIP_RADIUS_M + 0.01)
        assert has_room, seed


def test_collision_scenes_mix_balls_and_pushed_blocks():
    movers = [scene("collision", seed).mover for seed in SEEDS]
    assert 20 <= movers.count("green ball") <= 40
    assert movers.count("green ball") + movers.count("green block") == len(movers)


def test_nothing_moves_in_no_moving_scenes():
    n_hands = 0
    for seed in SEEDS:
        scenario = scene("no-moving", seed)
        world = TwinWorld(scenario)
        before = world.objects.pos_m
        n_hands += len(scenario.hands)
        assert world.is_at_rest
        world.step(1.0)
        assert np.array_equal(world.objects.pos_m, before)
        assert not scenario.is_collision
        assert math.isinf(outcome(scenario).t_contact_s)
    assert 5 < n_hands < 45


def test_near_misses_come_near_and_never_touch():
    gaps = []
    for seed in FEW_SEEDS:
        scenario = scene("near-miss", seed)
        world = TwinWorld(scenario)
        world.step(scenario.duration_s)
        assert not world.contacts, seed
        gaps.append(outcome(scenario).min_gap_m)
    assert min(gaps) >= 0.008
    assert max(gaps) <= 0.060


def test_near_misses_pass_stop_short_and_turn_away():
    styles = set()
    for seed in FEW_SEEDS:
        scenario = scene("near-miss", seed)
        hand = scenario.hand_of(scenario.mover)
        styles.add("ball" if hand is None or hand.profile == "flick" else _style(hand, scenario))
    assert styles == {"ball", "pass", "short", "turn"}


def _style(hand: HandMotion, scenario) -> str:
    middle = 0.5 * (np.array(hand.start_m) + hand.end_m)
    if np.linalg.norm(middle - hand.via_m) > 0.01:
        return "turn"
    red = np.array(scenario.find("red block").pos_m)
    way = np.array(hand.end_m) - hand.start_m
    return "short" if (red - hand.end_m) @ way > 0.0 else "pass"


def test_implicit_scenes_drive_a_car_to_a_child_in_about_five_seconds():
    for seed in FEW_SEEDS:
        scenario = scene("implicit", seed)
        run = outcome(scenario)
        assert scenario.mode == "wait_until_deadline"
        assert (scenario.mover, scenario.target) == ("green car", "red child")
        assert 4.5 <= run.t_contact_s <= 6.4
        assert run.visible_s >= 4.0


def test_many_scenes_hold_six_to_twelve_objects_and_tell_the_truth():
    outcomes = set()
    for seed in FEW_SEEDS:
        scenario = scene("many", seed)
        assert 6 <= len(scenario.objects) <= 12
        assert len({item.colour for item in scenario.objects}) >= 3
        outcomes.add(scenario.is_collision)
        assert math.isfinite(outcome(scenario).t_contact_s) == scenario.is_collision
    assert outcomes == {True, False}


@pytest.mark.parametrize("kind", KINDS)
def test_every_scene_starts_on_the_table_in_view_and_apart(kind):
    camera = twin_camera_model()
    for seed in FEW_SEEDS:
        scenario = scene(kind, seed)
        names = [item.name for item in scenario.objects]
        assert len(set(names)) == len(names)
        assert [item.colour for item in scenario.objects].count("red") == 1
        world = TwinWorld(scenario)
        for i, item in enumerate(scenario.objects):
            assert item.colour in PALETTE
            assert TABLE_X_M[0] < item.pos_m[0] < TABLE_X_M[1]
            assert TABLE_Y_M[0] < item.pos_m[1] < TABLE_Y_M[1]
            centre = np.array([(*item.pos_m, item.radius_m)])
            assert is_in_view(camera, centre, item.radius_m)
            assert all(world.gap_m(item.name, other) > 0.005 for other in names[:i])
        target = scenario.find(scenario.target)
        assert 0.085 <= math.hypot(*target.pos_m) <= 0.11
        assert abs(math.degrees(math.atan2(target.pos_m[1], target.pos_m[0]))) <= 55.0


@pytest.mark.parametrize("kind", KINDS)
def test_same_seed_same_scene_and_other_seed_other_scene(kind):
    assert make(kind, 11) == scene(kind, 11)
    assert scene(kind, 11).objects != scene(kind, 12).objects


def test_scene_numbers_are_frozen():
    # RandomState streams never change, so these hold on every numpy.
    scenario = scene("collision", 1)
    assert scenario.find("red block").pos_m == pytest.approx(RED_1, abs=1e-12)
    assert outcome(scenario).t_contact_s == pytest.approx(CONTACT_1, abs=1e-6)


def test_unknown_kind_and_negative_seed_are_refused():
    with pytest.raises(InputError, match="unknown scene kind 'crash'; known: collision"):
        make("crash", 1)
    with pytest.raises(InputError, match="0 or more"):
        make("collision", -1)


RED_1 = (0.06707351305672432, -0.06114470743824185)
CONTACT_1 = 4.406
