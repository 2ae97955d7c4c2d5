"""What is simulated: one mover, one target, the arm's tip as a disc; and how to get it from tracks.

Everything moves on the table plane: heights are below the object height and play no part. A free
path is forward Euler as the paper writes it, ``pos += v dt`` then ``v += a dt``; an object that
brakes stops for good at the first step at which its velocity no longer points forward.
"""

import math
from dataclasses import dataclass, replace
from typing import List, Tuple

import numpy as np

from apex_edge.config import setting
from apex_edge.errors import InputError
from apex_edge.types import Array, Candidates, Tracks, TrackStatus

# Step number of an event that does not happen.
NEVER = 2**31 - 1
# Contact is tested against radius + CONTACT_EPS_M, so that round numbers never sit on the edge
# where two back ends may round differently.
CONTACT_EPS_M = 1e-9
# A braking object stands when its forward speed is below this part of its first speed.
STOP_RATIO = 1e-9
# Below this speed a direction of motion is noise of rounding.
TINY_M_S = 1e-12
_MAX_STEPS = 100000
# Taken when a track has no covariance yet: 5 mm and 5 cm/s.
_UNKNOWN_SD = (0.005, 0.005, 0.005, 0.05, 0.05, 0.05)


@dataclass(frozen=True)
class CandidatesConfig:
    """How the grid of intercept points is laid."""

    # A small ball's centre is this high: there it is met squarely, and far out, where the hand
    # hangs over what is nearer to the base, it hangs higher than with the tip on the table.
    tip_height_m: float = setting(0.015, "height of the tip when it stands guard, m", 0.0, 0.2)
    hover_height_m: float = setting(0.06, "height from which the tip descends, m", 0.0, 0.4)
    min_spacing_m: float = setting(0.002, "finest grid tried before the arm is refused, m", 1e-4, 1)


@dataclass(frozen=True)
class SimulateConfig:
    """How interventions are simulated and which of them count as safe."""

    type: str = setting("kernel", "back end: kernel (no time loop) or euler (the paper's stepping)")
    horizon_s: float = setting(5.0, "how far ahead is simulated, s", 0.1, 60.0)
    dt_s: float = setting(0.01, "Euler step, s", 0.0005, 0.5)
    n_candidates: int = setting(1412, "intercept points", 1, 100000)
    # a block's corners stick out by 0.4 of its half side (8 mm of 20), its place is off by 3 mm
    clearance_m: float = setting(0.010, "least gap between arm and what it must not touch", 0, 0.1)
    min_slack_s: float = setting(0.1, "least time the tip must stand before the mover comes", 0, 5)
    glance_ratio: float = setting(
        0.6, "greatest offset of a hit from the middle that still stops, of both radii", 0.05, 1.0
    )
    acceleration: str = setting(
        "along",
        "part of the measured acceleration believed: none, along (the motion), full",
        choices=("none", "along", "full"),
    )
    rest_speed_m_s: float = setting(0.02, "a target slower than this is taken as at rest", 0, 1)
    n_sigma: float = setting(2.0, "spread of the pessimistic paths, standard deviations", 0, 6)
    candidates: CandidatesConfig = setting(CandidatesConfig(), "grid of intercept points")


