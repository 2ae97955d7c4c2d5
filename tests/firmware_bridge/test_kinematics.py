import numpy as np
import pytest

from apex_edge.errors import ConfigError
from firmware_bridge import arm_file
from firmware_bridge.kinematics import ArmModel

SHIPPED = (arm_file.ARMS / "armpi-mini.toml").read_text(encoding="utf-8")


def write_arm(tmp_path, *changes):
    text = SHIPPED
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "other.toml"
    path.write_text(text, encoding="utf-8")
    return path


def ring(radius_m, z_m, yaw_rad=0.0):
    radius, yaw = np.broadcast_arrays(np.asarray(radius_m, dtype=float), yaw_rad)
    return np.stack(
        [radius * np.cos(yaw), radius * np.sin(yaw), np.full(radius.shape, float(z_m))], axis=-1
    )


def random_poses(arm, n):
    low, high = arm.limits_rad.T
    return np.random.default_rng(7).uniform(low, high, (n, arm.n_joints))


def test_pulses_follow_the_published_servo_map(arm):
    q = random_poses(arm, 500)
    th6, th5, th4, th3 = 90.0 + np.rad2deg(q[:, 0]), *np.rad2deg(q[:, 1:]).T
    published = np.stack(
        [500 + th6 * 11.11, 1500 + (90 - th5) * 11.11, 1500 + th4 * 11.11, 1500 + th3 * 11.11], 1
    )
    # 0.5 us of rounding, 0.2 us for 11.11 standing for 2000 us / 180 degrees
    assert np.abs(arm.ticks(q) - published).max() <= 0.7


def test_gripper_pitch_is_shoulder_minus_elbow_plus_wrist(arm):
    q = random_poses(arm, 200)
    points = arm.forward(q)
    hand = points[:, 3] - points[:, 2]
    outward = np.stack([np.cos(q[:, 0]), np.sin(q[:, 0]), 0 * q[:, 0]], 1)
    pitch = q[:, 3] + q[:, 1] - q[:, 2]  # th3 = pitch - th5 + th4, as published
    assert np.allclose((hand * outward).sum(1), 0.095 * np.cos(pitch), atol=1e-12)
    assert np.allclose(hand[:, 2], 0.095 * np.sin(pitch), atol=1e-12)


def test_links_have_the_lengths_of_the_arm(arm):
    points = arm.forward(random_poses(arm, 100))
    lengths = np.linalg.norm(np.diff(points, axis=1), axis=2)
    assert np.allclose(lengths, [0.058, 0.062, 0.095], atol=1e-12)
    assert np.allclose(points[:, 0], [0.0, 0.0, 0.088])


def test_upright_pose_stands_straight_up_at_mid_pulses(arm):
    q = np.array([0.0, np.pi / 2, 0.0, 0.0])
    assert np.abs(arm.ticks(q) - 1500).max() == 0
    assert np.allclose(arm.tip(q)[0], [0.0, 0.0, 0.088 + 0.215], atol=1e-12)


def test_inverse_returns_to_the_point_it_was_asked_for(arm):
    rng = np.random.default_rng(3)
    tips = rng.uniform([-0.05, -0.22, 0.0], [0.22, 0.22, 0.3], (4000, 3))
    q, is_reachable = arm.inverse(tips)
    assert 500 < is_reachable.sum() < 4000
    assert np.abs(arm.tip(q[is_reachable]) - tips[is_reachable]).max() < 1e-9
    assert np.isnan(q[~is_reachable]).all()


def test_every_solution_keeps_limits_pulses_and_table(arm):
    rng = np.random.default_rng(4)
    q, is_reachable = arm.inverse(rng.uniform([-0.05, -0.22, 0.0], [0.22, 0.22, 0.3], (3000, 3)))
    q = q[is_reachable]
    assert (q >= arm.limits_rad[:, 0]).all()
    assert (q <= arm.limits_rad[:, 1]).all()
    exact = arm.zero_ticks + arm.ticks_per_rad * q
    assert exact.min() > 499.5
    assert exact.max() < 2500.5
    assert arm.forward(q)[:, 1:3, 2].min() >= arm.pitch.min_link_z_m - 1e-9


def test_reach_on_the_table_ends_where_the_shoulder_servo_does(arm):
    _, is_reachable = arm.inverse(ring([0.07, 0.08, 0.13, 0.19, 0.1915, 0.198, 0.21], 0.005))
    assert is_reachable.tolist() == [True, True, True, True, False, False, False]


