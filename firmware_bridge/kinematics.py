"""Arm geometry: joints <-> tip <-> servo pulses, vectorised over many poses.

Joints are (yaw, shoulder, elbow, wrist) in radians; the gripper stays closed and is not a joint.
In the vertical plane of the arm the links point, over the horizon, at ``shoulder``,
``shoulder - elbow`` and ``shoulder - elbow + wrist`` (the last is the gripper's pitch).
Source: the vendor's published servo map; APEX names the arm but gives no kinematics.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Mapping, Tuple, Union

import numpy as np

from apex_edge.config import read_toml, setting, structure
from apex_edge.errors import ConfigError
from apex_edge.types import Array

JOINT_NAMES = ("yaw", "shoulder", "elbow", "wrist")
PULSE_MIN_US, PULSE_MAX_US = 500, 2500
_ARMS = Path(__file__).parent / "arms"
_SECTIONS = ("links", "pitch", "home", "gripper", "joints")
# Rounding of asin/acos may leave a joint this far outside a limit it exactly stands on.
_SLACK_RAD = 1e-9


@dataclass(frozen=True)
class _Head:
    name: str = setting("", "name of the arm")
    tip_radius_m: float = setting(0.012, "radius of the closed gripper", 0.001, 0.1)
    lag_s: float = setting(0.08, "end of a command until the tip stands", 0.0, 1.0)
    servo_time_constant_s: float = setting(0.02, "first-order lag of one servo", 0.001, 0.5)


@dataclass(frozen=True)
class Links:
    """Link lengths in metres."""

    shoulder_height_m: float = setting(0.0, "table to shoulder axis", 0.005, 1.0)
    upper_m: float = setting(0.0, "shoulder to elbow", 0.005, 1.0)
    forearm_m: float = setting(0.0, "elbow to wrist", 0.005, 1.0)
    hand_m: float = setting(0.0, "wrist to closed tip", 0.005, 1.0)


@dataclass(frozen=True)
class Pitch:
    """Which gripper pitches the inverse may use, degrees over the horizon."""

    low_deg: float = setting(-90.0, "steepest pitch", -180.0, 0.0)
    high_deg: float = setting(0.0, "shallowest pitch", -90.0, 90.0)
    step_deg: float = setting(1.0, "grid of the search", 0.1, 15.0)
    min_link_z_m: float = setting(0.015, "lowest elbow and wrist", 0.0, 0.5)


@dataclass(frozen=True)
class _Home:
    tip_m: Tuple[float, float, float] = setting((0.06, 0.0, 0.18), "tip at rest", -1.0, 1.0)


@dataclass(frozen=True)
class Gripper:
    """The gripper's servo; it stays closed while the arm acts as a barrier."""

    servo_id: int = setting(1, "servo id", 1, 253)
    open_ticks: int = setting(1900, "pulse when open", PULSE_MIN_US, PULSE_MAX_US)
    closed_ticks: int = setting(1500, "pulse when closed", PULSE_MIN_US, PULSE_MAX_US)


@dataclass(frozen=True)
class _Joint:
    servo_id: int = setting(0, "servo id", 1, 253)
    zero_ticks: float = setting(1500.0, "pulse at angle 0", 0.0, 4000.0)
    ticks_per_rad: float = setting(0.0, "pulse per radian, sign included", -2000.0, 2000.0)
    offset_ticks: float = setting(0.0, "deviation found by calibration", -300.0, 300.0)
    low_rad: float = setting(0.0, "lower limit", -7.0, 7.0)
    high_rad: float = setting(0.0, "upper limit", -7.0, 7.0)
    rate_rad_s: float = setting(3.0, "highest speed", 0.01, 50.0)