@dataclass(frozen=True)
class RolloutProblem:
    """One state to roll out from, taken at capture time ``t_s``; metres, table frame.

    ``mover_pos_m``, ``mover_vel_m_s``, ``mover_acc_m_s2 (3,)``, ``mover_cov (6, 6)`` of position
    and velocity; the target moves at constant velocity; ``obstacle_pos_m (m, 3)`` and
    ``obstacle_radius_m (m,)`` are all other objects, which must not be touched.

    Raises
    ------
    InputError : wrong shape, a value that is not finite, or a size or step that is not positive.
    """

    seq: int
    t_s: float
    mover_id: int
    target_id: int
    mover_pos_m: Array
    mover_vel_m_s: Array
    mover_acc_m_s2: Array
    mover_cov: Array
    mover_radius_m: float
    target_pos_m: Array
    target_vel_m_s: Array
    target_radius_m: float
    obstacle_pos_m: Array
    obstacle_radius_m: Array
    tip_radius_m: float
    horizon_s: float = 5.0
    dt_s: float = 0.01
    clearance_m: float = 0.010
    min_slack_s: float = 0.1
    glance_ratio: float = 0.6
    n_sigma: float = 2.0

    def __post_init__(self) -> None:
        n_obstacles = len(self.obstacle_radius_m)
        shapes = {
            "mover_pos_m": (3,),
            "mover_vel_m_s": (3,),
            "mover_acc_m_s2": (3,),
            "mover_cov": (6, 6),
            "target_pos_m": (3,),
            "target_vel_m_s": (3,),
            "obstacle_pos_m": (n_obstacles, 3),
            "obstacle_radius_m": (n_obstacles,),
        }
        arrays = [np.asarray(getattr(self, name)) for name in shapes]
        is_right = all(a.shape == shape for a, shape in zip(arrays, shapes.values()))
        # one test for all: this runs for every frame and every pessimistic path
        if not is_right or not np.isfinite(np.concatenate([a.ravel() for a in arrays])).all():
            for name, shape in shapes.items():
                check_array(name, getattr(self, name), shape)
        for name in ("mover_radius_m", "target_radius_m", "tip_radius_m", "horizon_s", "dt_s"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"roll-out: {name} = {getattr(self, name)!r}, expected > 0")
        if not 1 <= self.n_steps <= _MAX_STEPS:
            raise InputError(
                f"roll-out: {self.horizon_s} s in steps of {self.dt_s} s are {self.n_steps} steps, "
                f"expected 1 .. {_MAX_STEPS}"
            )

    @property
    def n_steps(self) -> int:
        """Number of Euler steps to the horizon."""
        return int(round(self.horizon_s / self.dt_s))

    @property
    def contact_m(self) -> float:
        """Distance between centres at which mover and target touch."""
        return self.mover_radius_m + self.target_radius_m

    @property
    def block_m(self) -> float:
        """Distance between centres at which the mover meets the arm's tip."""
        return self.mover_radius_m + self.tip_radius_m


@dataclass(frozen=True)
class ArmCandidates(Candidates):
    """Candidates that know where the arm's hand is: ``wrist_m (n, 3)`` with the tip on guard.

    Far out the hand leans over what is nearer to the base and would knock it over.
    """

    wrist_m: Array


@dataclass(frozen=True)
class Outcomes:
    """What one back end found for n blockers; step numbers are NEVER when it does not happen.

    ``collision_step``, ``blocked_step (n,)`` int64; ``enter_step (n,)`` when the mover first comes
    within reach of the blocker's place, whether the arm is there by then or not (and before any
    collision); ``min_distance_m``, ``final_distance_m (n,)`` mover to target, ``min_step (n,)``;
    ``landing_gap_m (n,)`` between tip and mover, edge to edge, when the arm arrives (inf when it
    does not arrive); ``offset_ratio (n,)`` sideways offset of the hit over tip + mover radius, 0
    for a central hit (inf when not blocked); ``deflected_gap_m (n,)`` how near, edge to edge, the
    mover would come to the target if it glided off the tip sideways instead of stopping (inf when
    not blocked); ``free_collision_step`` without any arm.
    """

    collision_step: Array
    blocked_step: Array
    enter_step: Array
    min_distance_m: Array
    min_step: Array
    final_distance_m: Array
    landing_gap_m: Array
    offset_ratio: Array
    deflected_gap_m: Array
    free_collision_step: int


def check_array(name: str, value: Array, shape: Tuple[int, ...]) -> None:
    """Refuse an array of the wrong shape or with a value that is not finite.

    Raises
    ------
    InputError : names the array, what was found and what was expected.
    """
    found = np.shape(value)
    if found != shape:
        raise InputError(f"roll-out: {name} has shape {found}, expected {shape}")
    if not np.isfinite(value).all():
        raise InputError(f"roll-out: {name} holds a value that is not finite: {value}")


def arrival_steps(arrival_s: Array, problem: RolloutProblem) -> Array:
    """Return the first step (n,) int64 at which each blocker stands; NEVER past the horizon."""
    step = np.ceil(np.asarray(arrival_s, dtype=np.float64) / problem.dt_s - 1e-9)
    late = step > problem.n_steps
    result: Array = np.where(late, NEVER, np.where(late, 0.0, step).astype(np.int64))
    return result


