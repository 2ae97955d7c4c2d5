"""Inverse kinematics in closed form: for a tip and a pitch of the hand, up to four ways to stand.

Yaw has two (reach forward, or bend over backward), shoulder and elbow two more. Pure functions of
many poses at once. Source: ours (law of cosines).
"""

from typing import NamedTuple, Tuple

import numpy as np

from apex_edge.types import Array
from firmware_bridge.arm_file import Links, Pitch

# Rounding of asin/acos may leave a joint this far outside a limit it exactly stands on.
_SLACK_RAD = 1e-9
_BLOCK = 12  # pitches tried at once; most tips are settled within the first few blocks


class Solver(NamedTuple):
    """What the solution depends on: ``signs (k,)``, ``limits_rad (k, 2)``."""

    links: Links
    pitch: Pitch
    signs: Array
    limits_rad: Array

    def pitch_grid_rad(self) -> Array:
        """Return the pitches (g,) that may be tried, nearest to straight down first."""
        pitch = self.pitch
        n_steps = int(round((pitch.high_deg - pitch.low_deg) / pitch.step_deg))
        grid = np.linspace(pitch.low_deg, pitch.high_deg, n_steps + 1)
        ordered: Array = np.deg2rad(grid[np.argsort(np.abs(grid + 90.0), kind="stable")])
        return ordered

    def solve(
        self, tip_m: Array, pitch_rad: Array, roll_rad: Array, is_back: bool, is_wrapped: bool
    ) -> Tuple[Array, Array]:
        """Solve for tips (n, 3), a pitch each (n, g) and the roll joint's angle (n,).

        With ``is_wrapped`` whole turns are added where they bring a joint into its limits.

        Returns
        -------
        joints (n, g, 2, k), elbow up first, NaN where too far; is_ok (n, g, 2): within the joints'
        limits, with elbow and wrist above the table.
        """
        links, n_joints = self.links, len(self.signs)
        azimuth, forward, up = self._in_plane(tip_m, roll_rad, is_back)
        cos, sin = np.cos(pitch_rad), np.sin(pitch_rad)
        reach = (forward - links.shoulder_forward_m)[:, None] - links.hand_m * cos
        height = (tip_m[:, 2] - links.shoulder_height_m)[:, None] - links.hand_m * sin
        if links.tip_up_m != 0.0 or links.tip_left_m != 0.0:
            reach, height = reach + up[:, None] * sin, height - up[:, None] * cos
        upper, bend = _two_links(reach, height, links)
        joints = np.empty(upper.shape + (n_joints,))
        joints[..., 0] = (self.signs[0] * azimuth)[:, None, None]
        joints[..., 1] = self.signs[1] * (upper - links.upper_zero_rad)
        at_zero = links.forearm_zero_rad - links.upper_zero_rad
        joints[..., 2] = self.signs[2] * (-bend - at_zero)
        hand = (pitch_rad[..., None] - upper) + bend
        at_zero = links.hand_zero_rad - links.forearm_zero_rad
        joints[..., 3] = self.signs[3] * (hand - at_zero)
        if n_joints > 4:
            joints[..., 4] = roll_rad[:, None, None]
        if is_wrapped:
            self._wrap(joints)
        return joints, self._is_feasible(joints, upper, height)

    def _in_plane(self, tip_m: Array, roll_rad: Array, is_back: bool) -> Tuple[Array, Array, Array]:
        """Return yaw's azimuth, how far forward the tip is, and its height over the roll axis."""
        links = self.links
        roll = self.signs[4] * roll_rad if len(self.signs) > 4 else roll_rad
        x, y = tip_m[:, 0] - links.axis_m[0], tip_m[:, 1] - links.axis_m[1]
        up = links.tip_up_m * np.cos(roll) + links.tip_left_m * np.sin(roll)
        side = links.tip_left_m * np.cos(roll) - links.tip_up_m * np.sin(roll)
        side = side + links.shoulder_left_m + links.hand_left_m
        with np.errstate(invalid="ignore", over="ignore"):
            if not side.any():
                forward, aside = np.hypot(x, y), np.zeros(len(x))
            else:
                forward = np.sqrt(x * x + y * y - side * side)
                aside = np.arctan2(side, forward)
            azimuth = np.arctan2(y, x) - aside
        if is_back:
            forward, azimuth = -forward, azimuth + np.pi + 2.0 * aside
            azimuth = azimuth - 2.0 * np.pi * (azimuth > np.pi)
        return azimuth, forward, up

    def _wrap(self, joints: Array) -> None:
        """Turn joints by whole turns into their limits, where that helps."""
        with np.errstate(invalid="ignore"):
            for j in range(4):
                low, high = self.limits_rad[j]
                value = joints[..., j]
                too_low = value < low - _SLACK_RAD
                too_high = value > high + _SLACK_RAD
                if too_low.any():
                    value[too_low] += 2.0 * np.pi
                if too_high.any():
                    value[too_high] -= 2.0 * np.pi

    def _is_feasible(self, joints: Array, upper: Array, wrist_height: Array) -> Array:
        """Check limits and table for joints (n, g, 2, k); NaN compares false and so fails."""
        floor = self.pitch.min_link_z_m - self.links.shoulder_height_m
        with np.errstate(invalid="ignore"):
            is_ok = self.links.upper_m * np.sin(upper) >= floor
            is_ok &= (wrist_height >= floor)[..., None]
            for j in range(joints.shape[-1]):
                low, high = self.limits_rad[j]
                is_ok &= joints[..., j] >= low - _SLACK_RAD
                is_ok &= joints[..., j] <= high + _SLACK_RAD
        result: Array = is_ok
        return result


