"""Inverse kinematics: time against a frame, and how exactly FK(IK(p)) returns to p.

Source: ours.
"""

import math
import time
from typing import Callable, List, Optional, Sequence, Tuple

import numpy as np

from apex_edge.simulate.candidates import candidate_grid
from apex_edge.types import Array
from apex_edge.verbs.progress import Progress
from firmware_bridge.arm_file import known_arms
from firmware_bridge.kinematics import ArmModel
from offline_train.benchmarks.lines import Line, at_least, at_most, note

SUITE = "kinematics"
FRAME_S = 1.0 / 30.0
N_POINTS = 1412
N_POSES = 50_000
_REPEATS = 7
_BLOCK = 2000


def measure(scale: float, seed: int) -> List[Line]:
    """Return time and round trip: every arm, points of random poses over the whole workspace."""
    lines = _times(scale)
    names = known_arms()
    n_poses = max(50, int(N_POSES * scale))
    with Progress("arms", len(names)) as progress:
        for index, name in enumerate(names):
            lines += _round_trip(ArmModel.load(name), n_poses, np.random.default_rng((seed, index)))
            progress.advance()
    return lines


def _times(scale: float) -> List[Line]:
    arm = ArmModel.load("armpi-mini")
    tips = candidate_grid(arm, N_POINTS).tip_m
    some = tips[:: max(1, int(0.2 / max(scale, 0.01)))]
    ours_s = _median_s(lambda: arm.inverse(tips))
    plain_s = _median_s(lambda: [plain_inverse(arm, tip) for tip in some.tolist()], 1)
    plain_s *= N_POINTS / len(some)
    found, is_reachable = arm.inverse(some)
    off = [
        float(np.abs(np.array(plain) - q).max())
        for plain, q in zip((plain_inverse(arm, tip) for tip in some.tolist()), found)
        if plain is not None
    ]
    is_same = len(off) == int(is_reachable.sum()) and max(off) < 1e-9
    share = ours_s / FRAME_S
    return [
        at_most(SUITE, f"IK of {N_POINTS} points, frame periods of 30 Hz", share, 0.75),
        note(SUITE, f"IK of {N_POINTS} points, ms", 1e3 * ours_s),
        note(SUITE, "point by point in plain Python, frame periods", plain_s / FRAME_S),
        at_least(SUITE, "plain Python takes this many times as long", plain_s / ours_s, 2.0),
        at_least(SUITE, "both find the same joints", float(is_same), 1.0),
    ]


def _median_s(what: Callable[[], object], n: int = _REPEATS) -> float:
    spent = []
    for _ in range(n):
        begun_s = time.perf_counter()
        what()
        spent.append(time.perf_counter() - begun_s)
    return float(np.median(spent))


def plain_inverse(arm: ArmModel, tip_m: Sequence[float]) -> Optional[Tuple[float, ...]]:
    """Return the first feasible joints of a four-joint arm without offsets, one pitch at a time."""
    links, pitch = arm.links, arm.pitch
    n = round((pitch.high_deg - pitch.low_deg) / pitch.step_deg)
    grid = [pitch.low_deg + i * (pitch.high_deg - pitch.low_deg) / n for i in range(n + 1)]
    reach = math.hypot(tip_m[0], tip_m[1])
    for degrees in sorted(grid, key=lambda each: abs(each + 90.0)):
        angle = math.radians(degrees)
        ahead = reach - links.hand_m * math.cos(angle)
        up = tip_m[2] - links.shoulder_height_m - links.hand_m * math.sin(angle)
        if up + links.shoulder_height_m < pitch.min_link_z_m:
            continue
        cosine = (ahead**2 + up**2 - links.upper_m**2 - links.forearm_m**2) / (
            2.0 * links.upper_m * links.forearm_m
        )
        if abs(cosine) > 1.0:
            continue
        for bend in (math.acos(cosine), -math.acos(cosine)):
            inward = math.atan2(
                links.forearm_m * math.sin(bend), links.upper_m + links.forearm_m * math.cos(bend)
            )
            shoulder = math.atan2(up, ahead) + inward
            q = (math.atan2(tip_m[1], tip_m[0]), shoulder, bend, angle - shoulder + bend)
            if _is_feasible(arm, q):
                return q
    return None


def _is_feasible(arm: ArmModel, q: Tuple[float, ...]) -> bool:
    elbow_z = arm.links.shoulder_height_m + arm.links.upper_m * math.sin(q[1])
    inside = all(low - 1e-9 <= a <= high + 1e-9 for a, (low, high) in zip(q, arm.limits_rad))
    return inside and elbow_z >= arm.pitch.min_link_z_m


def _round_trip(arm: ArmModel, n: int, rng: np.random.Generator) -> List[Line]:
    q = rng.uniform(arm.limits_rad[:, 0], arm.limits_rad[:, 1], (n, arm.n_joints))
    points = arm.forward(q)
    is_up = points[:, 1:3, 2].min(axis=1) >= arm.pitch.min_link_z_m
    q, tips = q[is_up & (points[:, 3, 2] >= 0.0)], points[is_up & (points[:, 3, 2] >= 0.0), 3]
    found, is_reachable = arm.inverse(tips)
    worst_m = float(np.abs(arm.tip(found[is_reachable]) - tips[is_reachable]).max())
    n_back, worst_all_m, n_ways = 0, 0.0, 0
    for at in range(0, len(q), _BLOCK):
        part, tip = q[at : at + _BLOCK], tips[at : at + _BLOCK]
        roll = part[:, 4] if arm.n_joints > 4 else None
        ways = arm.inverse_all(tip, arm.pitches(part)[:, 2:], roll)[:, 0]
        n_back += int((_off(ways, part) < 1e-5).sum())
        is_way = np.isfinite(ways).all(axis=2)
        gap = arm.tip(ways[is_way]) - np.repeat(tip, is_way.sum(axis=1), axis=0)
        worst_all_m = max(worst_all_m, float(np.abs(gap).max()))
        n_ways += int(is_way.sum())
    name = arm.name
    return [
        at_most(SUITE, f"{name}: |FK(IK(p)) - p|, mm", 1e3 * worst_m, 0.1),
        at_most(SUITE, f"{name}: the same over all {n_ways} branches, mm", 1e3 * worst_all_m, 0.1),
        at_least(SUITE, f"{name}: share of poses that come back among them", n_back / len(q), 1.0),
        note(SUITE, f"{name}: share of tips reached with the file's pitches", is_reachable.mean()),
    ]


def _off(ways: Array, q: Array) -> Array:
    """Return how far (n,) the nearest of the ways (n, b, k) is from joints (n, k), in rad."""
    off = np.abs(ways - q[:, None]).max(axis=2)
    result: Array = np.where(np.isfinite(off), off, np.inf).min(axis=1)
    return result
