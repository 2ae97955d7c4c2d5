"""Every arm that is shipped, and files that users write on top of them."""

import logging
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from apex_edge.errors import ConfigError
from firmware_bridge.arm_file import (
    ARMS,
    Body,
    Bus,
    Calibration,
    Gripper,
    Head,
    Home,
    Joint,
    Limits,
    Links,
    Pitch,
    known_arms,
)
from firmware_bridge.clearance import clearances
from firmware_bridge.kinematics import ArmModel
from firmware_bridge.policy import Policy

NAMES = ("armpi", "armpi-mini", "armpi-mini-i2c", "learm", "lx16a-arm", "so-101", "xarm-1s")
GUIDE = Path(__file__).parents[2] / "docs" / "hardware" / "add-your-arm.md"
each_arm = pytest.mark.parametrize("name", NAMES)

# SO-101, from its MJCF: place and quaternion (w, x, y, z) of each body in the one before; every
# joint turns about its body's z.
SO101 = (
    ((0.0388353, -8.97657e-09, 0.0624), (3.56167e-16, 1.22818e-15, -1, -4.14635e-16)),
    ((-0.0303992, -0.0182778, -0.0542), (0.5, -0.5, -0.5, -0.5)),
    ((-0.11257, -0.028, 1.73763e-16), (0.707107, -5.98613e-17, -2.58051e-17, 0.707107)),
    ((-0.1349, 0.0052, 3.62355e-17), (0.707107, 9.58722e-16, -7.51313e-16, -0.707107)),
    ((5.55112e-17, -0.0611, 0.0181), (0.0172091, -0.0172091, 0.706897, 0.706897)),
)
SO101_TIP = (-0.0079, -0.000218121, -0.0981274)


def quaternion_matrix(quaternion):
    w, x, y, z = np.array(quaternion) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def so101_points(q):
    """Anchors of the joints, then the tip (6, 3), as MuJoCo's rules give them."""
    turn, place, points = np.eye(3), np.zeros(3), []
    for (offset, quaternion), angle in zip(SO101, q):
        place = place + turn @ offset
        c, s = np.cos(angle), np.sin(angle)
        turn = turn @ quaternion_matrix(quaternion) @ [[c, -s, 0], [s, c, 0], [0, 0, 1]]
        points.append(place)
    return np.array([*points, place + turn @ SO101_TIP])


def poses_of(arm, n=400):
    return np.random.default_rng(11).uniform(*arm.limits_rad.T, (n, arm.n_joints))


def test_all_arms_are_shipped():
    assert tuple(known_arms()) == NAMES


@each_arm
def test_a_shipped_arm_stands_at_home_within_its_own_limits(name):
    arm = ArmModel.load(name)
    assert arm.name == name
    home = arm.forward(arm.home_rad)[0]
    low, high = np.array(arm.workspace.box_low_m), np.array(arm.workspace.box_high_m)
    assert ((home[1:] > low) & (home[1:] < high)).all()
    lowest, highest = arm.tick_range
    ticks = arm.zero_ticks + arm.ticks_per_rad * arm.limits_rad.T
    assert ticks.min() > lowest - 0.5
    assert ticks.max() < highest + 0.5
    assert len(set(arm.all_ids)) == arm.n_joints + 1


@pytest.mark.parametrize(
    ("name", "protocol", "ticks"),
    [
        ("armpi-mini", "rrc", (500, 2500)),
        ("armpi-mini-i2c", "i2c", (500, 2500)),
        ("armpi", "lx16a", (0, 1000)),
        ("xarm-1s", "lsc", (0, 1000)),
        ("lx16a-arm", "lx16a", (0, 1000)),
        ("so-101", "sts", (0, 4095)),
        ("learm", "lsc-pwm", (500, 2500)),
    ],
)
def test_each_arm_names_its_protocol_and_counts_in_its_ticks(name, protocol, ticks):
    arm = ArmModel.load(name)
    assert (arm.bus.protocol, arm.tick_range) == (protocol, ticks)
    far = arm.ticks(np.full(arm.n_joints, 100.0))
    assert set(far.tolist()) <= set(ticks)


@each_arm
def test_ticks_come_back_as_the_same_angles(name):
    arm = ArmModel.load(name)
    q = poses_of(arm)
    error = np.abs(arm.angles_rad(arm.ticks(q)) - q).max(axis=0)
    assert (error <= 0.5 / np.abs(arm.ticks_per_rad) + 1e-9).all()


@pytest.mark.parametrize("at_zero", [True, False])
def test_so101_stands_where_its_mjcf_says(at_zero):
    arm = ArmModel.load("so-101")
    q = np.zeros((1, 5)) if at_zero else poses_of(arm)
    wanted = np.array([so101_points(each) for each in q])
    # the file rounds to 1 um, and so do the quaternions of the MJCF
    assert np.abs(arm.forward(q) - wanted[:, [1, 2, 3, 5]]).max() < 1e-5