def describe_hits(
    gap_m: Array, came_m_s: Array, away_m: Array, problem: RolloutProblem
) -> Tuple[Array, Array]:
    """Return offset ratio (n,) and deflected gap (n,) of n hits; see ``Outcomes``.

    ``gap_m (2, n)`` from mover to blocker, ``came_m_s (2, n)`` the velocity that led there (a
    mover that did not move is hit centrally), ``away_m (2, n)`` from mover to target. A deflected
    mover keeps the part of its velocity that is square to the line of centres.
    """
    speed = np.hypot(came_m_s[0], came_m_s[1])
    is_moving = speed > TINY_M_S
    unit = came_m_s / np.where(is_moving, speed, 1.0)
    across = gap_m[0] * unit[1] - gap_m[1] * unit[0]
    offset = np.where(is_moving, np.abs(across), 0.0) / problem.block_m
    apart = np.maximum(np.hypot(gap_m[0], gap_m[1]), TINY_M_S)
    side = np.where(across < 0.0, 1.0, -1.0) / apart
    glide_x, glide_y = gap_m[1] * side, -gap_m[0] * side
    way = np.maximum(away_m[0] * glide_x + away_m[1] * glide_y, 0.0)
    way = np.where(offset > CONTACT_EPS_M, way, 0.0)
    miss = np.hypot(away_m[0] - way * glide_x, away_m[1] - way * glide_y)
    return offset, miss - problem.contact_m


def problem_from(
    tracks: Tracks,
    mover_id: int,
    target_id: int,
    config: SimulateConfig,
    tip_radius_m: float,
) -> RolloutProblem:
    """Take one mover and one target out of the tracks; every other track seen is an obstacle.

    A velocity of the target below ``rest_speed_m_s`` is noise and becomes 0; a covariance that is
    not finite is replaced by one of a barely seen object.

    Raises
    ------
    InputError : no such track, a lost one, or one without metric position, motion or radius.
    """
    mover, target = _row(tracks, mover_id, "mover"), _row(tracks, target_id, "target")
    if mover == target:
        raise InputError(f"roll-out: track {mover_id} cannot be both mover and target")
    target_vel = _flat(tracks.vel_m_s[target])
    if np.hypot(target_vel[0], target_vel[1]) < config.rest_speed_m_s:
        target_vel = np.zeros(3)
    velocity = _flat(tracks.vel_m_s[mover])
    cov = tracks.cov[mover]
    others = (tracks.status != TrackStatus.LOST) & np.isfinite(tracks.pos_m[:, :2]).all(axis=1)
    others &= np.isfinite(tracks.radius_m)
    others[[mover, target]] = False
    return RolloutProblem(
        seq=tracks.seq,
        t_s=tracks.t_s,
        mover_id=mover_id,
        target_id=target_id,
        mover_pos_m=_flat(tracks.pos_m[mover]),
        mover_vel_m_s=velocity,
        mover_acc_m_s2=_believed(_flat(tracks.acc_m_s2[mover]), velocity, config.acceleration),
        mover_cov=cov if np.isfinite(cov).all() else np.diag(np.square(_UNKNOWN_SD)),
        mover_radius_m=float(tracks.radius_m[mover]),
        target_pos_m=_flat(tracks.pos_m[target]),
        target_vel_m_s=target_vel,
        target_radius_m=float(tracks.radius_m[target]),
        obstacle_pos_m=np.nan_to_num(tracks.pos_m[others]),
        obstacle_radius_m=tracks.radius_m[others],
        tip_radius_m=tip_radius_m,
        horizon_s=config.horizon_s,
        dt_s=config.dt_s,
        clearance_m=config.clearance_m,
        min_slack_s=config.min_slack_s,
        glance_ratio=config.glance_ratio,
        n_sigma=config.n_sigma,
    )


