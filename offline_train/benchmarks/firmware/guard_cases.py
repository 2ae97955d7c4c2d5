"""Hostile targets of every class, and an oracle that judges paths without the guard's code.

The oracle multiplies matrices link by link, looks at many points of each link, and knows nothing of
``firmware_bridge.guard`` and ``clearance``. Source: ours.
"""

import contextlib
import time
from collections import Counter
from typing import Any, List, NamedTuple, Optional, Tuple

import numpy as np

from apex_edge.types import Array
from apex_edge.verbs.progress import Progress
from firmware_bridge.errors import MotionRefused
from firmware_bridge.guard import CheckedPath, check_path
from firmware_bridge.kinematics import ArmModel
from offline_train.benchmarks.lines import Line, at_least, at_most, note

SUITE = "guard"
ARMS = ("armpi-mini", "armpi", "xarm-1s", "so-101", "learm")
N_TARGETS = 200_000
KINDS = (
    "not a number",
    "infinite",
    "huge",
    "outside limits",
    "under the table",
    "over speed",
    "past deadline",
    "hits itself",
    "wrong shape",
    "wrong duration",
    "anywhere",
    "harmless",
)
_N_LOOKS = 120  # poses looked at on each segment
_N_POINTS = 9  # points looked at on each link
_SLACK_M = 1e-4
_ROOM_M = 0.012  # a harmless path stays this far from everything


class Hostile(NamedTuple):
    """One target: what is asked of the arm; ``deadline_s`` is counted from now, None: without."""

    joints_rad: Any
    duration_s: Any
    deadline_s: Optional[float]
    kind: str


def hostile(rng: np.random.Generator, arm: ArmModel) -> Hostile:
    """Return a random target of a random class; "anywhere" and "harmless" may be fine."""
    kind = KINDS[int(rng.integers(len(KINDS)))]
    n = int(rng.integers(1, 4))
    joints = _inside(rng, arm, n)
    times = rng.uniform(0.1, 3.0, n)
    deadline: Optional[float] = None
    if kind in ("not a number", "infinite", "huge"):
        bad = {"not a number": np.nan, "infinite": np.inf, "huge": 1e308}[kind]
        place = joints if rng.uniform() < 0.7 else times
        place[tuple(int(rng.integers(size)) for size in place.shape)] = bad * rng.choice([-1, 1])
    elif kind == "outside limits":
        j = int(rng.integers(arm.n_joints))
        side = int(rng.integers(2))
        beyond = 10.0 ** rng.uniform(-6.0, 2.0)
        joints[-1, j] = arm.limits_rad[j, side] + (beyond if side else -beyond)
    elif kind == "under the table":
        joints = _pick(rng, arm, lambda points: points[:, 1:, 2].min(axis=1) < 0.0)
        times = times[:1]
    elif kind == "over speed":
        times = times * 10.0 ** rng.uniform(-9.0, -1.0)
    elif kind == "past deadline":
        deadline = -float(10.0 ** rng.uniform(-9.0, 6.0))
    elif kind == "hits itself":
        joints = _pick(rng, arm, lambda points: _off_itself(arm, points) < 0.0)
        times = times[:1]
    elif kind == "wrong shape":
        return _misshapen(rng, joints, times)
    elif kind == "wrong duration":
        times[int(rng.integers(n))] = rng.choice([0.0, -1.0, -1e-300, 1e4, 1e308])
    elif kind == "harmless":
        joints = arm.home_rad + rng.uniform(-0.1, 0.1, (n, arm.n_joints))
        joints = np.clip(joints, arm.limits_rad[:, 0], arm.limits_rad[:, 1])
    return Hostile(joints, times, deadline, kind)


def _inside(rng: np.random.Generator, arm: ArmModel, n: int) -> Array:
    result: Array = rng.uniform(arm.limits_rad[:, 0], arm.limits_rad[:, 1], (n, arm.n_joints))
    return result


def _pick(rng: np.random.Generator, arm: ArmModel, is_wanted: Any) -> Array:
    """Return random joints (1, k) whose points are as wanted, or any when such are rare."""
    joints = _inside(rng, arm, 64)
    wanted = np.flatnonzero(is_wanted(link_points(arm, joints)))
    result: Array = joints[wanted[:1]] if len(wanted) else joints[:1]
    return result


def _misshapen(rng: np.random.Generator, joints: Array, times: Array) -> Hostile:
    shapes: List[Tuple[Any, Any]] = [
        (joints[:, :-1], times),
        (joints, np.append(times, 1.0)),
        (joints[0], times),
        (joints[None], times),
        (joints[:0], times[:0]),
        (None, times),
        ("up", times),
        ([[1.0], [1.0, 2.0]], times),
        (joints.astype(str), times),
        (joints.astype(complex), times),
        (joints > 0.0, times),
        ([[10**400] * joints.shape[1]], times[:1]),
        (np.tile(joints, (1000, 1)), np.tile(times, 1000)),
        (np.zeros((0,)), 1.0),
        ({}, []),
        (joints, None),
    ]
    made = shapes[int(rng.integers(len(shapes)))]
    return Hostile(made[0], made[1], None, "wrong shape")


