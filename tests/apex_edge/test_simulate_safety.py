"""What counts as a safe intervention, which one is better, and what is taken from the tracks."""

import dataclasses

import numpy as np
import pytest
from simulate_cases import candidates, problem, tracks

from apex_edge.config import structure
from apex_edge.errors import ConfigError, InputError
from apex_edge.simulate.base import SimulateConfig, problem_from
from apex_edge.simulate.kernel import KernelSim
from apex_edge.simulate.problem import ArmCandidates, hypotheses
from apex_edge.types import TrackStatus

# sd 1 mm and 1 cm/s: what a ball that was followed for a few frames has
SEEN = np.diag([1e-6] * 3 + [1e-4] * 3)


def roll(scene, points, arrival_s=0.0):
    return KernelSim().rollout(scene, candidates(*points), np.full(len(points), arrival_s))


def test_a_central_blocker_in_good_time_is_safe():
    found = roll(problem(), [(0.1, 0.0)])
    assert found.is_safe.tolist() == [True]
    assert found.best.tolist() == [0]


@pytest.mark.parametrize("arrival_s", [np.inf, 3.0, 0.7])
def test_a_point_the_arm_cannot_reach_in_time_is_not_safe(arrival_s):
    # The ball is at the blocker after 0.73 s; 0.7 leaves less than the least slack.
    found = roll(problem(), [(0.1, 0.0)], arrival_s)
    assert not found.is_safe[0]
    assert found.score[0] == -np.inf
    assert len(found.best) == 0


def test_a_late_arm_is_told_how_late():
    found = roll(problem(), [(0.1, 0.0)], 1.5)
    assert found.slack_s[0] == pytest.approx(-0.77)
    assert found.is_collision[0]


def test_landing_on_the_mover_is_not_safe():
    found = roll(problem(), [(0.1, 0.0), (0.19, 0.0)], 0.95)
    # after 0.95 s the ball is at 0.105: the first tip would come down on it
    assert found.clearance_m[0] < 0.0
    assert not found.is_safe.any()


def test_landing_next_to_the_mover_keeps_the_clearance():
    scene = problem(min_slack_s=0.0)
    near, far = roll(scene, [(0.1, 0.0)], 0.70), roll(scene, [(0.1, 0.0)], 0.60)
    assert near.clearance_m[0] == pytest.approx(0.003)
    assert not near.is_safe[0]
    assert far.is_safe[0]


def test_a_glancing_hit_is_not_safe_though_it_touches():
    # tip + mover radius 0.027: 0.6 of it is 0.0162
    found = roll(problem(), [(0.1, 0.016), (0.1, 0.0165), (0.1, -0.0165)])
    assert found.is_blocked.all()
    assert found.is_safe.tolist() == [True, False, False]


def test_the_tip_keeps_its_distance_from_the_target():
    scene = problem()
    at = scene.target_radius_m + scene.tip_radius_m + scene.clearance_m
    found = roll(scene, [(at + 0.001, 0.0), (at - 0.001, 0.0)])
    assert found.is_safe.tolist() == [True, False]


def test_the_tip_keeps_its_distance_from_a_target_that_will_come_there():
    scene = problem(target_vel_m_s=(0.0, 0.05, 0.0), target_pos_m=(0.1, -0.1, 0.0))
    found = roll(scene, [(0.15, 0.0), (0.1, 0.0)])
    assert found.clearance_m[0] == pytest.approx(0.05 - 0.027)
    assert found.clearance_m[1] < 0.0


def test_the_tip_keeps_its_distance_from_other_objects():
    scene = problem(obstacle_pos_m=np.array([[0.1, 0.03, 0.0]]), obstacle_radius_m=np.array([0.02]))
    found = roll(scene, [(0.1, 0.0), (0.15, 0.0)])
    assert found.is_blocked.all()
    assert found.is_safe.tolist() == [False, True]