@dataclass(frozen=True, eq=False)
class ArmModel:
    """One arm: link lengths, limits and servo map. ``k = 4`` joints, named in ``joint_names``.

    ``limits_rad (k, 2)``, ``rate_rad_s (k,)``, ``home_rad (k,)``, ``servo_ids``; ``lag_s`` is the
    time from the end of a command until the tip stands; ``tip_radius_m`` the closed gripper's.
    """

    name: str
    links: Links
    pitch: Pitch
    gripper: Gripper
    joint_names: Tuple[str, ...]
    servo_ids: Tuple[int, ...]
    zero_ticks: Array
    ticks_per_rad: Array
    limits_rad: Array
    rate_rad_s: Array
    home_rad: Array
    tip_radius_m: float
    lag_s: float
    servo_time_constant_s: float

    @property
    def n_joints(self) -> int:
        """Number of joints, the gripper not counted."""
        return len(self.joint_names)

    @classmethod
    def load(cls, name_or_path: Union[str, Path] = "armpi-mini") -> "ArmModel":
        """Read an arm by name (a file in ``firmware_bridge/arms``) or from a TOML path.

        Raises
        ------
        ConfigError : no such arm, unknown or missing key, value out of range, limits that no
            pulse reaches, or a home pose the arm cannot take.
        """
        path = Path(name_or_path)
        if path.suffix != ".toml":
            path = _ARMS / f"{name_or_path}.toml"
            if not path.is_file():
                known = ", ".join(sorted(p.stem for p in _ARMS.glob("*.toml")))
                raise ConfigError(f"no arm is named {str(name_or_path)!r}; known: {known}")
        return _build(read_toml(path), str(path))

    def forward(self, q_rad: Array) -> Array:
        """Return shoulder, elbow, wrist and tip (n, 4, 3) in metres for joints (n, k)."""
        q = np.atleast_2d(np.asarray(q_rad, dtype=np.float64))
        angle = np.stack([q[:, 1], q[:, 1] - q[:, 2], q[:, 1] - q[:, 2] + q[:, 3]], axis=1)
        length = np.array([self.links.upper_m, self.links.forearm_m, self.links.hand_m])
        reach = np.zeros((len(q), 4))
        height = np.full((len(q), 4), self.links.shoulder_height_m)
        reach[:, 1:] = np.cumsum(length * np.cos(angle), axis=1)
        height[:, 1:] += np.cumsum(length * np.sin(angle), axis=1)
        yaw = q[:, :1]
        return np.stack([reach * np.cos(yaw), reach * np.sin(yaw), height], axis=2)

    def tip(self, q_rad: Array) -> Array:
        """Return the tip (n, 3) in metres for joints (n, k)."""
        result: Array = self.forward(q_rad)[:, 3]
        return result

    def gripper_pose(self, q_rad: Array) -> Array:
        """Return base_from_gripper (n, 4, 4) for joints (n, k).

        The gripper's origin is the closed tip, its x points out along the hand, y to the left, and
        z up when the hand is level.
        """
        q = np.atleast_2d(np.asarray(q_rad, dtype=np.float64))
        yaw, pitch = q[:, 0], q[:, 1] - q[:, 2] + q[:, 3]
        level = np.zeros(len(q))
        out = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)])
        left = np.stack([-np.sin(yaw), np.cos(yaw), level])
        result = np.zeros((len(q), 4, 4))
        result[:, :3, 0], result[:, :3, 1] = out.T, left.T
        result[:, :3, 2] = np.cross(out.T, left.T)
        result[:, :3, 3], result[:, 3, 3] = self.tip(q), 1.0
        return result

    def inverse(self, tip_m: Array) -> Tuple[Array, Array]:
        """Find joints for tips (n, 3): gripper as near to pointing straight down as feasible.

        Every pitch of the grid and both elbow branches are tried at once; a solution keeps all
        joints within their limits and elbow and wrist above the table.

        Returns
        -------
        joints (n, k), NaN where not reachable; is_reachable (n,) bool.
        """
        tip = np.atleast_2d(np.asarray(tip_m, dtype=np.float64))
        pitch = self._pitch_grid_rad()
        yaw = np.arctan2(tip[:, 1], tip[:, 0])
        reach = np.hypot(tip[:, 0], tip[:, 1])[:, None] - self.links.hand_m * np.cos(pitch)
        height = (tip[:, 2] - self.links.shoulder_height_m)[:, None]
        height = height - self.links.hand_m * np.sin(pitch)
        planar = _two_links(reach, height, self.links)
        joints = np.empty(planar.shape[:-1] + (4,))
        joints[..., 0] = yaw[:, None, None]
        joints[..., 1:3] = planar
        joints[..., 3] = pitch[:, None] - planar[..., 0] + planar[..., 1]
        is_ok = self._is_feasible(joints, height)
        flat_ok = is_ok.reshape(len(tip), -1)
        choice = np.argmax(flat_ok, axis=1)  # the grid is in order of preference
        rows = np.arange(len(tip))
        is_reachable: Array = flat_ok[rows, choice]
        found = joints.reshape(len(tip), -1, 4)[rows, choice]
        low, high = self.limits_rad[:, 0], self.limits_rad[:, 1]
        found[is_reachable] = np.clip(found[is_reachable], low, high)
        found[~is_reachable] = np.nan
        return found, is_reachable

    def _pitch_grid_rad(self) -> Array:
        n_steps = int(round((self.pitch.high_deg - self.pitch.low_deg) / self.pitch.step_deg))
        grid = np.linspace(self.pitch.low_deg, self.pitch.high_deg, n_steps + 1)
        ordered: Array = np.deg2rad(grid[np.argsort(np.abs(grid + 90.0), kind="stable")])
        return ordered

    def _is_feasible(self, joints: Array, wrist_height: Array) -> Array:
        """Check limits and table for joints (n, g, 2, k); NaN compares false and so fails."""
        floor = self.pitch.min_link_z_m - self.links.shoulder_height_m
        with np.errstate(invalid="ignore"):
            low = joints >= self.limits_rad[:, 0] - _SLACK_RAD
            is_ok = (low & (joints <= self.limits_rad[:, 1] + _SLACK_RAD)).all(axis=-1)
            is_ok &= self.links.upper_m * np.sin(joints[..., 1]) >= floor
            is_ok &= (wrist_height >= floor)[..., None]
        result: Array = is_ok
        return result

    def travel_time_s(self, q_from: Array, q_to: Array) -> Array:
        """Return the shortest travel times (n,) from joints (k,) or (n, k) to joints (n, k)."""
        step = np.abs(np.atleast_2d(q_to) - np.asarray(q_from))
        result: Array = (step / self.rate_rad_s).max(axis=1)
        return result

    def ticks(self, q_rad: Array) -> Array:
        """Return whole servo pulses (..., k) in microseconds, kept within 500..2500."""
        pulse = np.rint(self.zero_ticks + self.ticks_per_rad * np.asarray(q_rad, dtype=np.float64))
        whole: Array = np.clip(pulse, PULSE_MIN_US, PULSE_MAX_US).astype(np.int64)
        return whole

    def angles_rad(self, pulses_us: Array) -> Array:
        """Return joint angles (..., k) for servo pulses in microseconds."""
        pulses = np.asarray(pulses_us, dtype=np.float64)
        result: Array = (pulses - self.zero_ticks) / self.ticks_per_rad
        return result


