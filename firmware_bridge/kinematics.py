"""Arm geometry: joints <-> tip <-> servo positions, vectorised over many poses.

Joints are yaw, shoulder, elbow, wrist and, on some arms, roll, in radians and in this order; the
gripper stays closed and is not a joint. All but yaw and roll turn in one vertical plane, so the
arm's file gives the pitch of each link at joints 0 and which way each joint turns it.
Source: the vendors' published servo maps; APEX names its arm but gives no kinematics.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Optional, Tuple, Union

import numpy as np

from apex_edge.errors import ConfigError
from apex_edge.types import Array
from firmware_bridge.arm_file import (
    PULSE_MAX_US,
    PULSE_MIN_US,
    USUAL_SIGNS,
    ArmData,
    Body,
    Bus,
    Calibration,
    Gripper,
    Limits,
    Links,
    Pitch,
    read_arm,
    warn_unverified,
)
from firmware_bridge.inverse import Solver, find_first
from firmware_bridge.policy import Policy

__all__ = ["PULSE_MAX_US", "PULSE_MIN_US", "ArmModel", "Gripper", "Limits", "Links", "Pitch"]


@dataclass(frozen=True, eq=False)
class ArmModel:
    """One arm: link lengths, limits and servo map. ``k`` joints (4 or 5), named ``joint_names``.

    ``signs (k,)``, ``limits_rad (k, 2)``, ``rate_rad_s (k,)``, ``accel_rad_s2 (k,)`` (inf: at
    once), ``home_rad (k,)``, ``servo_ids``; ``lag_s`` is the time from the end of a command until
    the tip stands; ``tip_radius_m`` the closed gripper's. ``workspace`` and ``body`` are what the
    guard holds a path against, ``policy`` what the servos are watched for; ``calibration`` is the
    one that the file was made from. ``note`` must be told where ``is_verified`` is false.
    """

    name: str
    bus: Bus
    links: Links
    pitch: Pitch
    gripper: Optional[Gripper]
    workspace: Limits
    body: Body
    joint_names: Tuple[str, ...]
    servo_ids: Tuple[int, ...]
    signs: Array
    zero_ticks: Array
    ticks_per_rad: Array
    limits_rad: Array
    rate_rad_s: Array
    accel_rad_s2: Array
    home_rad: Array
    tip_radius_m: float
    lag_s: float
    servo_time_constant_s: float
    is_verified: bool
    note: str
    policy: Policy
    calibration: Optional[Calibration]

    @property
    def n_joints(self) -> int:
        """Number of joints, the gripper not counted."""
        return len(self.joint_names)

    @property
    def all_ids(self) -> Tuple[int, ...]:
        """Servo ids of the joints and of the gripper, if there is one."""
        return self.servo_ids + (() if self.gripper is None else (self.gripper.servo_id,))

    @property
    def tick_range(self) -> Tuple[int, int]:
        """Lowest and highest position that a servo of this arm takes."""
        return self.bus.ticks

    @classmethod
    def load(cls, name_or_path: Union[str, Path] = "armpi-mini") -> "ArmModel":
        """Read an arm by name (a file in ``firmware_bridge/arms``) or from a TOML path.

        An arm that nobody has verified is logged as a warning, with what is not known of it.

        Raises
        ------
        ConfigError : no such arm, unknown or missing key, value out of range, limits that no
            position of the servo reaches, or a home pose the arm cannot take.
        """
        data = read_arm(name_or_path)
        n = len(data.joints)
        at_rest, is_reachable = _model(data, np.zeros(n)).inverse(np.array(data.home.tip_m))
        if not is_reachable[0]:
            tip_m = list(data.home.tip_m)
            raise ConfigError(f"{data.where} [home]: the arm cannot reach tip_m = {tip_m}")
        warn_unverified(data)
        return _model(data, at_rest[0])

    def pitches(self, q_rad: Array) -> Array:
        """Return the pitch (n, 3) of upper arm, forearm and hand over the horizon."""
        q = np.atleast_2d(np.asarray(q_rad, dtype=np.float64))
        turned = np.cumsum(self.signs[1:4] * q[:, 1:4], axis=1)
        links = self.links
        zero = np.array([links.upper_zero_rad, links.forearm_zero_rad, links.hand_zero_rad])
        result: Array = turned + zero
        return result

    def tip_offset(self, roll_rad: Array) -> Tuple[Array, Array]:
        """Return how far (n,) the tip is above (level hand) and left of the hand's roll axis."""
        up, left = self.links.tip_up_m, self.links.tip_left_m
        cos, sin = np.cos(roll_rad), np.sin(roll_rad)
        return up * cos + left * sin, left * cos - up * sin

    def roll(self, q_rad: Array) -> Array:
        """Return by how much (n,) the hand's top is turned to its right."""
        q = np.atleast_2d(np.asarray(q_rad, dtype=np.float64))
        result: Array = self.signs[4] * q[:, 4] if self.n_joints > 4 else np.zeros(len(q))
        return result

    def forward(self, q_rad: Array) -> Array:
        """Return shoulder, elbow, wrist and tip (n, 4, 3) in metres for joints (n, k)."""
        q = np.atleast_2d(np.asarray(q_rad, dtype=np.float64))
        links, angle = self.links, self.pitches(q)
        up, left = self.tip_offset(self.roll(q))
        length = np.array([links.upper_m, links.forearm_m, links.hand_m])
        reach = np.full((len(q), 4), links.shoulder_forward_m)
        height = np.full((len(q), 4), links.shoulder_height_m)
        side = np.full((len(q), 4), links.shoulder_left_m)
        cos, sin = np.cos(angle), np.sin(angle)
        reach[:, 1:] += np.cumsum(length * cos, axis=1)
        height[:, 1:] += np.cumsum(length * sin, axis=1)
        reach[:, 3] -= up * sin[:, 2]
        height[:, 3] += up * cos[:, 2]
        side[:, 3] += links.hand_left_m + left
        yaw = self.signs[0] * q[:, :1]
        c, s = np.cos(yaw), np.sin(yaw)
        x = links.axis_m[0] + reach * c - side * s
        return np.stack([x, links.axis_m[1] + reach * s + side * c, height], axis=2)

    def tip(self, q_rad: Array) -> Array:
        """Return the tip (n, 3) in metres for joints (n, k)."""
        result: Array = self.forward(q_rad)[:, 3]
        return result

    def gripper_pose(self, q_rad: Array) -> Array:
        """Return base_from_gripper (n, 4, 4) for joints (n, k).

        The gripper's origin is the closed tip, its x points out along the hand, y to the left, and
        z up when the hand is level and not rolled.
        """
        q = np.atleast_2d(np.asarray(q_rad, dtype=np.float64))
        yaw, pitch = self.signs[0] * q[:, 0], self.pitches(q)[:, 2]
        level = np.zeros(len(q))
        out = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
        left = np.stack([-np.sin(yaw), np.cos(yaw), level])
        up = np.cross(out.T, left.T)
        cos, sin = np.cos(self.roll(q))[:, None], np.sin(self.roll(q))[:, None]
        result = np.zeros((len(q), 4, 4))
        result[:, :3, 0], result[:, :3, 1] = out.T, cos * left.T + sin * up
        result[:, :3, 2] = cos * up - sin * left.T
        result[:, :3, 3], result[:, 3, 3] = self.tip(q), 1.0
        return result

    def inverse(self, tip_m: Array, roll_rad: float = 0.0) -> Tuple[Array, Array]:
        """Find joints for tips (n, 3): gripper as near to pointing straight down as feasible.

        Of all pitches of the arm's grid and both elbow branches, reaching forward, the first that
        keeps all joints within their limits and elbow and wrist above the table. ``roll_rad`` is
        the roll joint's angle, where the arm has one.

        Returns
        -------
        joints (n, k), NaN where not reachable; is_reachable (n,) bool.
        """
        return find_first(self._solver(), np.atleast_2d(np.asarray(tip_m, np.float64)), roll_rad)

    def inverse_all(
        self, tip_m: Array, pitch_rad: Optional[Array] = None, roll_rad: Optional[Array] = None
    ) -> Array:
        """Return every solution (n, g, 4, k) for tips (n, 3), NaN where there is none.

        Parameters
        ----------
        pitch_rad : gripper pitches (g,) tried for all tips, or (n, g); the grid of the arm's file
            when None, nearest to straight down first.
        roll_rad : angle of the roll joint (n,), 0 when None.

        The branches are: forward with elbow up and down, then bent over backward, likewise. Limits
        and table hold as in ``inverse``; joints are turned by whole turns where limits ask for it.
        """
        tip = np.atleast_2d(np.asarray(tip_m, dtype=np.float64))
        solver = self._solver()
        pitch = solver.pitch_grid_rad() if pitch_rad is None else np.asarray(pitch_rad, np.float64)
        roll = np.zeros(len(tip)) if roll_rad is None else np.asarray(roll_rad, np.float64)
        grid = np.broadcast_to(pitch, (len(tip), pitch.shape[-1]))
        ways = [solver.solve(tip, grid, roll, is_back, True) for is_back in (False, True)]
        joints: Array = np.concatenate([each[0] for each in ways], axis=2)
        joints[~np.concatenate([each[1] for each in ways], axis=2)] = np.nan
        return joints

    def is_reachable(self, tip_m: Array) -> Array:
        """Say which tips (n, 3) the arm can reach in the way that ``inverse`` does."""
        return self.inverse(tip_m)[1]

    def _solver(self) -> Solver:
        return Solver(self.links, self.pitch, self.signs, self.limits_rad)

    def travel_time_s(self, q_from: Array, q_to: Array) -> Array:
        """Return the shortest travel times (n,) from joints (k,) or (n, k) to joints (n, k).

        Each joint speeds up, travels at its rate and slows down again; ``lag_s`` comes on top.
        """
        step = np.abs(np.atleast_2d(q_to) - np.asarray(q_from))
        travel = step / self.rate_rad_s
        j = np.flatnonzero(np.isfinite(self.accel_rad_s2))
        if len(j):
            rate, accel = self.rate_rad_s[j], self.accel_rad_s2[j]
            is_long = step[:, j] * accel >= rate**2
            short_s = 2.0 * np.sqrt(step[:, j] / accel)
            travel[:, j] = np.where(is_long, travel[:, j] + rate / accel, short_s)
        result: Array = travel.max(axis=1)
        return result

    def ticks(self, q_rad: Array) -> Array:
        """Return whole servo positions (..., k) in ticks, kept within what the servos take."""
        exact = np.rint(self.zero_ticks + self.ticks_per_rad * np.asarray(q_rad, dtype=np.float64))
        whole: Array = np.clip(exact, *self.tick_range).astype(np.int64)
        return whole

    def angles_rad(self, ticks: Array) -> Array:
        """Return joint angles (..., k) for servo positions in ticks."""
        result: Array = (np.asarray(ticks, dtype=np.float64) - self.zero_ticks) / self.ticks_per_rad
        return result


