from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.errors import MotionRefused
from firmware_bridge.guard import CheckedPath, Limits, check_path
from firmware_bridge.kinematics import ArmModel
from offline_train.benchmarks.firmware import guard_cases

ARM = ArmModel.load("armpi-mini")
any_number = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True), st.sampled_from([1e308, -1e308, 0.0, 1.0])
)


def joints_at(*tips):
    q, is_reachable = ARM.inverse(np.array(tips, dtype=float))
    assert is_reachable.all()
    return q


def check(goals, duration_s=None, q_from=None, limits=None):
    goals = np.atleast_2d(np.asarray(goals, dtype=float))
    start = ARM.home_rad if q_from is None else q_from
    times = np.full(len(goals), 2.0) if duration_s is None else np.asarray(duration_s, dtype=float)
    return check_path(ARM, start, goals, times, limits)


def test_a_path_within_the_limits_is_kept_as_it_is():
    goals = joints_at((0.12, 0.05, 0.06), (0.12, 0.05, 0.005))
    path = check(goals, [1.5, 0.7])
    assert np.array_equal(path.knots_rad, np.vstack([ARM.home_rad, goals]))
    assert np.allclose(path.knots_s, [0.0, 1.5, 2.2])
    assert not path.is_stretched


def test_a_segment_too_fast_is_stretched_to_a_little_below_the_rate_and_no_more():
    goals = joints_at((0.12, 0.05, 0.06), (0.12, 0.05, 0.005))
    path = check(goals, [0.01, 5.0])
    speed = np.abs(np.diff(path.knots_rad, axis=0)) / np.diff(path.knots_s)[:, None]
    assert path.is_stretched
    assert np.isclose((speed[0] / ARM.rate_rad_s).max(), 0.95)  # the rest is for late set-points
    assert np.isclose(np.diff(path.knots_s)[1], 5.0)


def test_a_path_starts_and_ends_at_rest_at_its_ends():
    path = check(joints_at((0.12, 0.05, 0.06)))
    assert np.array_equal(path.at(-1.0), ARM.home_rad)
    assert np.array_equal(path.at(99.0), path.knots_rad[-1])
    assert np.allclose(path.at(path.total_s / 2), path.knots_rad.mean(axis=0))


@pytest.mark.parametrize("joint", range(4))
@pytest.mark.parametrize("side", [0, 1])
def test_a_joint_past_its_limit_is_refused_by_name(joint, side):
    goal = ARM.home_rad.copy()
    goal[joint] = ARM.limits_rad[joint, side] + (0.001 if side else -0.001)
    with pytest.raises(MotionRefused, match=f"way-point 0: {ARM.joint_names[joint]} = "):
        check(goal)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", ["start", "joints", "duration"])
def test_a_value_that_is_not_finite_is_refused(bad, place):
    start, goal, duration = ARM.home_rad.copy(), ARM.home_rad.copy(), np.array([1.0])
    {"start": start, "joints": goal, "duration": duration}[place][0] = bad
    with pytest.raises(MotionRefused, match="is not finite"):
        check_path(ARM, start, goal[None], duration)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 31.0])
def test_a_duration_outside_its_range_is_refused(duration_s):
    with pytest.raises(MotionRefused, match="duration_s"):
        check(ARM.home_rad, [duration_s])


@pytest.mark.parametrize(
    ("goals", "times"),
    [
        (np.zeros((0, 4)), np.zeros(0)),
        (np.zeros((1, 3)), np.ones(1)),
        (np.zeros(4), np.ones(1)),
        (np.zeros((2, 4)), np.ones(1)),
    ],
)
def test_a_path_of_the_wrong_shape_is_refused(goals, times):
    with pytest.raises(MotionRefused, match="a path needs"):
        check_path(ARM, ARM.home_rad, goals, times)


def test_a_step_too_large_is_refused():
    with pytest.raises(MotionRefused, match="yaw turns 0.6 rad in one step"):
        check(ARM.home_rad + [0.6, 0, 0, 0], limits=Limits(max_step_rad=0.5))