def hypotheses(problem: RolloutProblem) -> List[RolloutProblem]:
    """Return pessimistic variants of a problem: left, right and faster by ``n_sigma``.

    Left and right shift the path sideways so that it lies ``n_sigma`` standard deviations off now
    and at the time of closest approach, as the covariance carries it forward. The same braking
    acts along each path. Empty when the mover does not move or nothing is uncertain. Source: ours.
    """
    vx, vy = (float(v) for v in problem.mover_vel_m_s[:2])
    speed = math.hypot(vx, vy)
    if speed < 1e-3 or problem.n_sigma == 0.0:
        return []
    ux, uy = vx / speed, vy / speed
    look_s = _closest_approach_s(problem)
    now = problem.n_sigma * _sd(problem, -uy, ux, (1.0, 0.0))
    then = problem.n_sigma * _sd(problem, -uy, ux, (1.0, look_s))
    fast = problem.n_sigma * _sd(problem, ux, uy, (0.0, 1.0))
    turn = (then - now) / look_s
    return [
        _moved(problem, (now * uy, -now * ux), (vx + turn * uy, vy - turn * ux)),
        _moved(problem, (-now * uy, now * ux), (vx - turn * uy, vy + turn * ux)),
        _moved(problem, (0.0, 0.0), (vx + fast * ux, vy + fast * uy)),
    ]


def _row(tracks: Tracks, track_id: int, role: str) -> int:
    rows = np.flatnonzero(tracks.track_id == track_id)
    if len(rows) != 1:
        raise InputError(
            f"roll-out: no single {role} track {track_id}; there are {list(tracks.track_id)}"
        )
    row = int(rows[0])
    if tracks.status[row] == TrackStatus.LOST:
        raise InputError(f"roll-out: the {role} track {track_id} is lost")
    return row


def _flat(vector: Array) -> Array:
    """Copy a vector (3,); a height or climb that is not known does not matter and becomes 0."""
    flat: Array = np.array(vector, dtype=np.float64)
    if not np.isfinite(flat[2]):
        flat[2] = 0.0
    return flat


def _believed(acceleration: Array, velocity: Array, how_much: str) -> Array:
    """Return the part of a measured acceleration that is used; an unknown one counts as none."""
    speed2 = float(velocity[:2] @ velocity[:2])
    if how_much == "none" or not np.isfinite(acceleration).all() or speed2 == 0.0:
        return np.zeros(3)
    if how_much == "full":
        return acceleration
    along: Array = velocity * (float(acceleration[:2] @ velocity[:2]) / speed2)
    return along


def _closest_approach_s(problem: RolloutProblem) -> float:
    x, y, _ = (float(v) for v in problem.target_pos_m - problem.mover_pos_m)
    vx, vy, _ = (float(v) for v in problem.mover_vel_m_s - problem.target_vel_m_s)
    nearest_s = (x * vx + y * vy) / max(vx * vx + vy * vy, 1e-12)
    return min(max(nearest_s, min(0.2, problem.horizon_s)), problem.horizon_s)


def _sd(problem: RolloutProblem, x: float, y: float, weight: Tuple[float, float]) -> float:
    """Return the sd, along the unit vector (x, y), of weight[0] position + weight[1] velocity."""
    p, v = weight
    row = np.array([p * x, p * y, 0.0, v * x, v * y, 0.0])
    return math.sqrt(max(float(row @ problem.mover_cov @ row), 0.0))


def _moved(
    problem: RolloutProblem, shift_m: Tuple[float, float], velocity_m_s: Tuple[float, float]
) -> RolloutProblem:
    """Return the problem on another path, with the same braking along it."""
    old_x, old_y, _ = (float(v) for v in problem.mover_vel_m_s)
    ax, ay, _ = (float(v) for v in problem.mover_acc_m_s2)
    vx, vy = velocity_m_s
    rate = (ax * old_x + ay * old_y) / math.hypot(old_x, old_y)
    share = rate / max(math.hypot(vx, vy), TINY_M_S)
    return replace(
        problem,
        mover_pos_m=problem.mover_pos_m + np.array([shift_m[0], shift_m[1], 0.0]),
        mover_vel_m_s=np.array([vx, vy, 0.0]),
        mover_acc_m_s2=np.array([share * vx, share * vy, 0.0]),
    )
