"""Kernel and stepped Euler find the same outcomes, and those that the definition says."""

import gc
import tracemalloc

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from simulate_cases import by_hand, candidates, problem, random_blockers, random_problem

from apex_edge import plugins
from apex_edge.errors import InputError
from apex_edge.simulate.base import PhysicsSim
from apex_edge.simulate.euler import EulerSim
from apex_edge.simulate.kernel import KernelSim
from apex_edge.simulate.problem import NEVER

BACK_ENDS = [KernelSim, EulerSim]
STEPS = ("collision_step", "blocked_step", "enter_step")
METRES = (
    "min_distance_m",
    "final_distance_m",
    "landing_gap_m",
    "offset_ratio",
    "deflected_gap_m",
)


def assert_same(left, right):
    for name in STEPS:
        np.testing.assert_array_equal(getattr(left, name), getattr(right, name), err_msg=name)
    for name in METRES:
        np.testing.assert_allclose(
            getattr(left, name), getattr(right, name), rtol=0.0, atol=1e-9, err_msg=name
        )
    assert left.free_collision_step == right.free_collision_step


@pytest.mark.parametrize("kind", range(4))
def test_both_back_ends_agree_on_random_scenes(kind):
    rng = np.random.default_rng(kind)
    kernel, euler = KernelSim(), EulerSim()
    n_blocked = n_collided = 0
    for _ in range(60):
        scene = random_problem(rng, kind)
        xy, arrival_s = random_blockers(rng, scene, 150)
        found = kernel.outcomes(scene, xy, arrival_s)
        assert_same(found, euler.outcomes(scene, xy, arrival_s))
        n_blocked += int((found.blocked_step != NEVER).sum())
        n_collided += int((found.collision_step != NEVER).sum())
    assert n_blocked > 200
    assert n_collided > 200


ROUND = st.integers(-20, 20).map(lambda i: i / 100.0)
PAIR = st.tuples(ROUND, ROUND)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    start=PAIR,
    velocity=PAIR,
    acceleration=PAIR,
    target=PAIR,
    target_velocity=st.sampled_from([(0.0, 0.0), (0.05, 0.0), (-0.1, 0.02)]),
    tips=st.lists(PAIR, min_size=1, max_size=12),
    late=st.integers(0, 40).map(lambda i: i / 10.0),
)
def test_both_back_ends_agree_on_round_numbers(
    start, velocity, acceleration, target, target_velocity, tips, late
):
    # Round numbers put contacts exactly on the edge and stops exactly on a step.
    scene = problem(
        mover_pos_m=(*start, 0.0),
        mover_vel_m_s=(*velocity, 0.0),
        mover_acc_m_s2=(*acceleration, 0.0),
        target_pos_m=(*target, 0.0),
        target_vel_m_s=(*target_velocity, 0.0),
        tip_radius_m=0.015,
        dt_s=0.05,
    )
    xy, arrival_s = np.array(tips), np.full(len(tips), late)
    assert_same(
        KernelSim().outcomes(scene, xy, arrival_s), EulerSim().outcomes(scene, xy, arrival_s)
    )