def test_a_tip_under_the_table_is_refused():
    above = joints_at((0.12, 0.0, 0.02))[0]
    under = above + [0.0, -0.25, 0.0, 0.0]
    assert ARM.tip(under)[0, 2] < 0.0
    with pytest.raises(MotionRefused, match="tip comes to z = "):
        check(under, q_from=above)


def test_the_tip_may_come_down_to_3_mm_and_no_lower():
    check(joints_at((0.12, 0.0, 0.06), (0.12, 0.0, 0.0031)))
    with pytest.raises(MotionRefused, match="table plane allows 0.003 m"):
        check(joints_at((0.12, 0.0, 0.06), (0.12, 0.0, 0.0029)))


def test_a_dip_between_two_good_way_points_is_found():
    low = ARM.limits_rad[:, 0]
    begin = joints_at((0.10, 0.0, 0.01))[0]
    end = joints_at((0.185, 0.0, 0.01))[0]
    share = np.linspace(0, 1, 200)[:, None]
    lowest = ARM.tip(begin + (end - begin) * share)[:, 2].min()
    assert lowest < 0.009  # both ends stand at 0.010
    assert (begin >= low).all()
    with pytest.raises(MotionRefused, match="tip comes to z = "):
        check(end, q_from=begin, limits=Limits(min_tip_z_m=0.0095))


def test_the_wrist_keeps_off_the_table():
    folded = np.array([0.0, 0.3, 1.5, 1.5])
    assert ARM.forward(folded)[0, 2, 2] < 0.06 < ARM.tip(folded)[0, 2]
    with pytest.raises(MotionRefused, match="wrist comes to z = "):
        check(folded, limits=Limits(min_link_z_m=0.06, min_tip_z_m=0.0))


def test_leaving_the_workspace_is_refused():
    with pytest.raises(MotionRefused, match="tip leaves the workspace"):
        check(joints_at((0.15, 0.0, 0.06)), limits=Limits(box_high_m=(0.14, 0.25, 0.35)))


def test_the_tip_keeps_out_of_the_base():
    begin = joints_at((0.09, 0.0, 0.06))[0]
    with pytest.raises(MotionRefused, match="inside the arm's base"):
        check(begin - [0, 0.2, 0, 0], q_from=begin, limits=Limits(base_radius_m=0.088))


def test_an_arm_found_too_low_may_still_leave():
    low = joints_at((0.12, 0.0, 0.0))[0]
    assert check(joints_at((0.12, 0.0, 0.06)), q_from=low).total_s == 2.0


@given(st.lists(st.lists(any_number, min_size=4, max_size=4), min_size=1, max_size=3), any_number)
def test_no_hostile_path_gets_through(goals, duration_s):
    try:
        path = check(goals, np.full(len(goals), duration_s))
    except MotionRefused as error:
        assert str(error)
        return
    times = np.linspace(0.0, path.total_s, 300)
    points = ARM.forward(np.stack([path.at(t) for t in times]))
    speed = np.abs(np.diff(path.knots_rad, axis=0)) / np.diff(path.knots_s)[:, None]
    assert (speed <= ARM.rate_rad_s * (1 + 1e-9)).all()
    assert points[:, 3, 2].min() > 0.003 - 0.001  # between samples the chord may sag a little
    assert points[:, 1:3, 2].min() > 0.010 - 0.001


@given(st.integers(0, 10_000))
def test_random_poses_get_through_only_above_the_table(seed):
    goal = np.random.default_rng(seed).uniform(ARM.limits_rad[:, 0], ARM.limits_rad[:, 1])
    try:
        path = check(goal)
    except MotionRefused:
        return
    poses = np.stack([path.at(t) for t in np.linspace(0.0, path.total_s, 300)])
    assert ARM.forward(poses)[:, 1:, 2].min() > 0.002


