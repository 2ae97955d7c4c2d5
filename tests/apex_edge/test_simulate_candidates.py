"""The grid of intercept points."""

import dataclasses

import numpy as np
import pytest

from apex_edge.errors import ConfigError
from apex_edge.simulate.base import CandidatesConfig
from apex_edge.simulate.candidates import candidate_grid
from firmware_bridge.kinematics import ArmModel


@pytest.fixture(scope="module")
def arm():
    return ArmModel.load("armpi-mini")


@pytest.fixture(scope="module")
def grid(arm):
    return candidate_grid(arm)


def test_there_are_exactly_1412_points(grid):
    assert grid.tip_m.shape == (1412, 3)
    assert grid.joints_rad.shape == grid.hover_rad.shape == (1412, 4)


def test_the_arm_stands_at_every_point_and_straight_above_it(arm, grid):
    np.testing.assert_allclose(arm.tip(grid.joints_rad), grid.tip_m, atol=1e-9)
    above = grid.tip_m.copy()
    above[:, 2] = 0.06
    np.testing.assert_allclose(arm.tip(grid.hover_rad), above, atol=1e-9)
    assert (grid.tip_m[:, 2] == 0.015).all()
    np.testing.assert_array_equal(grid.wrist_m, arm.forward(grid.joints_rad)[:, 2])


def test_points_are_evenly_spread_over_the_half_annulus(grid):
    x, y = grid.tip_m[:, 0], grid.tip_m[:, 1]
    gap = np.hypot(np.subtract.outer(x, x), np.subtract.outer(y, y))
    np.fill_diagonal(gap, np.inf)
    spacing = gap.min()
    assert 0.005 < spacing < 0.007
    np.testing.assert_allclose(gap.min(axis=0), spacing, rtol=1e-6)
    # as many to the left as to the right, both to the sides
    assert abs(int((y > 1e-9).sum()) - int((y < -1e-9).sum())) <= 2
    assert y.max() > 0.17


def test_the_same_call_gives_the_same_points_in_the_same_order(arm, grid):
    again = candidate_grid(arm)
    np.testing.assert_array_equal(again.tip_m, grid.tip_m)
    reach = np.hypot(grid.tip_m[:, 0], grid.tip_m[:, 1])
    assert (np.diff(reach) >= -1e-9).all()


def test_nobody_can_move_a_candidate_by_accident(grid):
    with pytest.raises(ValueError, match="read-only"):
        grid.tip_m[0, 0] = 1.0


@pytest.mark.parametrize("n", [1, 7, 300])
def test_any_number_of_points_can_be_asked_for(arm, n):
    found = candidate_grid(arm, n, version=3)
    assert found.tip_m.shape == (n, 3)
    assert found.version == 3


def test_more_points_than_the_finest_grid_has_are_refused(arm):
    with pytest.raises(ConfigError, match="reaches only .* expected 1412"):
        candidate_grid(arm, 1412, config=CandidatesConfig(min_spacing_m=0.01))


def test_an_arm_that_reaches_nothing_is_refused(arm):
    with pytest.raises(ConfigError, match="reaches only 0 points"):
        candidate_grid(arm, 5, config=CandidatesConfig(hover_height_m=0.4, min_spacing_m=0.01))


def test_no_points_at_all_are_refused(arm):
    with pytest.raises(ConfigError, match="at least 1"):
        candidate_grid(arm, 0)


def test_an_arm_that_turns_less_gets_a_narrower_grid(arm):
    limits = arm.limits_rad.copy()
    limits[0] = (-0.5, 0.5)
    narrow = candidate_grid(dataclasses.replace(arm, limits_rad=limits), 200)
    yaw = np.arctan2(narrow.tip_m[:, 1], narrow.tip_m[:, 0])
    assert np.abs(yaw).max() <= 0.5 + 1e-9


@pytest.mark.parametrize("name", ["so-101", "armpi", "xarm-1s"])
def test_other_arms_have_as_many_candidates(name):
    arm = ArmModel.load(name)
    grid = candidate_grid(arm)
    assert len(grid.tip_m) == 1412
    assert np.abs(arm.tip(grid.joints_rad) - grid.tip_m).max() < 1e-9