def test_so101_at_zero_has_the_published_anchors():
    points = ArmModel.load("so-101").forward(np.zeros(5))[0]
    published = [
        [0.0692, -0.0183, 0.1166],
        [0.0972, -0.0183, 0.2292],
        [0.2321, -0.0183, 0.2344],
        [0.3914, 0.0, 0.2265],
    ]
    assert np.abs(points - published).max() < 1e-4


def test_so101_gripper_pose_turns_with_the_roll_joint():
    arm = ArmModel.load("so-101")
    poses = arm.gripper_pose(poses_of(arm))
    turns = poses[:, :3, :3]
    assert np.allclose(np.swapaxes(turns, 1, 2) @ turns, np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(turns), 1.0)
    # the tip stays 7.9 mm below the hand's own level plane through the roll axis
    q = poses_of(arm)
    q[:, 4] = 0.0
    rolled = q + [0, 0, 0, 0, 1.0]
    axis = arm.tip(q) - arm.gripper_pose(q)[:, :3, 2] * arm.links.tip_up_m
    off = arm.tip(rolled) - axis
    up = arm.gripper_pose(rolled)[:, :3, 2]
    assert np.allclose((off * up).sum(axis=1), arm.links.tip_up_m, atol=2e-4)


@each_arm
def test_every_pose_is_among_the_branches_of_its_own_tip(name):
    arm = ArmModel.load(name)
    q = poses_of(arm, 2000)
    points = arm.forward(q)
    q = q[points[:, 1:3, 2].min(axis=1) >= arm.pitch.min_link_z_m]
    roll = q[:, 4] if arm.n_joints > 4 else None
    ways = arm.inverse_all(arm.tip(q), arm.pitches(q)[:, 2:], roll)[:, 0]
    assert ways.shape == (len(q), 4, arm.n_joints)
    off = np.where(np.isfinite(ways), np.abs(ways - q[:, None]), np.inf).max(axis=2).min(axis=1)
    assert off.max() < 1e-6
    good = np.isfinite(ways).all(axis=2)
    assert good.sum() > 1.1 * len(q)  # more than the one it came from
    tips = np.repeat(arm.tip(q), good.sum(axis=1), axis=0)
    assert np.abs(arm.tip(ways[good]) - tips).max() < 1e-9


@each_arm
def test_inverse_takes_the_first_pitch_that_has_a_way_forward(name):
    arm = ArmModel.load(name)
    reach = arm.links.reach_m
    tips = np.random.default_rng(2).uniform([0, -reach, 0], [reach, reach, reach], (150, 3))
    found, is_reachable = arm.inverse(tips)
    assert 5 < is_reachable.sum() < 150
    assert (arm.is_reachable(tips) == is_reachable).all()
    ways = arm.inverse_all(tips)
    is_way = np.isfinite(ways[:, :, :2]).all(axis=3)
    # whole turns are no way that inverse takes
    assert is_way.any(axis=(1, 2))[is_reachable].all()
    for i in np.flatnonzero(is_reachable):
        near = np.abs(ways[i, :, :2] - found[i]).max(axis=2)
        assert np.nanmin(near) < 1e-9
    assert np.abs(arm.tip(found[is_reachable]) - tips[is_reachable]).max() < 1e-9


def test_an_arm_that_bends_over_backward_reaches_behind_itself():
    arm = ArmModel.load("armpi-mini")
    behind = np.array([[-0.19, 0.0, 0.17]])
    assert not arm.is_reachable(behind)[0]
    # the hand points up and back, which is no pitch of the file's
    ways = arm.inverse_all(behind, np.radians([150.0, 165.0]))[0]
    good = ways[np.isfinite(ways).all(axis=2)]
    assert len(good)
    assert np.allclose(arm.tip(good), behind, atol=1e-9)
    assert (good[:, 1] > np.pi / 2).all()


def test_travel_time_knows_acceleration(tmp_path):
    path = tmp_path / "slow.toml"
    path.write_text('like = "armpi-mini"\n[joints.yaw]\nrate_rad_s = 2.0\naccel_rad_s2 = 8.0\n')
    arm = ArmModel.load(path)
    goals = np.array([[0.1, 0, 0, 0], [0.5, 0, 0, 0], [1.0, 0, 0, 0], [0.1, 1.5, 0, 0]])
    told = arm.travel_time_s(np.zeros(4), goals)
    # 2 sqrt(d/a) while the rate is not reached (d < v^2/a = 0.5), then d/v + v/a
    assert np.allclose(told, [2 * np.sqrt(0.1 / 8), 0.5, 0.75, 0.5])