def arm_like(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(f'like = "armpi-mini"\n{text}')
    return ArmModel.load(path)


HOSTILE_SHAPES = [
    None,
    "up",
    b"up",
    {},
    [[0.0, 1.0], [2.0]],
    [[10**400] * 4],
    [["a"] * 4],
    np.zeros((1, 4), dtype=complex),
    np.zeros((1, 4), dtype=bool),
    np.array([["0"] * 4]),
    np.array([[None] * 4]),
    np.zeros((1, 4), dtype="M8[s]"),
    np.zeros((10_000_000, 0)),
    np.zeros((257, 4)),
    np.zeros((1, 1, 4)),
    np.float64(1.0),
]


@pytest.mark.parametrize("place", range(3))
@pytest.mark.parametrize("hostile", HOSTILE_SHAPES, ids=range(len(HOSTILE_SHAPES)))
def test_what_is_no_path_at_all_is_refused_and_nothing_else(hostile, place, recwarn):
    given_ = [ARM.home_rad, ARM.home_rad[None], np.array([1.0])]
    given_[place] = hostile
    with pytest.raises(MotionRefused) as caught:
        check_path(ARM, *given_)
    assert len(str(caught.value)) < 500
    assert not recwarn.list


@pytest.mark.parametrize("value", [1e308, -1e308, 1e200, 50.0])
@pytest.mark.parametrize("place", ["start", "joints", "duration"])
def test_a_huge_number_is_refused_without_a_warning(value, place, recwarn):
    start, goal, duration = ARM.home_rad.copy(), ARM.home_rad.copy(), np.array([1.0])
    {"start": start, "joints": goal, "duration": duration}[place][0] = value
    with pytest.raises(MotionRefused):
        check_path(ARM, start, goal[None], duration)
    with pytest.raises(MotionRefused):
        clamp = replace(ARM.workspace, mode="clamp")
        check_path(ARM, np.full(4, value), goal[None], duration, clamp)
    assert not recwarn.list


@pytest.mark.parametrize(
    ("now_s", "deadline_s"),
    [(5.0, 4.9), (5.0, 5.0), (5.0, np.nan), (np.nan, 5.0), (5.0, np.inf), (None, 5.0), (1, "x")],
)
def test_a_path_whose_deadline_has_passed_is_refused(now_s, deadline_s):
    with pytest.raises(MotionRefused, match="deadline has passed|needs numbers"):
        check_path(ARM, ARM.home_rad, ARM.home_rad[None], [1.0], None, now_s, deadline_s)


def test_a_path_before_its_deadline_is_taken():
    path = check_path(ARM, ARM.home_rad, ARM.home_rad[None], [1.0], None, 5.0, 5.1)
    assert path.total_s == 1.0


def test_each_arm_is_held_to_its_own_workspace():
    arm = ArmModel.load("so-101")
    q, is_reachable = arm.inverse(np.array([[0.33, 0.0, 0.15]]))
    assert is_reachable[0]
    assert check_path(arm, arm.home_rad, q, [3.0]).total_s >= 3.0
    with pytest.raises(MotionRefused, match="leaves the workspace"):
        check_path(arm, arm.home_rad, q, [3.0], Limits())  # those of the small arm


def test_an_arm_does_not_touch_itself(tmp_path):
    no_base = (
        "[workspace]\nbase_radius_m = 0.0\n[body]\ncolumn_radius_m = 0.0\ncolumn_height_m = 0.0\n"
    )
    wrist = "[joints.wrist]\nticks_per_rad = 380.0\nlow_rad = -2.6\nhigh_rad = 2.6\n"
    arm = arm_like(tmp_path, no_base + wrist)
    curled = np.array([[0.0, 2.1, -1.56, 2.3]])  # the hand comes back on the upper arm
    begin = np.array([0.0, 2.1, -1.56, 0.5])
    with pytest.raises(MotionRefused, match="hand and upper arm would touch: "):
        check_path(arm, begin, curled, [3.0])
    assert check_path(arm, begin, curled - [0, 0, 0, 0.4], [3.0]).total_s == 3.0


def test_the_hand_keeps_off_the_base_column(tmp_path):
    arm = arm_like(tmp_path, "[body]\ncolumn_radius_m = 0.06\n")
    near = joints_at((0.09, 0.0, 0.06), (0.068, 0.0, 0.06))
    assert check(near).total_s
    with pytest.raises(MotionRefused, match="hand and base would touch: "):
        check_path(arm, arm.home_rad, near, [3.0, 3.0])


def test_a_dip_too_short_for_the_samples_is_found():
    rng = np.random.default_rng(5)
    n_found = 0
    for _ in range(400):
        angle, radius = rng.uniform(-0.6, 0.6, 2), rng.uniform(0.09, 0.18, 2)
        tips = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), [0.012, 0.012]])
        begin, end = joints_at(*tips)
        poses = begin + (end - begin) * np.linspace(0, 1, 2000)[:, None]
        lowest = float(ARM.tip(poses)[:, 2].min())
        if lowest > 0.0119:
            continue
        n_found += 1
        # a table that the dip reaches by a tenth of a millimetre, and one that it does not
        with pytest.raises(MotionRefused, match="tip comes to z"):
            check(end, q_from=begin, limits=Limits(min_tip_z_m=lowest + 1e-4))
        check(end, q_from=begin, limits=Limits(min_tip_z_m=lowest - 1e-6))
    assert n_found > 50


