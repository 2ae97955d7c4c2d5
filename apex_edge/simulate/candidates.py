"""The intercept points: an even grid over what the arm can reach, laid once per run.

A point counts only when the arm can stand there and straight above it, for it always comes down
from above. Source: APEX "Action Space Analysis" and figure "top-5 safe nodes ... from 1412 points";
how the points are laid is ours.
"""

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from apex_edge.errors import ConfigError
from apex_edge.simulate.problem import ArmCandidates, CandidatesConfig
from apex_edge.types import Array
from firmware_bridge.kinematics import ArmModel

# The pitch of the first, coarse grid, and how the grid is closed from there on.
_FIRST_SPACING_M = 0.012
_CLOSER = 0.995


@dataclass(frozen=True)
class _Region:
    """Part of a ring about the base axis."""

    near_m: float
    far_m: float
    low_rad: float
    high_rad: float


def candidate_grid(
    arm: ArmModel,
    n: int = 1412,
    version: int = 1,
    config: Optional[CandidatesConfig] = None,
) -> ArmCandidates:
    """Lay exactly ``n`` points on a square grid over the reachable half annulus.

    The widest grid with at least ``n`` reachable points is taken; the points too many are dropped
    from the far sides (greatest angle off straight ahead). Order: nearest to the base first, then
    by y: the same on every machine.

    Raises
    ------
    ConfigError : fewer than ``n`` points are reachable at the finest spacing allowed, or n < 1.
    """
    settings = config if config is not None else CandidatesConfig()
    if n < 1:
        raise ConfigError(f"candidates: n = {n}, expected at least 1")
    points = _closest_grid(arm, n, settings)
    side = np.abs(np.arctan2(points[:, 1], points[:, 0])).round(9)
    # equal sides go in pairs, left and right, so that the cut leaves the grid even
    kept = points[np.lexsort((points[:, 1], np.abs(points[:, 1]).round(9), side))[:n]]
    reach = np.hypot(kept[:, 0], kept[:, 1]).round(9)
    kept = kept[np.lexsort((kept[:, 1], reach))]
    joints, hover, _ = _reachable(arm, kept, settings)
    tip = np.column_stack([kept, np.full(n, settings.tip_height_m)])
    wrist = arm.forward(joints)[:, 2].copy()
    for array in (tip, joints, hover, wrist):
        array.setflags(write=False)
    return ArmCandidates(version, tip, joints, hover, wrist)


def _closest_grid(arm: ArmModel, n: int, config: CandidatesConfig) -> Array:
    """Return the reachable points (m, 2), m >= n, of the widest grid that has as many."""
    far_m = arm.links.reach_m + float(np.hypot(*arm.links.axis_m))
    everywhere = _Region(0.0, far_m, -np.pi, np.pi)
    coarse = _grid(arm, _FIRST_SPACING_M, everywhere, config)
    region = _around(coarse, _FIRST_SPACING_M) if len(coarse) else everywhere
    # The number goes with 1 / spacing^2: jump to a little too wide, then close in.
    spacing_m = _FIRST_SPACING_M * min(1.0, float(np.sqrt(max(len(coarse), 1) / n)) * 1.02)
    while spacing_m >= config.min_spacing_m:
        points = _grid(arm, spacing_m, region, config)
        if len(points) >= n:
            return points
        spacing_m *= max(min(_CLOSER, float(np.sqrt(len(points) / n))), 0.5)
    points = _grid(arm, config.min_spacing_m, region, config)
    if len(points) < n:
        raise ConfigError(
            f"candidates: arm {arm.name} reaches only {len(points)} points of a grid of "
            f"{config.min_spacing_m} m at tip height {config.tip_height_m} m and hover height "
            f"{config.hover_height_m} m, expected {n}"
        )
    return points


def _around(points: Array, margin_m: float) -> _Region:
    """Return the part of a ring that holds all points and a margin: what is left to search."""
    reach = np.hypot(points[:, 0], points[:, 1])
    yaw = np.arctan2(points[:, 1], points[:, 0])
    near = max(float(reach.min()) - margin_m, 0.0)
    wide = margin_m / max(near, margin_m)
    return _Region(
        near, float(reach.max()) + margin_m, float(yaw.min()) - wide, float(yaw.max()) + wide
    )


def _grid(arm: ArmModel, spacing_m: float, region: _Region, config: CandidatesConfig) -> Array:
    """Return the reachable points (m, 2) of a square grid with the x axis on it."""
    n_side = int(region.far_m / spacing_m)
    line = np.arange(-n_side, n_side + 1) * spacing_m
    x, y = (axis.ravel() for axis in np.meshgrid(line, line, indexing="ij"))
    reach, yaw = np.hypot(x, y), np.arctan2(y, x)
    near = (reach >= region.near_m) & (reach <= region.far_m)
    near &= (yaw >= region.low_rad) & (yaw <= region.high_rad)
    points = np.column_stack([x[near], y[near]])
    reachable: Array = points[_reachable(arm, points, config)[2]]
    return reachable


def _reachable(
    arm: ArmModel, points: Array, config: CandidatesConfig
) -> Tuple[Array, Array, Array]:
    """Return joints on guard (m, k), joints above (m, k) and which points (m,) have both."""
    tip = np.column_stack([points, np.full(len(points), config.tip_height_m)])
    above = np.column_stack([points, np.full(len(points), config.hover_height_m)])
    joints, is_low = arm.inverse(tip)
    hover, is_high = arm.inverse(above)
    return joints, hover, is_low & is_high
