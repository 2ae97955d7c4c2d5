"""Arm data files: one TOML file a model of arm, read strictly; a copy may build on another file.

``docs/hardware/add-your-arm.md`` explains every key. Source: ours.
"""

import logging
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

from apex_edge.config import read_toml, setting, structure
from apex_edge.errors import ConfigError
from firmware_bridge.codec import PROTOCOLS
from firmware_bridge.policy import Policy, check_policy

_LOG = logging.getLogger(__name__)
ARMS = Path(__file__).parent / "arms"
_SECTIONS = (
    *("bus", "links", "pitch", "home", "gripper", "workspace", "body", "joints"),
    *("policy", "calibration"),
)
_MAX_LIKE = 8
PULSE_MIN_US, PULSE_MAX_US = 500, 2500
# What each protocol's servos take, unless [bus] low_ticks and high_ticks say otherwise.
_TICK_RANGES: Dict[str, Tuple[int, int]] = {
    "lx16a": (0, 1000),
    "lsc": (0, 1000),
    "lsc-pwm": (500, 2500),
    "rrc": (PULSE_MIN_US, PULSE_MAX_US),
    "rrc-bus": (0, 1000),
    "sts": (0, 4095),
    "dxl2": (0, 4095),
    "i2c": (PULSE_MIN_US, PULSE_MAX_US),
}
REJECT, CLAMP = "reject", "clamp"
_Place = Tuple[float, float, float]


def _maybe(default: Any, doc: str, *allowed: Any) -> Any:
    """Declare a key that a file may leave out, with its range; all others must be there."""
    meta: Dict[str, Any] = {"doc": doc, "is_optional": True}
    if isinstance(default, str):
        meta["choices"] = allowed[0]
    elif allowed:
        meta["low"], meta["high"] = allowed
    return field(default=default, metadata=meta)


@dataclass(frozen=True)
class Head:
    """The keys above the first section."""

    name: str = setting("", "name of the arm")
    tip_radius_m: float = setting(0.012, "radius of the closed gripper", 0.001, 0.1)
    lag_s: float = setting(0.08, "end of a command until the tip stands", 0.0, 1.0)
    servo_time_constant_s: float = setting(0.02, "first-order lag of one servo", 0.001, 0.5)
    is_verified: bool = setting(True, "whether the numbers were checked against a real arm's")
    note: str = setting("", "what a user must know before the arm moves")


@dataclass(frozen=True)
class Bus:
    """Section ``[bus]``: what the servos or their board speak. ``ticks`` is what they take."""

    protocol: str = setting("", "wire protocol", choices=tuple(PROTOCOLS))
    baud: int = _maybe(0, "bits per second, 0: the protocol's own", 0, 4_000_000)
    low_ticks: int = _maybe(-1, "lowest position, -1: the protocol's own", -1, 100_000)
    high_ticks: int = _maybe(-1, "highest position, -1: the protocol's own", -1, 100_000)
    model: int = _maybe(0, "model number the servos must report, 0: any", 0, 65_535)
    i2c_bus: int = _maybe(1, "number of the I2C bus", 0, 255)
    i2c_address: int = _maybe(0x7A, "address of the board on the I2C bus", 3, 127)

    @property
    def ticks(self) -> Tuple[int, int]:
        """Lowest and highest position that may be commanded."""
        low, high = _TICK_RANGES[self.protocol]
        return (
            low if self.low_ticks < 0 else self.low_ticks,
            high if self.high_ticks < 0 else self.high_ticks,
        )