def test_a_hit_that_would_deflect_the_mover_into_the_target_is_not_safe():
    # Both tips meet the ball off the middle; only the first sends it up, where the target is.
    scene = problem(target_pos_m=(0.12, 0.06, 0.0), mover_vel_m_s=(-0.1, 0.01, 0.0))
    found = roll(scene, [(0.12, -0.006), (0.12, 0.02)])
    assert found.is_blocked.all()
    assert not found.is_collision.any()
    assert (found.clearance_m > scene.clearance_m).all()
    assert found.is_safe.tolist() == [False, True]


def leaning(wrist, *xy):
    """Candidates whose wrist is up at (x, y, z) for every tip."""
    plain = candidates(*xy)
    wrists = np.tile(np.array(wrist, dtype=np.float64), (len(xy), 1))
    return ArmCandidates(plain.version, plain.tip_m, plain.joints_rad, plain.hover_rad, wrists)


def test_a_hand_that_hangs_low_over_the_target_is_not_safe():
    # 0.03 m high target; the hand comes in from the base behind it, at 45 degrees
    low = leaning((0.02, 0.0, 0.085), (0.1, 0.0))
    high = leaning((0.1, 0.0, 0.085), (0.1, 0.0))
    scene = problem(target_pos_m=(0.05, 0.0, 0.0))
    over, upright = (KernelSim().rollout(scene, grid, np.zeros(1)) for grid in (low, high))
    assert upright.clearance_m[0] == pytest.approx(0.05 - 0.027)
    # at 0.03 m height the hand is 0.025 m nearer to the base than the tip
    assert over.clearance_m[0] == pytest.approx(0.025 - 0.027)
    assert upright.is_safe[0]
    assert not over.is_safe[0]


def test_a_hand_passes_over_an_object_lower_than_itself():
    grid = leaning((0.02, 0.0, 0.085), (0.1, 0.0))
    flat = problem(obstacle_pos_m=np.array([[0.05, 0.0, 0.0]]), obstacle_radius_m=np.array([0.004]))
    tall = problem(obstacle_pos_m=np.array([[0.05, 0.0, 0.0]]), obstacle_radius_m=np.array([0.03]))
    found = [KernelSim().rollout(scene, grid, np.zeros(1)) for scene in (flat, tall)]
    assert found[0].is_safe[0]
    assert found[1].clearance_m[0] < 0.0


def test_a_target_that_comes_under_the_hand_counts_though_it_stays_off_the_tip():
    grid = leaning((0.02, 0.0, 0.045), (0.1, 0.0))
    scene = problem(target_pos_m=(0.06, -0.1, 0.0), target_vel_m_s=(0.0, 0.05, 0.0))
    found = KernelSim().rollout(scene, grid, np.zeros(1))
    assert found.clearance_m[0] < 0.0


def test_a_central_hit_scores_higher_than_one_off_the_middle():
    found = roll(problem(mover_cov=SEEN), [(0.1, 0.0), (0.1, 0.008), (0.1, 0.014)])
    assert found.is_safe.all()
    assert found.score[0] > found.score[1] > found.score[2]


def test_more_slack_scores_higher_until_half_a_second():
    scores = [roll(problem(), [(0.1, 0.0)], late).score[0] for late in (0.6, 0.4, 0.2, 0.1)]
    assert scores[0] < scores[1] < scores[2]
    assert scores[2] == scores[3]


def test_a_point_that_holds_on_every_pessimistic_path_scores_higher():
    # Sideways drift grows with the way rolled: late points are only grazed by the outer paths.
    spread = np.diag([1e-6] * 3 + [9e-5] * 3)
    points = [(0.12, 0.0), (0.06, 0.0)]
    found = roll(problem(mover_cov=spread, target_radius_m=0.03), points)
    certain = roll(problem(target_radius_m=0.03), points)
    assert found.is_safe.all()
    assert found.score[0] > found.score[1] + 0.2
    assert certain.score[1] > found.score[1] + 0.2