def _two_links(reach: Array, height: Array, links: Links) -> Array:
    """Solve shoulder and elbow for wrist points (n, g): (n, g, 2 branches, 2), NaN when too far."""
    upper, fore = links.upper_m, links.forearm_m
    with np.errstate(invalid="ignore", over="ignore"):
        cosine = (reach**2 + height**2 - upper**2 - fore**2) / (2.0 * upper * fore)
        bend = np.arccos(cosine)
    elbow = np.stack([bend, -bend], axis=-1)  # elbow up first
    inward = np.arctan2(fore * np.sin(elbow), upper + fore * np.cos(elbow))
    shoulder = np.arctan2(height, reach)[..., None] + inward
    return np.stack([shoulder, elbow], axis=-1)


def _build(data: Mapping[str, Any], where: str) -> ArmModel:
    sections = {key: data.get(key, {}) for key in _SECTIONS}
    head = structure(_Head, {k: v for k, v in data.items() if k not in _SECTIONS}, where)
    joint_data = sections["joints"]
    if not isinstance(joint_data, Mapping) or tuple(joint_data) != JOINT_NAMES:
        raise ConfigError(
            f"{where}: [joints] must hold {', '.join(JOINT_NAMES)} in this order, "
            f"found {list(joint_data)}"
        )
    joints = [_section(_Joint, joint_data[n], f"{where} [joints.{n}]") for n in JOINT_NAMES]
    links = _section(Links, sections["links"], f"{where} [links]")
    home = _section(_Home, sections["home"], f"{where} [home]")
    fields = {
        "name": head.name,
        "links": links,
        "pitch": _section(Pitch, sections["pitch"], f"{where} [pitch]"),
        "gripper": _section(Gripper, sections["gripper"], f"{where} [gripper]"),
        "joint_names": JOINT_NAMES,
        "servo_ids": tuple(j.servo_id for j in joints),
        "zero_ticks": np.array([j.zero_ticks + j.offset_ticks for j in joints]),
        "ticks_per_rad": np.array([j.ticks_per_rad for j in joints]),
        "limits_rad": np.array([[j.low_rad, j.high_rad] for j in joints]),
        "rate_rad_s": np.array([j.rate_rad_s for j in joints]),
        "tip_radius_m": head.tip_radius_m,
        "lag_s": head.lag_s,
        "servo_time_constant_s": head.servo_time_constant_s,
    }
    _check(fields, where)
    at_rest, is_reachable = ArmModel(home_rad=np.zeros(4), **fields).inverse(np.array(home.tip_m))
    if not is_reachable[0]:
        raise ConfigError(f"{where} [home]: the arm cannot reach tip_m = {list(home.tip_m)}")
    return ArmModel(home_rad=at_rest[0], **fields)


def _section(kind: Any, values: Any, where: str) -> Any:
    """Read one section in which nothing may be left to a default except an offset."""
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where} must be a table, found {values!r}")
    for key in kind.__dataclass_fields__:
        if key not in values and key != "offset_ticks":
            raise ConfigError(f"{where}: key {key!r} is missing")
    return structure(kind, values, where)


def _check(fields: Mapping[str, Any], where: str) -> None:
    ids = (*fields["servo_ids"], fields["gripper"].servo_id)
    if len(set(ids)) != len(ids):
        raise ConfigError(f"{where}: two servos share an id: {ids}")
    limits = fields["limits_rad"]
    pulses = fields["zero_ticks"] + fields["ticks_per_rad"] * limits.T
    for j, name in enumerate(JOINT_NAMES):
        if not limits[j, 0] < limits[j, 1]:
            raise ConfigError(f"{where} [joints.{name}]: low_rad must be below high_rad")
        if fields["ticks_per_rad"][j] == 0.0:
            raise ConfigError(f"{where} [joints.{name}]: ticks_per_rad must not be 0")
        ends = np.rint(pulses[:, j])
        if ends.min() < PULSE_MIN_US or ends.max() > PULSE_MAX_US:
            raise ConfigError(
                f"{where} [joints.{name}]: the limits need pulses {ends.min():.0f}.."
                f"{ends.max():.0f} us, servos take {PULSE_MIN_US}..{PULSE_MAX_US}"
            )