@dataclass(frozen=True)
class Links:
    """Link lengths in metres, and how the links stand when every joint is at 0.

    The arm stands in a vertical plane that yaw turns about a vertical axis at ``axis_m``. Lengths
    to the left are seen along the arm; a pitch is over the horizon.
    """

    shoulder_height_m: float = setting(0.0, "table to shoulder axis", 0.005, 1.0)
    upper_m: float = setting(0.0, "shoulder to elbow", 0.005, 1.0)
    forearm_m: float = setting(0.0, "elbow to wrist", 0.005, 1.0)
    hand_m: float = setting(0.0, "wrist to closed tip, along the hand", 0.005, 1.0)
    axis_m: Tuple[float, float] = _maybe((0.0, 0.0), "x and y of the yaw axis", -1.0, 1.0)
    shoulder_forward_m: float = _maybe(0.0, "yaw axis to shoulder axis", -0.5, 0.5)
    shoulder_left_m: float = _maybe(0.0, "yaw axis to the plane of the links", -0.5, 0.5)
    hand_left_m: float = _maybe(0.0, "plane of the links to the hand's roll axis", -0.5, 0.5)
    tip_up_m: float = _maybe(0.0, "tip above the roll axis when the hand is level", -0.5, 0.5)
    tip_left_m: float = _maybe(0.0, "tip to the left of the roll axis", -0.5, 0.5)
    upper_zero_rad: float = _maybe(0.0, "pitch of the upper arm at joints 0", -7.0, 7.0)
    forearm_zero_rad: float = _maybe(0.0, "pitch of the forearm at joints 0", -7.0, 7.0)
    hand_zero_rad: float = _maybe(0.0, "pitch of the hand at joints 0", -7.0, 7.0)

    @property
    def reach_m(self) -> float:
        """The farthest that a point of the arm can be from the yaw axis."""
        return (
            abs(self.shoulder_forward_m)
            + abs(self.shoulder_left_m)
            + abs(self.hand_left_m)
            + abs(self.tip_up_m)
            + abs(self.tip_left_m)
            + self.upper_m
            + self.forearm_m
            + self.hand_m
        )


@dataclass(frozen=True)
class Pitch:
    """Which gripper pitches the inverse may use, degrees over the horizon."""

    low_deg: float = setting(-90.0, "steepest pitch", -180.0, 0.0)
    high_deg: float = setting(0.0, "shallowest pitch", -90.0, 90.0)
    step_deg: float = setting(1.0, "grid of the search", 0.1, 15.0)
    min_link_z_m: float = setting(0.015, "lowest elbow and wrist", 0.0, 0.5)


@dataclass(frozen=True)
class Home:
    """Section ``[home]``."""

    tip_m: _Place = setting((0.06, 0.0, 0.18), "tip at rest", -1.0, 1.0)


@dataclass(frozen=True)
class Gripper:
    """The gripper's servo; it stays closed while the arm acts as a barrier."""

    servo_id: int = setting(1, "servo id", 1, 253)
    open_ticks: int = setting(1900, "position when open", 0, 100_000)
    closed_ticks: int = setting(1500, "position when closed", 0, 100_000)


@dataclass(frozen=True)
class Limits:
    """Section ``[workspace]``: where the arm may go, on top of its joint limits and rates.

    The defaults are those of the ArmPi mini.
    """

    max_step_rad: float = setting(3.2, "largest turn of a joint between way-points", 0.01, 7.0)
    max_duration_s: float = setting(30.0, "longest segment", 0.1, 300.0)
    min_tip_z_m: float = setting(0.003, "table plane for the tip", 0.0, 0.5)
    min_link_z_m: float = setting(0.010, "table plane for elbow and wrist", 0.0, 0.5)
    base_radius_m: float = setting(0.045, "the tip keeps out of this radius, below z", 0.0, 0.5)
    base_height_m: float = setting(0.088, "height of the base that the tip keeps out of", 0.0, 0.5)
    box_low_m: _Place = setting((-0.15, -0.25, 0.0), "workspace", -2.0, 2.0)
    box_high_m: _Place = setting((0.25, 0.25, 0.35), "workspace", -2.0, 2.0)
    mode: str = _maybe(REJECT, "refuse what breaks a limit, or bring it there", (REJECT, CLAMP))


@dataclass(frozen=True)
class Body:
    """Section ``[body]``: half the thickness of each part, for the arm not to hit itself."""

    column_radius_m: float = setting(0.0, "base column about the yaw axis", 0.0, 0.3)
    column_height_m: float = setting(0.0, "top of the base column", 0.0, 1.0)
    upper_radius_m: float = setting(0.0, "upper arm", 0.0, 0.2)
    forearm_radius_m: float = setting(0.0, "forearm", 0.0, 0.2)
    hand_radius_m: float = setting(0.0, "hand and gripper", 0.0, 0.2)


