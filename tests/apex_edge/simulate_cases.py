"""Scenes for the tests of simulate, and the same physics written as slowly as possible."""

import math

import numpy as np

from apex_edge.simulate.base import RolloutProblem
from apex_edge.simulate.problem import NEVER
from apex_edge.types import Candidates, Tracks, TrackStatus

EPS = 1e-9


def problem(**changes):
    """A green ball 0.2 m out rolls at 0.1 m/s straight at a red ball that rests at x = 0."""
    values = {
        "seq": 7,
        "t_s": 1.5,
        "mover_id": 1,
        "target_id": 2,
        "mover_pos_m": (0.2, 0.0, 0.0),
        "mover_vel_m_s": (-0.1, 0.0, 0.0),
        "mover_acc_m_s2": (0.0, 0.0, 0.0),
        "mover_cov": np.zeros((6, 6)),
        "mover_radius_m": 0.015,
        "target_pos_m": (0.0, 0.0, 0.0),
        "target_vel_m_s": (0.0, 0.0, 0.0),
        "target_radius_m": 0.015,
        "obstacle_pos_m": np.zeros((0, 3)),
        "obstacle_radius_m": np.zeros(0),
        "tip_radius_m": 0.012,
    }
    values.update(changes)
    for name, value in values.items():
        if isinstance(value, tuple):
            values[name] = np.array(value, dtype=np.float64)
    return RolloutProblem(**values)


def candidates(*xy):
    """Candidates that stand at the given points; joints play no part here."""
    tip = np.array([[x, y, 0.005] for x, y in xy], dtype=np.float64).reshape(-1, 3)
    return Candidates(1, tip, np.zeros((len(tip), 4)), np.zeros((len(tip), 4)))


def tracks(**changes):
    """Three tracks: green (id 4) rolls at red (id 5), blue (id 9) rests aside."""
    n = 3
    values = {
        "seq": 3,
        "t_s": 2.0,
        "name": ("green", "red", "blue"),
        "track_id": np.array([4, 5, 9]),
        "pos_m": np.array([[0.3, 0.0, 0.015], [0.12, 0.0, 0.015], [0.2, 0.2, 0.015]]),
        "vel_m_s": np.array([[-0.1, 0.0, 0.0], [0.004, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        "acc_m_s2": np.array([[0.02, 0.05, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        "cov": np.broadcast_to(np.eye(6) * 1e-6, (n, 6, 6)).copy(),
        "radius_m": np.array([0.015, 0.02, 0.015]),
        "n_samples": np.full(n, 5),
        "status": np.full(n, int(TrackStatus.SEEN)),
        "age_s": np.zeros(n),
        "centre_px": np.zeros((n, 2)),
        "area_px2": np.full(n, 400.0),
        "is_manoeuvre": np.zeros(n, dtype=bool),
        "is_blurred": np.zeros(n, dtype=bool),
        "smooth_m": np.zeros((n, 3)),
        "seen_m": np.zeros((n, 3)),
        "seen_sd_m": np.full(n, 0.001),
    }
    values.update(changes)
    return Tracks(**values)


def random_problem(rng, kind):
    """Draw a scene: 0 straight, 1 curved, 2 braking to a stop, 3 anything; some targets move."""
    position = np.append(rng.uniform(-0.3, 0.4, 2), 0.0)
    velocity = np.append(rng.normal(0.0, 0.1, 2), 0.0) * rng.choice([0.0, 0.1, 1.0, 1.0, 3.0])
    acceleration = np.zeros(3)
    if kind in (1, 3):
        acceleration[:2] = rng.normal(0.0, 0.05, 2)
    if kind == 2:
        acceleration = -velocity * rng.uniform(0.0, 1.0)
    is_target_moving = rng.random() < 0.4
    target_velocity = np.append(rng.normal(0.0, 0.05, 2), 0.0) * is_target_moving
    ahead = position + velocity * rng.uniform(0.0, 3.0)
    return problem(
        mover_pos_m=position,
        mover_vel_m_s=velocity,
        mover_acc_m_s2=acceleration,
        mover_cov=np.diag([1e-6] * 3 + [1e-4] * 3),
        mover_radius_m=float(rng.uniform(0.005, 0.03)),
        target_pos_m=ahead + np.append(rng.normal(0.0, 0.03, 2), 0.0),
        target_vel_m_s=target_velocity,
        target_radius_m=float(rng.uniform(0.005, 0.03)),
        obstacle_pos_m=np.append(rng.uniform(-0.3, 0.4, 2), 0.0).reshape(1, 3),
        obstacle_radius_m=np.array([0.02]),
        dt_s=float(rng.choice([0.01, 0.02, 0.1])),
    )


def random_blockers(rng, scene, n):
    """Draw n blockers about the path, some there at once and some never."""
    along = rng.uniform(0.0, 3.0, (n, 1))
    xy = scene.mover_pos_m[:2] + scene.mover_vel_m_s[:2] * along + rng.normal(0.0, 0.04, (n, 2))
    arrival_s = rng.uniform(0.0, 3.0, n)
    arrival_s[::5] = 0.0
    arrival_s[::17] = np.inf
    return xy, arrival_s


def by_hand(scene, tip, arrival_s):
    """Step one candidate with plain numbers; the meaning of every field of Outcomes, spelt out."""
    x, y = scene.mover_pos_m[:2]
    vx, vy = scene.mover_vel_m_s[:2]
    ax, ay = scene.mover_acc_m_s2[:2]
    brakes = ax * vx + ay * vy < 0.0
    first = (vx, vy)
    tx, ty = scene.target_pos_m[:2]
    came = (vx, vy)
    result = {
        "collision_step": NEVER,
        "blocked_step": NEVER,
        "enter_step": NEVER,
        "min_distance_m": math.inf,
        "landing_gap_m": math.inf,
        "offset_ratio": math.inf,
    }
    stands = blocked = False
    has_landed = False
    for k in range(scene.n_steps + 1):
        gap = math.hypot(x - tip[0], y - tip[1])
        far = math.hypot(x - tx, y - ty)
        has_arrived = k * scene.dt_s >= arrival_s - 1e-9
        result["min_distance_m"] = min(result["min_distance_m"], far)
        result["final_distance_m"] = far
        if has_arrived and not has_landed:
            has_landed = True
            result["landing_gap_m"] = gap - scene.block_m
        if far <= scene.contact_m + EPS:
            result["collision_step"] = k
            has_time = arrival_s <= scene.n_steps * scene.dt_s + 1e-9
            if not has_landed and has_time:
                result["landing_gap_m"] = gap - scene.block_m
            break
        if gap <= scene.block_m + EPS and not blocked:
            result["enter_step"] = min(result["enter_step"], k)
            if has_arrived:
                blocked = True
                result["blocked_step"] = k
                speed = math.hypot(*came)
                across = abs((tip[0] - x) * came[1] - (tip[1] - y) * came[0])
                result["offset_ratio"] = across / speed / scene.block_m if speed > 1e-12 else 0.0
        if not blocked and not stands:
            came = (vx, vy)
            x, y = x + vx * scene.dt_s, y + vy * scene.dt_s
            vx, vy = vx + ax * scene.dt_s, vy + ay * scene.dt_s
            ahead = vx * first[0] + vy * first[1]
            stands = brakes and ahead <= 1e-9 * (first[0] ** 2 + first[1] ** 2)
        tx += scene.target_vel_m_s[0] * scene.dt_s
        ty += scene.target_vel_m_s[1] * scene.dt_s
    return result