def find_first(solver: Solver, tip_m: Array, roll_rad: float) -> Tuple[Array, Array]:
    """Return the first feasible joints (n, k) for tips (n, 3) in the order of the pitch grid.

    Pitches are tried block by block, and only for the tips that are not settled yet.
    """
    grid = solver.pitch_grid_rad()
    found = np.full((len(tip_m), len(solver.signs)), np.nan)
    is_found = np.zeros(len(tip_m), dtype=bool)
    left = np.flatnonzero(_is_in_reach(solver, tip_m))
    for at in range(0, len(grid), _BLOCK):
        if not len(left):
            break
        pitch = np.broadcast_to(grid[at : at + _BLOCK], (len(left), len(grid[at : at + _BLOCK])))
        joints, is_ok = solver.solve(tip_m[left], pitch, np.full(len(left), roll_rad), False, False)
        flat_ok = is_ok.reshape(len(left), -1)
        choice = np.argmax(flat_ok, axis=1)
        rows = np.flatnonzero(flat_ok[np.arange(len(left)), choice])
        picked = joints.reshape(len(left), -1, joints.shape[-1])[rows, choice[rows]]
        low, high = solver.limits_rad[:, 0], solver.limits_rad[:, 1]
        found[left[rows]] = np.clip(picked, low, high)
        is_found[left[rows]] = True
        left = left[~is_found[left]]
    return found, is_found


def _is_in_reach(solver: Solver, tip_m: Array) -> Array:
    """Leave out tips farther away than the whole arm is long, and those that are not finite."""
    links = solver.links
    far = links.reach_m + 1e-6
    with np.errstate(invalid="ignore", over="ignore"):
        near = np.abs(tip_m[:, 0] - links.axis_m[0]) <= far
        near &= np.abs(tip_m[:, 1] - links.axis_m[1]) <= far
        near &= np.abs(tip_m[:, 2] - links.shoulder_height_m) <= far
    result: Array = near
    return result


def _two_links(reach: Array, height: Array, links: Links) -> Tuple[Array, Array]:
    """Solve the upper arm's pitch and the bend down to the forearm for wrist points (n, g).

    Returns both (n, g, 2 branches), NaN when too far; elbow up first.
    """
    upper, fore = links.upper_m, links.forearm_m
    with np.errstate(invalid="ignore", over="ignore"):
        cosine = (reach**2 + height**2 - upper**2 - fore**2) / (2.0 * upper * fore)
        bent = np.arccos(cosine)
    bend = np.stack([bent, -bent], axis=-1)
    inward = np.arctan2(fore * np.sin(bend), upper + fore * np.cos(bend))
    return np.arctan2(height, reach)[..., None] + inward, bend