@dataclass(frozen=True)
class Joint:
    """One section ``[joints.NAME]``: ``ticks = zero_ticks + offset_ticks + ticks_per_rad * rad``.

    ``sign`` is +1 where a positive angle turns left (yaw), raises the link (shoulder, elbow, wrist)
    or turns the hand's top to its right (roll, seen along the hand), else -1.
    """

    servo_id: int = setting(0, "servo id", 1, 253)
    zero_ticks: float = setting(0.0, "position at angle 0", -100_000.0, 100_000.0)
    ticks_per_rad: float = setting(0.0, "per radian, sign included", -20_000.0, 20_000.0)
    offset_ticks: float = _maybe(0.0, "deviation found by calibration", -2000.0, 2000.0)
    sign: int = _maybe(0, "+1 or -1, which way a positive angle goes; 0: as usual", -1, 1)
    low_rad: float = setting(0.0, "lower limit", -7.0, 7.0)
    high_rad: float = setting(0.0, "upper limit", -7.0, 7.0)
    rate_rad_s: float = setting(3.0, "highest speed", 0.01, 50.0)
    accel_rad_s2: float = _maybe(0.0, "highest acceleration, 0: at once", 0.0, 10_000.0)


@dataclass(frozen=True)
class Calibration:
    """Section ``[calibration]``: the servo calibration that the joints' ticks were taken from."""

    file: str = setting("", "its path, from this file's folder")
    sha256: str = setting("", "the hash that it states of itself")


# The usual way: yaw to the left, shoulder up, elbow down, wrist up, roll to the right.
USUAL_SIGNS = (1, 1, -1, 1, 1)


@dataclass(frozen=True)
class ArmData:
    """Everything an arm file says, checked; ``joints`` in the order of the chain."""

    where: str
    head: Head
    bus: Bus
    links: Links
    pitch: Pitch
    home: Home
    gripper: Optional[Gripper]
    workspace: Limits
    body: Body
    joints: Mapping[str, Joint]
    policy: Policy
    calibration: Optional[Calibration]


def known_arms() -> List[str]:
    """Return the names of the arms that are shipped."""
    return sorted(path.stem for path in ARMS.glob("*.toml"))


def read_arm(name_or_path: Union[str, Path]) -> ArmData:
    """Read an arm by name (a file in ``firmware_bridge/arms``) or from a TOML path.

    Raises
    ------
    ConfigError : no such arm, unknown or missing key, value out of range, two servos of one id, or
        limits that no position of the servo reaches.
    """
    path = _path_of(name_or_path, Path())
    arm = _structured(_merged(path, ()), str(path))
    _check(arm)
    return arm


def warn_unverified(arm: ArmData) -> None:
    """Tell whoever uses an arm whose numbers nobody has checked."""
    if not arm.head.is_verified:
        _LOG.warning("arm %s is not verified: %s", arm.head.name, arm.head.note)


def _path_of(name_or_path: Union[str, Path], beside: Path) -> Path:
    if Path(name_or_path).suffix == ".toml":
        return beside / name_or_path
    path = ARMS / f"{name_or_path}.toml"
    if not path.is_file():
        known = ", ".join(known_arms())
        raise ConfigError(f"no arm is named {str(name_or_path)!r}; known: {known}")
    return path


def _merged(path: Path, above: Sequence[Path]) -> Dict[str, Any]:
    """Read a file on top of the one that its key ``like`` names, and so on down."""
    if path in above or len(above) >= _MAX_LIKE:
        raise ConfigError(f"{path}: like = goes round in a circle or too deep")
    data = _with_place(read_toml(path), path)
    like = data.pop("like", None)
    if like is None:
        return data
    if not isinstance(like, str):
        raise ConfigError(f"{path}: like = {like!r} must be the name of an arm or a path")
    return _over(_merged(_path_of(like, path.parent), (*above, path)), data)


def _with_place(data: Dict[str, Any], path: Path) -> Dict[str, Any]:
    """Find the calibration from the file that names it, not from one that is built on it."""
    section = data.get("calibration")
    name = section.get("file") if isinstance(section, dict) else None
    if isinstance(section, dict) and isinstance(name, str):
        data["calibration"] = {**section, "file": str(path.parent / name)}
    return data


def _over(below: Mapping[str, Any], above: Mapping[str, Any]) -> Dict[str, Any]:
    both = dict(below)
    for key, value in above.items():
        old = both.get(key)
        is_table = isinstance(old, Mapping) and isinstance(value, Mapping)
        both[key] = _over(old, value) if is_table else value  # type: ignore[arg-type]
    return both