def _model(data: ArmData, home_rad: Array) -> ArmModel:
    joints = list(data.joints.values())
    signs = [j.sign if j.sign else usual for j, usual in zip(joints, USUAL_SIGNS)]
    accel = np.array([j.accel_rad_s2 if j.accel_rad_s2 > 0.0 else np.inf for j in joints])
    return ArmModel(
        name=data.head.name,
        bus=data.bus,
        links=data.links,
        pitch=data.pitch,
        gripper=data.gripper,
        workspace=data.workspace,
        body=data.body,
        joint_names=tuple(data.joints),
        servo_ids=tuple(j.servo_id for j in joints),
        signs=np.array(signs, dtype=np.float64),
        zero_ticks=np.array([j.zero_ticks + j.offset_ticks for j in joints]),
        ticks_per_rad=np.array([j.ticks_per_rad for j in joints]),
        limits_rad=np.array([[j.low_rad, j.high_rad] for j in joints]),
        rate_rad_s=np.array([j.rate_rad_s for j in joints]),
        accel_rad_s2=accel,
        home_rad=home_rad,
        tip_radius_m=data.head.tip_radius_m,
        lag_s=data.head.lag_s,
        servo_time_constant_s=data.head.servo_time_constant_s,
        is_verified=data.head.is_verified,
        note=data.head.note,
        policy=data.policy,
        calibration=data.calibration,
    )