def test_links_alone_would_reach_198_mm_but_not_210_mm(tmp_path):
    shoulder = "zero_ticks = 2500.0\nticks_per_rad = -636.6\noffset_ticks = 0.0\nlow_rad = 0.0"
    freed = "zero_ticks = 2200.0\nticks_per_rad = -500.0\noffset_ticks = 0.0\nlow_rad = -0.5"
    arm = ArmModel.load(write_arm(tmp_path, (shoulder, freed)))
    q, is_reachable = arm.inverse(ring([0.198, 0.199, 0.21], 0.005))
    assert is_reachable.tolist() == [True, False, False]
    assert q[0, 1] < 0.0


def test_gripper_points_straight_down_where_it_can(arm):
    q, is_reachable = arm.inverse(ring(np.linspace(0.085, 0.118, 30), 0.005))
    assert is_reachable.all()
    assert np.allclose(q[:, 1] - q[:, 2] + q[:, 3], -np.pi / 2, atol=1e-9)


def test_gripper_tilts_more_the_farther_it_must_reach(arm):
    q, is_reachable = arm.inverse(ring(np.linspace(0.12, 0.191, 40), 0.005))
    pitch = q[:, 1] - q[:, 2] + q[:, 3]
    assert is_reachable.all()
    assert (np.diff(pitch) >= -1e-9).all()
    assert pitch[0] < np.deg2rad(-85)
    assert np.deg2rad(-60) < pitch[-1] < 0.0


def test_left_of_the_arm_is_a_longer_base_pulse(arm):
    q, is_reachable = arm.inverse(ring(0.12, 0.005, np.deg2rad([-90.0, -30.0, 0.0, 30.0, 90.0])))
    assert is_reachable.all()
    assert arm.ticks(q)[:, 0].tolist() == [500, 1167, 1500, 1833, 2500]


def test_behind_the_arm_is_out_of_reach(arm):
    _, is_reachable = arm.inverse(ring(0.12, 0.005, np.deg2rad([91.0, 180.0, -100.0])))
    assert not is_reachable.any()


def test_a_point_that_is_not_finite_is_out_of_reach(arm):
    q, is_reachable = arm.inverse(np.array([[np.nan, 0, 0], [np.inf, 0, 0], [1e308, 0, 0]]))
    assert not is_reachable.any()
    assert np.isnan(q).all()


def test_pulses_and_angles_are_each_others_inverse(arm):
    q = random_poses(arm, 300)
    assert np.abs(arm.angles_rad(arm.ticks(q)) - q).max() <= 0.5 / 636.6 + 1e-9


def test_travel_time_is_that_of_the_slowest_joint(arm):
    home = arm.home_rad
    goals = np.stack([home, home + [0.3, 0, 0, 0], home + [0.3, -0.6, 0.1, 0]])
    assert np.allclose(arm.travel_time_s(home, goals), [0.0, 0.1, 0.2])


def test_home_is_the_vendors(arm):
    assert np.allclose(arm.tip(arm.home_rad)[0], [0.06, 0.0, 0.18], atol=1e-9)


def test_an_arm_file_can_be_given_by_path(tmp_path):
    arm = ArmModel.load(write_arm(tmp_path, ("hand_m = 0.095", "hand_m = 0.100")))
    assert arm.links.hand_m == 0.100
    assert arm.n_joints == 4


def test_unknown_arm_is_refused_with_the_list_of_known_ones():
    with pytest.raises(ConfigError, match="no arm is named 'armpo'; known: armpi, armpi-mini"):
        ArmModel.load("armpo")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("lag_s = 0.08", "lagg_s = 0.08", "unknown key 'lagg_s'; did you mean 'lag_s'"),
        ("upper_m = 0.058", "upper_m = 5.8", r"\[links\].*upper_m = 5.8 is outside"),
        ("hand_m = 0.095", "", r"\[links\].*key 'hand_m' is missing"),
        ("servo_id = 6", "servo_id = 1", "two servos share an id"),
        ("low_rad = 0.0", "low_rad = -0.2", r"\[joints.shoulder\].*500..2500"),
        ("low_rad = 0.0", "low_rad = 4.0", "low_rad must be below high_rad"),
        ("tip_m = [0.06, 0.0, 0.18]", "tip_m = [0.3, 0.0, 0.3]", "cannot reach"),
        ("ticks_per_rad = -636.6", "ticks_per_rad = 0.0", "ticks_per_rad must not be 0"),
        ("[joints.wrist]", "[joints.elbow.wrist]", "unknown key 'wrist'|must hold 4 or 5"),
        ("[home]\ntip_m", "home = 3\ntip_mm", "home|key"),
        ("lag_s = 0.08", "lag_s = nan", "lag_s"),
    ],
)
def test_a_broken_arm_file_is_refused_by_name(tmp_path, old, new, message):
    path = write_arm(tmp_path, (old, new))
    with pytest.raises(ConfigError, match=message) as caught:
        ArmModel.load(path)
    assert "other.toml" in str(caught.value)