def _structured(data: Mapping[str, Any], where: str) -> ArmData:
    head = structure(Head, {k: v for k, v in data.items() if k not in _SECTIONS}, where)
    joints = data.get("joints", {})
    if not isinstance(joints, Mapping) or len(joints) not in (4, 5):
        found = list(joints) if isinstance(joints, Mapping) else joints
        raise ConfigError(
            f"{where}: [joints] must hold 4 or 5 joints in the order yaw, shoulder, elbow, wrist "
            f"and roll (under any name), found {found}"
        )
    gripper, calibration = data.get("gripper"), data.get("calibration")
    policy = data.get("policy", {})
    if not isinstance(policy, Mapping):
        raise ConfigError(f"{where} [policy] must be a table, found {policy!r}")
    return ArmData(
        where,
        head,
        _section(Bus, data.get("bus", {}), f"{where} [bus]"),
        _section(Links, data.get("links", {}), f"{where} [links]"),
        _section(Pitch, data.get("pitch", {}), f"{where} [pitch]"),
        _section(Home, data.get("home", {}), f"{where} [home]"),
        None if gripper is None else _section(Gripper, gripper, f"{where} [gripper]"),
        _section(Limits, data.get("workspace", {}), f"{where} [workspace]"),
        _section(Body, data.get("body", {}), f"{where} [body]"),
        {n: _section(Joint, v, f"{where} [joints.{n}]") for n, v in joints.items()},
        structure(Policy, policy, f"{where} [policy]"),
        None
        if calibration is None
        else _section(Calibration, calibration, f"{where} [calibration]"),
    )


def _section(kind: Any, values: Any, where: str) -> Any:
    """Read one section in which nothing may be left to a default that does not say so."""
    if not isinstance(values, Mapping):
        raise ConfigError(f"{where} must be a table, found {values!r}")
    for spec in fields(kind):
        if spec.name not in values and not spec.metadata.get("is_optional"):
            raise ConfigError(f"{where}: key {spec.name!r} is missing")
    return structure(kind, values, where)


def _check(arm: ArmData) -> None:
    ids = tuple(joint.servo_id for joint in arm.joints.values())
    if arm.gripper is not None:
        ids += (arm.gripper.servo_id,)
    if len(set(ids)) != len(ids):
        raise ConfigError(f"{arm.where}: two servos share an id: {ids}")
    if not (arm.head.is_verified or arm.head.note):
        raise ConfigError(f"{arm.where}: is_verified = false needs a note that says what is not")
    check_policy(arm.policy, f"{arm.where} [policy]")
    low, high = arm.bus.ticks
    if not low < high:
        raise ConfigError(f"{arm.where} [bus]: low_ticks = {low} must be below high_ticks = {high}")
    if arm.gripper is not None:
        for name in ("open_ticks", "closed_ticks"):
            value = getattr(arm.gripper, name)
            if not low <= value <= high:
                raise ConfigError(
                    f"{arm.where} [gripper]: {name} = {value}, servos take {low}..{high}"
                )
    if not all(a < b for a, b in zip(arm.workspace.box_low_m, arm.workspace.box_high_m)):
        raise ConfigError(f"{arm.where} [workspace]: box_low_m must be below box_high_m")
    for name, joint in arm.joints.items():
        _check_joint(joint, f"{arm.where} [joints.{name}]", (low, high))


def _check_joint(joint: Joint, where: str, ticks: Tuple[int, int]) -> None:
    if not joint.low_rad < joint.high_rad:
        raise ConfigError(f"{where}: low_rad must be below high_rad")
    if joint.ticks_per_rad == 0.0:
        raise ConfigError(f"{where}: ticks_per_rad must not be 0")
    zero = joint.zero_ticks + joint.offset_ticks
    ends = sorted(round(zero + joint.ticks_per_rad * q) for q in (joint.low_rad, joint.high_rad))
    if ends[0] < ticks[0] or ends[1] > ticks[1]:
        raise ConfigError(
            f"{where}: the limits need ticks {ends[0]}..{ends[1]}, "
            f"servos take {ticks[0]}..{ticks[1]}"
        )