CLAMP = replace(ARM.workspace, mode="clamp")


def test_clamp_brings_joints_to_their_limits_and_says_so():
    goal = ARM.home_rad + [0.3, 0.0, 0.0, 5.0]
    path = check(goal, limits=CLAMP)
    assert path.knots_rad[-1, 3] == ARM.limits_rad[3, 1]
    assert np.isclose(path.knots_rad[-1, 0], goal[0])
    assert any("wrist = " in each for each in path.clamped)
    assert check(ARM.home_rad, limits=CLAMP).clamped == ()


def test_clamp_shortens_a_step_and_a_duration():
    limits = replace(CLAMP, max_step_rad=0.2, max_duration_s=5.0)
    path = check(ARM.home_rad + [0.8, 0.0, 0.0, 0.0], [99.0], limits=limits)
    assert np.isclose(path.knots_rad[-1, 0] - ARM.home_rad[0], 0.2)
    assert path.total_s == 5.0
    assert len(path.clamped) == 2


def test_clamp_ends_a_path_before_the_table():
    goals = joints_at((0.12, 0.0, 0.06), (0.12, 0.0, 0.0), (0.12, 0.0, 0.06))
    path = check(goals, limits=CLAMP)
    assert 0.003 <= ARM.tip(path.knots_rad[-1])[0, 2] < 0.012
    assert len(path.knots_rad) == 3  # start, above, and as low as it may
    assert len(path.clamped) == 1
    assert "tip comes to z" in path.clamped[0]
    speed = np.abs(np.diff(path.knots_rad, axis=0)) / np.diff(path.knots_s)[:, None]
    assert (speed <= ARM.rate_rad_s * (1 + 1e-9)).all()


def test_clamp_refuses_a_path_of_which_nothing_is_left():
    low = joints_at((0.12, 0.0, 0.004))[0]
    with pytest.raises(MotionRefused, match="tip comes to z"):
        check(low - [0.0, 0.4, 0.0, 0.0], q_from=low, limits=CLAMP)


@pytest.mark.parametrize("name", ["armpi", "so-101"])
def test_guard_and_oracle_agree_on_hostile_targets(name):
    rng, arm = np.random.default_rng(9), ArmModel.load(name)
    n_taken, kinds = 0, set()
    for _ in range(600):
        target = guard_cases.hostile(rng, arm)
        due_s = None if target.deadline_s is None else 7.0 + target.deadline_s
        kinds.add(target.kind)
        try:
            path = check_path(
                arm, arm.home_rad, target.joints_rad, target.duration_s, None, 7.0, due_s
            )
        except MotionRefused:
            continue
        n_taken += 1
        assert guard_cases.violates(arm, path) == ""
    assert kinds == set(guard_cases.KINDS)
    assert n_taken > 20


def test_the_oracle_finds_what_the_guard_would_not_let_through():
    low = joints_at((0.12, 0.0, 0.06), (0.12, 0.0, 0.0))
    times = np.array([0.0, 2.0, 4.0])
    knots = np.vstack([ARM.home_rad, low])
    assert "tip under the table" in guard_cases.violates(ARM, CheckedPath(knots, times, False))
    assert guard_cases.violates(ARM, CheckedPath(knots[:2], times[:2] / 100, False)) == "over speed"
    beyond = np.vstack([ARM.home_rad, ARM.home_rad + [2.0, 0, 0, 0]])
    told = guard_cases.violates(ARM, CheckedPath(beyond, times[:2], False))
    assert told == "joint outside its limits"