def link_points(arm: ArmModel, joints_rad: Array) -> Array:
    """Return shoulder, elbow, wrist and tip (n, 4, 3), by a product of transforms."""
    n, links = len(joints_rad), arm.links
    signed = joints_rad * arm.signs
    frame = _moved(_eye(n), (links.axis_m[0], links.axis_m[1], 0.0)) @ _turn_z(signed[:, 0])
    at = (links.shoulder_forward_m, links.shoulder_left_m, links.shoulder_height_m)
    frame = _moved(frame, at)
    points = [frame[:, :3, 3]]
    pitches = (links.upper_zero_rad, links.forearm_zero_rad, links.hand_zero_rad)
    before = 0.0
    for j, (pitch, length) in enumerate(zip(pitches, (links.upper_m, links.forearm_m))):
        frame = _moved(frame @ _turn_up(signed[:, 1 + j] + pitch - before), (length, 0.0, 0.0))
        points.append(frame[:, :3, 3])
        before = pitch
    frame = frame @ _turn_up(signed[:, 3] + pitches[2] - before)
    frame = _moved(frame, (0.0, links.hand_left_m, 0.0))
    if arm.n_joints > 4:
        frame = frame @ _turn_x(signed[:, 4])
    frame = _moved(frame, (links.hand_m, links.tip_left_m, links.tip_up_m))
    return np.stack([*points, frame[:, :3, 3]], axis=1)


def _eye(n: int) -> Array:
    return np.tile(np.eye(4), (n, 1, 1))


def _moved(frame: Array, by_m: Tuple[float, float, float]) -> Array:
    step = np.eye(4)
    step[:3, 3] = by_m
    result: Array = frame @ step
    return result


def _turn(angle: Array, first: int, second: int) -> Array:
    """Return turns (n, 4, 4) that carry axis ``first`` towards axis ``second``."""
    turn = _eye(len(angle))
    turn[:, first, first] = turn[:, second, second] = np.cos(angle)
    turn[:, second, first], turn[:, first, second] = np.sin(angle), -np.sin(angle)
    return turn


def _turn_z(angle: Array) -> Array:
    return _turn(angle, 0, 1)


def _turn_up(angle: Array) -> Array:
    return _turn(angle, 0, 2)


def _turn_x(angle: Array) -> Array:
    return _turn(angle, 1, 2)


def _off_itself(arm: ArmModel, points: Array) -> Array:
    """Return by how much (n,) parts that must not touch are apart, from points along each."""
    body, share = arm.body, np.linspace(0.0, 1.0, _N_POINTS)[:, None]

    def along(a: int, b: int) -> Array:
        result: Array = points[:, a, None] + (points[:, b, None] - points[:, a, None]) * share
        return result

    def off_column(part: Array) -> Array:
        flat = np.hypot(part[..., 0] - arm.links.axis_m[0], part[..., 1] - arm.links.axis_m[1])
        above = np.maximum(part[..., 2] - body.column_height_m, 0.0)
        below = np.maximum(-part[..., 2], 0.0)
        result: Array = np.hypot(flat, above + below).min(axis=1)
        return result

    upper, fore, hand = along(0, 1), along(1, 2), along(2, 3)
    gap = np.linalg.norm(upper[:, :, None] - hand[:, None], axis=3).min(axis=(1, 2))
    apart = np.stack(
        [
            off_column(fore) - body.column_radius_m - body.forearm_radius_m,
            off_column(hand) - body.column_radius_m - body.hand_radius_m,
            gap - body.upper_radius_m - body.hand_radius_m,
        ]
    )
    result: Array = apart.min(axis=0)
    return result


