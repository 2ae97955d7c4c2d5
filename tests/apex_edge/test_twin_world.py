"""The twin's table: what rolls, slides, bumps, and stops."""

import math

import numpy as np
import pytest

from apex_edge.errors import InputError
from apex_edge.twin.contact import Body, find_contact, gap_m
from apex_edge.twin.scene import (
    GRAVITY_M_S2,
    TABLE_X_M,
    TABLE_Y_M,
    Scenario,
    SceneObject,
    straight,
)
from apex_edge.twin.world import TwinWorld

AWAY = np.array([(0.0, 0.0, 0.09), (0.0, 0.0, 0.13), (0.0, 0.0, 0.19), (0.06, 0.0, 0.18)])


def ball(name="green ball", at=(0.3, 0.0), vel=(0.0, 0.0), drag=0.008):
    return SceneObject(name, "green", "ball", 0.015, at, vel, friction=drag)


def block(name="red block", at=(0.12, 0.0), vel=(0.0, 0.0), mu=0.3, yaw=0.0, mass=0.026):
    return SceneObject(name, "red", "block", 0.0175, at, vel, yaw, mass, mu)


def world_of(*objects, hands=(), target="red block"):
    scenario = Scenario("collision", 0, objects, hands, 8.0, objects[0].name, target, True)
    return TwinWorld(scenario)


def arm_at(x, y, z=0.005):
    """Stand a vertical gripper at a point."""
    return np.array([(0.0, 0.0, 0.09), (0.4 * x, 0.4 * y, 0.15), (x, y, z + 0.09), (x, y, z)])


def place(world, name):
    return world.objects.pos_m[world.names.index(name), :2]


def test_ball_rolls_as_far_as_its_rolling_resistance_lets_it():
    world = world_of(ball(at=(0.1, 0.1), vel=(0.06, 0.0), drag=0.01))
    world.step(8.0)
    assert place(world, "green ball") == pytest.approx((0.1 + 0.06**2 / 0.02, 0.1), abs=1e-6)
    assert world.is_at_rest


def test_pushed_block_stops_by_friction_where_coulomb_says():
    world = world_of(block(at=(0.2, 0.0), vel=(0.0, 0.5), mu=0.25))
    world.step(2.0)
    way = 0.5**2 / (2.0 * 0.25 * GRAVITY_M_S2)
    assert place(world, "red block") == pytest.approx((0.2, way), abs=1e-6)
    assert world.is_at_rest


def test_ball_keeps_its_way_whatever_the_step():
    ends = []
    for dt_s in (0.002, 0.005, 0.033):
        world = world_of(ball(vel=(-0.05, 0.08)))
        while world.t_s < 1.98 - 1e-9:
            world.step(min(dt_s, 1.98 - world.t_s))
        ends.append(place(world, "green ball"))
    assert np.ptp(np.array(ends), axis=0).max() < 1e-9


def test_ball_bounces_off_the_wall_slower_and_stays_on_the_table():
    world = world_of(ball(at=(0.3, 0.37), vel=(0.0, 0.2)))
    world.step(1.0)
    vel = world.objects.vel_m_s[0]
    assert -0.1 < vel[1] < 0.0
    assert world.objects.pos_m[0, 1] <= TABLE_Y_M[1] - 0.015 + 1e-9


def test_turned_block_meets_the_wall_with_its_corner():
    yaw = math.pi / 4
    world = world_of(block(at=(0.5, 0.0), vel=(1.2, 0.0), mu=0.2, yaw=yaw))
    reached_m = []
    for _ in range(100):
        world.step(0.002)
        reached_m.append(world.objects.pos_m[0, 0] + 0.0175 * math.sqrt(2.0))
    assert max(reached_m) == pytest.approx(TABLE_X_M[1], abs=1e-9)
    assert world.objects.vel_m_s[0, 0] <= 0.0