def test_an_unverified_arm_tells_its_user(caplog):
    with caplog.at_level(logging.WARNING):
        arm = ArmModel.load("learm")
    assert not arm.is_verified
    assert arm.note in caplog.text
    assert "not verified" in caplog.text
    caplog.clear()
    assert ArmModel.load("armpi-mini").is_verified
    assert not caplog.text


def test_a_copy_of_an_arm_changes_only_what_it_says(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('like = "so-101"\nname = "mine"\n[joints.wrist_flex]\nzero_ticks = 2011.0\n')
    mine, base = ArmModel.load(path), ArmModel.load("so-101")
    assert mine.name == "mine"
    assert mine.zero_ticks[3] == 2011.0
    assert (mine.zero_ticks[:3] == base.zero_ticks[:3]).all()
    assert mine.links == base.links
    further = tmp_path / "further.toml"
    further.write_text('like = "mine.toml"\nname = "further"\n')
    assert ArmModel.load(further).zero_ticks[3] == 2011.0


def toml_blocks():
    text = GUIDE.read_text(encoding="utf-8")
    return [part.split("```")[0] for part in text.split("```toml\n")[1:]]


def test_the_files_of_the_guide_load(tmp_path):
    copy, whole = toml_blocks()
    for name, text in (("copy", copy), ("whole", whole)):
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    assert ArmModel.load(tmp_path / "copy.toml").ticks_per_rad[3] == 648.2
    arm = ArmModel.load(tmp_path / "whole.toml")
    assert (arm.n_joints, arm.tick_range, arm.gripper.servo_id) == (4, (0, 1000), 1)
    assert np.isfinite(arm.accel_rad_s2).tolist() == [False, False, False, True]
    assert clearances(arm, arm.forward(arm.home_rad), arm.workspace).min() > 0.01


def test_the_guide_explains_every_key():
    text = GUIDE.read_text(encoding="utf-8")
    sections = (Head, Bus, Links, Pitch, Home, Gripper, Limits, Body, Joint, Policy, Calibration)
    keys = {each.name for kind in sections for each in fields(kind)}
    assert [key for key in sorted(keys) if not re.search(rf"\b{key}\b", text)] == []


def test_an_arm_without_a_gripper_has_one_servo_less(tmp_path):
    text = (ARMS / "armpi-mini.toml").read_text(encoding="utf-8")
    head, tail = text.split("[gripper]")
    path = tmp_path / "bare.toml"
    path.write_text(head + tail[tail.index("[workspace]") :], encoding="utf-8")
    arm = ArmModel.load(path)
    assert arm.gripper is None
    assert arm.all_ids == arm.servo_ids


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('like = "nothing"', "no arm is named 'nothing'; known: armpi"),
        ('like = "mine.toml"', "circle"),
        ("like = 3", "like = 3 must be"),
        ('like = "so-101"\n[policy]\nmax_cc = 3.0', "max_cc'.*did you mean 'max_c'"),
        ('like = "so-101"\n[policy]\nmax_c = 90.0', "warn_c, max_c and limp_c must rise"),
        ('like = "so-101"\n[policy]\nmin_v = nan', "min_v = nan"),
        ('like = "so-101"\n[policy]\nestop = "warn"', "estop = 'warn' is not one of"),
        ('like = "so-101"\npolicy = 3', "must be a table"),
        ('like = "so-101"\ncalibration = 3', "must be a table"),
        ('like = "so-101"\n[calibration]\nfile = "a.json"', "key 'sha256' is missing"),
        ('like = "so-101"\n[calibration]\nfile = 3\nsha256 = ""', "wrong type"),
        ('like = "so-101"\n[bus]\nprotocol = "stx"', "protocol = 'stx'.*did you mean 'sts'"),
        ('like = "so-101"\n[joints.wrist]\nservo_id = 9', "must hold 4 or 5 joints"),
        ('like = "armpi-mini"\n[joints.rol]\nservo_id = 9', "key 'zero_ticks' is missing"),
        ('like = "so-101"\n[gripper]\nopen_ticks = 5000', "servos take 0..4095"),
        ('like = "learm"\nnote = ""', "needs a note"),
        ('like = "so-101"\n[joints.wrist_flex]\nhigh_rad = 5.0', "0..4095"),
        ('like = "so-101"\n[bus]\nlow_ticks = 5000', "must be below"),
        ('like = "so-101"\n[workspace]\nbox_low_m = [1.0, 0.0, 0.0]', "box_low_m must be below"),
        ('like = "so-101"\n[workspace]\nmode = "clip"', "not one of reject, clamp"),
        ('like = "so-101"\n[joints]\nwrist_flex = 3', "must be a table"),
    ],
)
def test_a_broken_copy_is_refused_by_name(tmp_path, text, message):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        ArmModel.load(path)