def pose_faults(arm: ArmModel, joints_rad: Array, room_m: float = -_SLACK_M) -> List[str]:
    """Return what is wrong with each pose (n, k): a reason, or "" when nothing is.

    ``room_m`` is how much room is asked for; by default a tenth of a millimetre is overlooked.
    """
    points, limits = link_points(arm, joints_rad), arm.workspace
    tip = points[:, 3]
    off_axis = np.hypot(tip[:, 0] - arm.links.axis_m[0], tip[:, 1] - arm.links.axis_m[1])
    is_in_base = off_axis < limits.base_radius_m + room_m
    is_in_base &= tip[:, 2] < limits.base_height_m + room_m
    outside = np.maximum(limits.box_low_m - points[:, 1:], points[:, 1:] - limits.box_high_m)
    low, high = arm.limits_rad[:, 0] - 1e-6, arm.limits_rad[:, 1] + 1e-6
    checks = (
        ("joint outside its limits", ~((joints_rad >= low) & (joints_rad <= high)).all(axis=1)),
        ("tip under the table", ~(tip[:, 2] >= limits.min_tip_z_m + room_m)),
        ("link under the table", ~(points[:, 1:3, 2].min(axis=1) >= limits.min_link_z_m + room_m)),
        ("outside the box", ~(outside.max(axis=(1, 2)) <= -room_m)),
        (
            "tip in the base",
            (off_axis < limits.base_radius_m + room_m)
            & (tip[:, 2] < limits.base_height_m + room_m),
        ),
        ("hits itself", ~(_off_itself(arm, points) >= room_m)),
    )
    reasons = [""] * len(joints_rad)
    for what, is_wrong in reversed(checks):
        for i in np.flatnonzero(is_wrong):
            reasons[i] = what
    return reasons


def violates(arm: ArmModel, path: CheckedPath, room_m: float = -_SLACK_M) -> str:
    """Return which limit an accepted path breaks, or "" when none.

    A start beyond a limit may be left within the first eighth of the first segment.
    """
    knots, times = np.asarray(path.knots_rad), np.asarray(path.knots_s)
    if not (np.isfinite(knots).all() and np.isfinite(times).all()):
        return "not finite"
    spans = np.diff(times)
    if times[0] != 0.0 or not (spans > 0.0).all():
        return "time does not go on"
    turn = np.abs(np.diff(knots, axis=0))
    if (turn > arm.rate_rad_s * spans[:, None] * (1.0 + 1e-9) + 1e-12).any():
        return "over speed"
    if turn.max() > arm.workspace.max_step_rad * (1.0 + 1e-9):
        return "step too large"
    share = np.arange(1, _N_LOOKS + 1)[:, None] / _N_LOOKS
    poses = np.concatenate([a + (b - a) * share for a, b in zip(knots[:-1], knots[1:])])
    reasons = pose_faults(arm, poses, room_m)
    is_bad_start = pose_faults(arm, knots[:1], room_m)[0] != ""
    return next((why for why in reasons[_N_LOOKS // 8 if is_bad_start else 0 :] if why), "")


def measure(scale: float, seed: int) -> List[Line]:
    """Put hostile targets to the guard and every path it accepts to the oracle."""
    n_each = max(10, int(N_TARGETS * scale) // len(ARMS))
    lines: List[Line] = []
    with Progress("targets", n_each * len(ARMS)) as progress:
        for index, name in enumerate(ARMS):
            lines += _one_arm(ArmModel.load(name), n_each, (seed, index), progress)
    return lines


def _one_arm(arm: ArmModel, n: int, seed: Tuple[int, int], progress: Progress) -> List[Line]:
    rng = np.random.default_rng(seed)
    broken: Counter = Counter()
    n_accepted = n_harmless = n_harmless_refused = n_late = 0
    spent_s = 0.0
    start = arm.home_rad
    for _ in range(n):
        target = hostile(rng, arm)
        deadline_s = None if target.deadline_s is None else 100.0 + target.deadline_s
        begun_s = time.perf_counter()
        path: Optional[CheckedPath] = None
        with contextlib.suppress(MotionRefused):
            path = check_path(
                arm, start, target.joints_rad, target.duration_s, None, 100.0, deadline_s
            )
        spent_s += time.perf_counter() - begun_s
        if path is not None:
            n_accepted += 1
            n_late += target.kind == "past deadline"
            broken[violates(arm, path)] += 1
            start = path.knots_rad[-1]
        elif target.kind == "harmless" and _is_harmless(arm, start, target):
            n_harmless_refused += 1
        n_harmless += target.kind == "harmless"
        progress.advance()
    n_broken = n_accepted - broken[""]
    return [
        at_most(SUITE, f"{arm.name}: broken limits in {n} hostile targets", n_broken, 0, "{:.0f}"),
        at_most(SUITE, f"{arm.name}: accepted past the deadline", n_late, 0, "{:.0f}"),
        at_most(SUITE, f"{arm.name}: harmless paths refused", n_harmless_refused, 0, "{:.0f}"),
        at_least(SUITE, f"{arm.name}: paths accepted", n_accepted, 1, "{:.0f}"),
        note(SUITE, f"{arm.name}: one check, us", 1e6 * spent_s / n, "{:.0f}"),
    ]


def _is_harmless(arm: ArmModel, start: Array, target: Hostile) -> bool:
    """Say whether the oracle finds a target fine with room to spare."""
    knots = np.vstack([start, target.joints_rad])
    spans = np.maximum(target.duration_s, 10.0)
    path = CheckedPath(knots, np.concatenate([[0.0], np.cumsum(spans)]), False)
    return not violates(arm, path, _ROOM_M)