@pytest.mark.parametrize("back_end", BACK_ENDS)
@pytest.mark.parametrize("kind", range(4))
def test_a_back_end_does_what_the_definition_says(back_end, kind):
    rng = np.random.default_rng(100 + kind)
    for _ in range(12):
        scene = random_problem(rng, kind)
        xy, arrival_s = random_blockers(rng, scene, 12)
        found = back_end().outcomes(scene, xy, arrival_s)
        for i in range(len(xy)):
            for name, expected in by_hand(scene, xy[i], arrival_s[i]).items():
                assert getattr(found, name)[i] == pytest.approx(expected, abs=1e-9), name


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_both_give_the_same_safe_set_score_and_best(back_end):
    rng = np.random.default_rng(5)
    n_safe = 0
    for kind in (0, 1, 2, 0, 0, 2):
        scene = random_problem(rng, kind)
        xy, arrival_s = random_blockers(rng, scene, 200)
        grid = candidates(*xy)
        left = KernelSim().rollout(scene, grid, arrival_s)
        right = back_end().rollout(scene, grid, arrival_s)
        np.testing.assert_array_equal(left.is_safe, right.is_safe)
        np.testing.assert_array_equal(left.best, right.best)
        np.testing.assert_allclose(left.score, right.score, rtol=0.0, atol=1e-7)
        n_safe += int(left.is_safe.sum())
    assert n_safe > 10


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_head_on_ball_hits_after_the_time_that_arithmetic_gives(back_end):
    found = back_end().rollout(problem(), candidates((0.3, 0.3)), np.array([0.0]))
    # 0.2 m - 2 * 0.015 m at 0.1 m/s
    assert found.t_free_collision_s == pytest.approx(1.7)
    assert found.is_collision[0]
    assert found.t_collision_s[0] == pytest.approx(1.7)
    assert found.min_distance_m[0] == pytest.approx(0.03)
    assert not found.is_blocked[0]


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_blocker_in_time_stops_the_ball_where_they_touch(back_end):
    found = back_end().rollout(problem(), candidates((0.1, 0.0)), np.array([0.5]))
    # contact at 0.1 + 0.015 + 0.012 = 0.127 m, after 0.73 s
    assert found.is_blocked[0]
    assert not found.is_collision[0]
    assert found.t_blocked_s[0] == pytest.approx(0.73)
    assert found.final_distance_m[0] == pytest.approx(0.127)
    assert found.slack_s[0] == pytest.approx(0.23)
    assert found.t_free_collision_s == pytest.approx(1.7)


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_ball_hit_off_the_middle_glides_off_square_to_the_line_of_centres(back_end):
    # tip + ball 0.027: 0.0135 below the path is half of it, so the ball glides off 60 degrees up
    scene = problem(target_pos_m=(0.05, 0.08, 0.0))
    found = back_end().outcomes(scene, np.array([[0.1, -0.0135]]), np.zeros(1))
    place = scene.mover_pos_m[0] - 0.1 * 0.01 * found.blocked_step[0]
    assert found.offset_ratio[0] == pytest.approx(0.5)
    away = np.array([0.05 - place, 0.08])
    across = np.array([place - 0.1, 0.0135])  # from tip to ball
    expected = abs(away @ across) / np.hypot(*across) - scene.contact_m
    assert found.deflected_gap_m[0] == pytest.approx(expected)


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_ball_hit_in_the_middle_stays_where_it_is(back_end):
    found = back_end().outcomes(problem(), np.array([[0.1, 0.0]]), np.zeros(1))
    assert found.deflected_gap_m[0] == pytest.approx(0.127 - 0.03)


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_braking_ball_that_stops_short_does_not_collide(back_end):
    # 0.1 m/s against 0.05 m/s2: it rolls about 0.1 m and stands 0.1 m before the target.
    scene = problem(mover_acc_m_s2=(0.05, 0.0, 0.0))
    found = back_end().rollout(scene, candidates((0.3, 0.3)), np.array([0.0]))
    assert found.t_free_collision_s == np.inf
    assert not found.is_collision[0]
    assert found.final_distance_m[0] == pytest.approx(0.1, abs=0.001)
    assert found.min_distance_m[0] == found.final_distance_m[0]  # it never rolls back


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_target_that_moves_into_the_path_is_hit(back_end):
    scene = problem(target_pos_m=(0.1, -0.2, 0.0), target_vel_m_s=(0.0, 0.2, 0.0))
    found = back_end().rollout(scene, candidates((0.3, 0.3)), np.array([0.0]))
    assert 0.8 < found.t_free_collision_s < 1.0


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_target_that_runs_into_the_stopped_ball_is_a_collision(back_end):
    scene = problem(target_vel_m_s=(0.05, 0.0, 0.0))
    found = back_end().rollout(scene, candidates((0.15, 0.0)), np.array([0.0]))
    assert found.is_blocked[0]
    assert found.is_collision[0]
    assert found.t_collision_s[0] > found.t_blocked_s[0]
    assert not found.is_safe[0]


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_mover_and_target_that_touch_already_collide_at_once(back_end):
    scene = problem(mover_pos_m=(0.02, 0.0, 0.0))
    found = back_end().rollout(scene, candidates((0.0, 0.1), (0.02, 0.0)), np.zeros(2))
    assert found.t_free_collision_s == 0.0
    assert found.is_collision.all()
    assert not found.is_safe.any()


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_no_candidates_at_all_give_an_empty_outcome_and_the_free_collision(back_end):
    found = back_end().rollout(problem(), candidates(), np.zeros(0))
    assert found.t_free_collision_s == pytest.approx(1.7)
    assert len(found.is_safe) == len(found.best) == 0


@pytest.mark.parametrize("back_end", BACK_ENDS)
@pytest.mark.parametrize("arrival_s", [[0.1], [0.1, np.nan], [0.1, -0.5]])
def test_a_wrong_arrival_time_is_a_typed_error(back_end, arrival_s):
    with pytest.raises(InputError, match="arrival_s"):
        back_end().rollout(problem(), candidates((0.1, 0.0), (0.1, 0.1)), np.array(arrival_s))


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_a_tip_that_is_not_finite_is_a_typed_error(back_end):
    with pytest.raises(InputError, match="tip_m"):
        back_end().rollout(problem(), candidates((0.1, np.nan)), np.zeros(1))


@pytest.mark.parametrize("back_end", BACK_ENDS)
def test_memory_does_not_grow_from_call_to_call(back_end):
    rng = np.random.default_rng(9)
    scene = random_problem(rng, 1)
    xy, arrival_s = random_blockers(rng, scene, 1412)
    grid, simulator = candidates(*xy), back_end()
    for _ in range(2):
        simulator.rollout(scene, grid, arrival_s)
    tracemalloc.start()
    simulator.rollout(scene, grid, arrival_s)
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(5):
        simulator.rollout(scene, grid, arrival_s)
    gc.collect()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 8192  # one array (1412,) of doubles alone is 11 kB


def test_the_stepped_form_gives_results_that_the_next_call_leaves_alone():
    simulator, arrival_s = EulerSim(), np.array([0.0])
    first = simulator.outcomes(problem(), np.array([[0.1, 0.0]]), arrival_s)
    kept = first.final_distance_m.copy()
    simulator.outcomes(problem(), np.array([[0.3, 0.3]]), arrival_s)
    np.testing.assert_array_equal(first.final_distance_m, kept)


@pytest.mark.parametrize("name, kind", [("kernel", KernelSim), ("euler", EulerSim)])
def test_the_back_ends_are_found_by_name(name, kind):
    found = plugins.load("simulators", name)
    assert found is kind
    assert isinstance(found(), PhysicsSim)