def test_energy_never_grows_in_a_crowd():
    rng = np.random.RandomState(7)
    items = []
    for k in range(9):
        at = (0.12 + 0.12 * (k % 3), -0.12 + 0.12 * (k // 3))
        vel = tuple(rng.uniform(-0.4, 0.4, 2).tolist())
        is_ball = k % 2 == 0
        make = ball if is_ball else block
        items.append(make(name=f"item {k}", at=at, vel=vel))
    world = world_of(*items, target="item 1")
    world.set_arm(arm_at(0.18, 0.06))
    before = world.energy_j()
    n_contacts_seen = 0
    for _ in range(2000):
        world.step(0.002)
        after = world.energy_j()
        assert after <= before * (1.0 + 1e-12)
        before = after
        n_contacts_seen = len(world.contacts)
    assert n_contacts_seen >= 3


def test_momentum_passes_from_ball_to_ball():
    world = world_of(
        ball("a", (0.30, 0.0), (-0.1, 0.0), drag=1e-9),
        ball("b", (0.25, 0.0), drag=1e-9),
        target="b",
    )
    world.step(0.5)
    vel = world.objects.vel_m_s[:, 0]
    assert vel.sum() == pytest.approx(-0.1, abs=1e-6)
    assert vel[0] - vel[1] == pytest.approx(0.3 * 0.1, abs=1e-4)


def test_off_centre_hit_turns_the_block():
    world = world_of(ball(at=(0.2, 0.012), vel=(-0.5, 0.0)), block())
    world.step(1.0)
    yaw = world.objects.yaw_rad[1]
    # Struck on its left half from the front, it turns counter-clockwise seen from above.
    assert yaw > 0.01
    assert frozenset(("green ball", "red block")) in world.contacts


@pytest.mark.parametrize("yaw", [0.0, 0.3, math.pi / 4])
def test_fast_ball_does_not_pass_through_a_block(yaw):
    world = world_of(ball(at=(0.5, 0.0), vel=(-1.5, 0.0)), block(at=(0.2, 0.0), yaw=yaw))
    deepest_m = 0.0
    for _ in range(200):
        world.step(0.002)
        deepest_m = min(deepest_m, world.gap_m("green ball", "red block"))
    assert -1.5 * 0.002 <= deepest_m < 0.0
    assert world.speed_m_s("green ball") < 1.0
    assert place(world, "red block")[0] < 0.19


def test_first_contact_time_is_kept_and_named():
    world = world_of(ball(at=(0.3, 0.0), vel=(-0.1, 0.0), drag=1e-9), block())
    world.step(3.0)
    expected = (0.3 - 0.015 - 0.12 - 0.0175) / 0.1
    assert set(world.contacts) == {frozenset(("green ball", "red block"))}
    assert world.contacts[frozenset(("green ball", "red block"))] == pytest.approx(
        expected, abs=3e-3
    )


def test_arm_in_the_way_stops_the_ball():
    world = world_of(ball(at=(0.35, 0.0), vel=(-0.1, 0.0)), block())
    world.set_arm(arm_at(0.18, 0.002))
    world.step(8.0)
    assert frozenset(("green ball", "red block")) not in world.contacts
    assert "green ball" in world.arm_contacts
    assert place(world, "green ball")[0] > 0.18
    assert "red block" not in world.arm_contacts


def test_arm_takes_most_of_the_speed():
    world = world_of(ball(at=(0.30, 0.01), vel=(-0.12, 0.0)), block())
    world.set_arm(arm_at(0.2, 0.0))
    while "green ball" not in world.arm_contacts:
        before = world.speed_m_s("green ball")
        world.step(0.002)
    assert world.speed_m_s("green ball") < 0.4 * before


def test_arm_held_high_lets_the_ball_pass():
    world = world_of(ball(at=(0.35, 0.0), vel=(-0.1, 0.0)), block())
    world.set_arm(arm_at(0.2, 0.0, z=0.06))
    world.step(4.0)
    assert frozenset(("green ball", "red block")) in world.contacts
    assert not world.arm_contacts


def test_leaning_gripper_blocks_with_its_low_part_only():
    leaning = np.array([(0, 0, 0.09), (0.05, 0, 0.15), (0.10, 0, 0.10), (0.19, 0, 0.005)])
    low = world_of(ball(at=(0.165, 0.1), vel=(0.0, -0.1)), target="green ball")
    low.set_arm(leaning)
    low.step(3.0)
    assert "green ball" in low.arm_contacts
    high = world_of(ball(at=(0.12, 0.1), vel=(0.0, -0.1)), target="green ball")
    high.set_arm(leaning)
    high.step(3.0)
    assert not high.arm_contacts


def test_arm_coming_down_on_a_block_shoves_it_aside():
    world = world_of(block(at=(0.15, 0.0)))
    world.set_arm(arm_at(0.14, 0.0))
    world.step(0.5)
    assert world.arm_contacts == {"red block": pytest.approx(0.002)}
    assert place(world, "red block")[0] == pytest.approx(0.14 + 0.012 + 0.0175, abs=1e-3)


def test_arm_speed_is_the_change_of_its_pose_over_time():
    world = world_of(block())
    world.set_arm(AWAY)
    assert not world.state().arm_vel_m_s.any()
    world.step(0.01)
    world.set_arm(AWAY + (0.001, 0.0, -0.002))
    assert world.state().arm_vel_m_s == pytest.approx(np.tile((0.1, 0.0, -0.2), (4, 1)))


@pytest.mark.parametrize("points", [np.zeros((4, 2)), np.zeros(3), np.full((4, 3), np.nan)])
def test_wrong_arm_poses_are_refused(points):
    with pytest.raises(ValueError, match="arm"):
        world_of(block()).set_arm(points)


def push(end=(0.1, 0.0), start=(0.35, 0.0), span=(0.5, 4.0)):
    return straight("green block", "min-jerk", span, start, end)


def test_hand_moves_its_block_along_a_minimum_jerk_path():
    green = block("green block", (0.35, 0.0))
    world = world_of(green, hands=(push(end=(0.2, 0.0)),), target="green block")
    world.step(0.5)
    assert place(world, "green block")[0] == 0.35
    world.step(2.0)
    assert place(world, "green block")[0] == pytest.approx(0.275, abs=1e-9)
    assert world.speed_m_s("green block") == pytest.approx(1.875 * 0.15 / 4.0, rel=1e-6)
    world.step(3.0)
    assert place(world, "green block")[0] == pytest.approx(0.2, abs=1e-9)
    assert world.is_at_rest


def test_hand_gives_up_at_the_arm():
    world = world_of(block("green block", (0.35, 0.0)), block(), hands=(push(),))
    world.set_arm(arm_at(0.18, 0.0))
    world.step(8.0)
    assert frozenset(("green block", "red block")) not in world.contacts
    assert place(world, "green block")[0] == pytest.approx(0.18 + 0.012 + 0.0175, abs=2e-3)
    assert world.is_at_rest
    assert world.state().hands[0].vel_m_s == (0.0, 0.0)


def test_hand_pushes_a_light_block_but_not_a_heavy_one():
    light = world_of(block("green block", (0.35, 0.0)), block(), hands=(push(),))
    light.step(8.0)
    assert place(light, "red block")[0] < 0.09
    heavy = world_of(block("green block", (0.35, 0.0)), block(mass=0.5), hands=(push(),))
    heavy.step(8.0)
    assert place(heavy, "green block")[0] > 0.15
    assert place(heavy, "red block")[0] == pytest.approx(0.12, abs=5e-3)


def test_flicked_ball_rolls_on_with_the_speed_of_the_flick():
    hand = straight("green ball", "flick", (0.4, 0.6), (0.35, 0.0), (0.32, 0.0))
    world = world_of(ball(at=(0.35, 0.0), drag=0.01), hands=(hand,), target="green ball")
    world.step(0.3)
    assert world.speed_m_s("green ball") == 0.0
    world.step(0.9)
    assert world.speed_m_s("green ball") == pytest.approx(2 * 0.03 / 0.6 - 0.01 * 0.2, abs=1e-3)
    fingers = world.state().hands[0].pos_m[0]
    world.step(1.0)
    assert world.state().hands[0].pos_m[0] > fingers


def test_gaps_of_boxes_and_discs_are_distances_between_outlines():
    box, turned, disc = Body(True, 0.02, 1.0), Body(True, 0.02, 1.0), Body(False, 0.01, 1.0)
    turned.x = 0.1
    turned.turn_to(math.pi / 4)
    disc.x, disc.y = 0.05, 0.06
    assert gap_m(box, turned) == pytest.approx(0.1 - 0.02 - 0.02 * math.sqrt(2.0))
    assert gap_m(box, disc) == pytest.approx(math.hypot(0.03, 0.04) - 0.01)
    assert gap_m(disc, box) == gap_m(box, disc)
    assert find_contact(box, turned) is None


@pytest.mark.parametrize("first", ["disc", "box"])
@pytest.mark.parametrize("second", ["disc", "box"])
def test_contact_agrees_with_the_gap_all_around(first, second):
    rng = np.random.RandomState(3)
    n_touching = 0
    for _ in range(300):
        a, b = Body(first == "box", 0.02, 1.0), Body(second == "box", 0.015, 1.0)
        b.x, b.y = rng.uniform(-0.06, 0.06, 2).tolist()
        a.turn_to(float(rng.uniform(-3, 3)))
        b.turn_to(float(rng.uniform(-3, 3)))
        contact = find_contact(a, b)
        assert (contact is not None) == (gap_m(a, b) < 0.0)
        if contact is None:
            continue
        n_touching += 1
        nx, ny, depth = contact[:3]
        assert math.hypot(nx, ny) == pytest.approx(1.0)
        b.x, b.y = b.x + nx * (depth + 1e-9), b.y + ny * (depth + 1e-9)
        assert gap_m(a, b) >= -1e-6
    assert n_touching > 20


def test_unknown_object_is_a_clear_error():
    with pytest.raises(InputError, match="no object 'blue block'; it has red block"):
        world_of(block()).gap_m("red block", "blue block")


def test_same_calls_give_the_same_world():
    ends = []
    for _ in range(2):
        world = world_of(ball(vel=(-0.2, 0.01)), block("blue", (0.2, 0.01)), block(), target="blue")
        for _ in range(400):
            world.step(0.005)
        ends.append(world.objects.pos_m.tobytes())
    assert ends[0] == ends[1]


def test_table_is_where_the_contract_says():
    assert TABLE_X_M == (-0.05, 0.55)
    assert TABLE_Y_M == (-0.40, 0.40)