def test_a_pessimistic_path_that_misses_the_target_needs_no_blocker():
    # The same spread against a small target: the outer paths pass it by.
    spread = np.diag([1e-6] * 3 + [9e-5] * 3)
    found = roll(problem(mover_cov=spread), [(0.06, 0.0)])
    certain = roll(problem(), [(0.06, 0.0)])
    assert found.score[0] == pytest.approx(certain.score[0])


def test_scores_lie_between_zero_and_one():
    xs = np.linspace(0.03, 0.19, 200)
    found = roll(problem(mover_cov=SEEN), [(x, 0.002) for x in xs], 0.2)
    good = found.score[found.is_safe]
    assert len(good) > 20
    assert ((good >= 0.0) & (good <= 1.0)).all()


def test_the_best_are_five_safe_points_apart_best_first():
    xs = np.linspace(0.05, 0.15, 101)
    found = roll(problem(mover_cov=SEEN), [(x, 0.0) for x in xs])
    assert len(found.best) == 5
    assert found.is_safe[found.best].all()
    assert found.best[0] == np.argmax(found.score)
    assert (np.diff(found.score[found.best]) <= 0.0).all()
    gaps = np.abs(np.subtract.outer(xs[found.best], xs[found.best]))[np.triu_indices(5, 1)]
    assert gaps.min() >= 0.012 - 1e-9


def test_when_safe_points_crowd_together_the_next_best_fill_up():
    found = roll(problem(), [(0.1 + 0.001 * i, 0.0) for i in range(6)])
    assert len(found.best) == 5
    assert len(set(found.best.tolist())) == 5
    assert found.best[0] == np.argmax(found.score)


def test_pessimistic_paths_lie_n_sigma_to_both_sides_and_ahead():
    scene = problem(mover_cov=SEEN)
    left, right, fast = hypotheses(scene)
    ahead_s = 2.0  # closest approach of a ball 0.2 m off at 0.1 m/s
    expected = 2.0 * np.sqrt(1e-6 + ahead_s**2 * 1e-4)
    for variant, sign in ((left, 1.0), (right, -1.0)):
        there = variant.mover_pos_m + variant.mover_vel_m_s * ahead_s
        assert abs(there[1]) == pytest.approx(expected)
        assert abs(variant.mover_pos_m[1]) == pytest.approx(0.002)
        assert np.sign(there[1]) == np.sign(variant.mover_pos_m[1])
        assert there[0] == pytest.approx(0.0)
        assert np.sign(there[1]) == sign
    assert fast.mover_vel_m_s == pytest.approx([-0.12, 0.0, 0.0])


def test_pessimistic_paths_brake_along_their_own_direction():
    scene = problem(mover_cov=SEEN, mover_acc_m_s2=(0.03, 0.0, 0.0))
    for variant in hypotheses(scene):
        acceleration, velocity = variant.mover_acc_m_s2[:2], variant.mover_vel_m_s[:2]
        assert np.hypot(*acceleration) == pytest.approx(0.03)
        assert acceleration @ velocity == pytest.approx(-0.03 * np.hypot(*velocity))


def test_a_mover_at_rest_has_no_pessimistic_paths():
    assert hypotheses(problem(mover_vel_m_s=(0.0, 0.0, 0.0), mover_cov=SEEN)) == []


@pytest.mark.parametrize(
    "changes, name",
    [
        ({"mover_pos_m": (0.1, np.nan, 0.0)}, "mover_pos_m"),
        ({"mover_vel_m_s": (0.1, np.inf, 0.0)}, "mover_vel_m_s"),
        ({"mover_cov": np.zeros((3, 3))}, "mover_cov"),
        ({"target_pos_m": (0.1, 0.0)}, "target_pos_m"),
        ({"obstacle_pos_m": np.zeros((2, 3))}, "obstacle_pos_m"),
        ({"mover_radius_m": 0.0}, "mover_radius_m"),
        ({"tip_radius_m": np.nan}, "tip_radius_m"),
        ({"dt_s": 0.0}, "dt_s"),
        ({"dt_s": 20.0}, "steps"),
        ({"horizon_s": 1e9}, "steps"),
    ],
)
def test_a_malformed_problem_is_a_typed_error_that_names_the_field(changes, name):
    with pytest.raises(InputError, match=name):
        problem(**changes)


def test_a_problem_takes_mover_target_and_obstacles_from_the_tracks():
    found = problem_from(tracks(), 4, 5, SimulateConfig(horizon_s=4.0), 0.012)
    assert (found.seq, found.t_s, found.mover_id, found.target_id) == (3, 2.0, 4, 5)
    assert found.mover_pos_m.tolist() == [0.3, 0.0, 0.015]
    assert found.mover_radius_m == 0.015
    assert found.target_radius_m == 0.02
    assert found.obstacle_pos_m.tolist() == [[0.2, 0.2, 0.015]]
    assert found.tip_radius_m == 0.012
    assert found.n_steps == 400


def test_a_crawling_target_is_taken_as_at_rest():
    assert not problem_from(tracks(), 4, 5, SimulateConfig(), 0.012).target_vel_m_s.any()
    moving = problem_from(tracks(), 4, 5, SimulateConfig(rest_speed_m_s=0.001), 0.012)
    assert moving.target_vel_m_s[0] == 0.004


@pytest.mark.parametrize(
    "how_much, expected",
    [("none", (0.0, 0.0)), ("along", (0.02, 0.0)), ("full", (0.02, 0.05))],
)
def test_only_the_believed_part_of_the_acceleration_is_used(how_much, expected):
    found = problem_from(tracks(), 4, 5, SimulateConfig(acceleration=how_much), 0.012)
    assert found.mover_acc_m_s2[:2].tolist() == pytest.approx(list(expected))


def test_what_a_young_track_does_not_know_yet_is_replaced_by_caution():
    unknown = np.full((3, 6, 6), np.nan)
    seen = tracks(cov=unknown, acc_m_s2=np.full((3, 3), np.nan))
    found = problem_from(seen, 4, 5, SimulateConfig(), 0.012)
    assert found.mover_cov[3, 3] == pytest.approx(0.05**2)
    assert not found.mover_acc_m_s2.any()


def test_lost_objects_are_no_obstacles_any_more():
    lost = tracks(status=np.array([0, 0, int(TrackStatus.LOST)]))
    assert len(problem_from(lost, 4, 5, SimulateConfig(), 0.012).obstacle_pos_m) == 0


@pytest.mark.parametrize(
    "changes, mover, target, message",
    [
        ({}, 99, 5, "no single mover track 99"),
        ({}, 4, 99, "no single target track 99"),
        ({}, 4, 4, "both"),
        ({"status": np.array([2, 0, 0])}, 4, 5, "lost"),
        ({"pos_m": np.full((3, 3), np.nan)}, 4, 5, "mover_pos_m"),
        ({"radius_m": np.full(3, np.nan)}, 4, 5, "mover_radius_m"),
    ],
)
def test_tracks_that_cannot_be_rolled_out_are_a_typed_error(changes, mover, target, message):
    with pytest.raises(InputError, match=message):
        problem_from(tracks(**changes), mover, target, SimulateConfig(), 0.012)


def test_settings_are_read_strictly_with_their_nested_section():
    found = structure(
        SimulateConfig, {"type": "euler", "candidates": {"tip_height_m": 0.01}}, "t [simulate]"
    )
    assert found.type == "euler"
    assert found.candidates.tip_height_m == 0.01
    assert dataclasses.asdict(SimulateConfig())["n_candidates"] == 1412
    with pytest.raises(ConfigError, match="clearance_m"):
        structure(SimulateConfig, {"clearence_m": 0.01}, "t [simulate]")
