"""``apex bench rollout``: what 1412 simulated interventions cost, and whether all forms agree.

Side by side in one run, in CPU time: a loop in plain Python over points and steps, as the paper
describes its own (dt 0.1 and 0.01 s), the stepped Euler on arrays, and the kernel. Then both
back ends on random scenes: every flag must be equal. CPU time is the clock because it holds on a
busy machine; the ratios are what to compare between machines.
Source: APEX section "Limitations" (1412 points, 5 s, dt = 0.01 s: 0.2 s on a Raspberry Pi 4B).
"""

import argparse
import json
import math
import os
import platform
import statistics
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, List, Tuple

import numpy as np

from apex_edge.errors import InputError
from apex_edge.record.whole import write_whole_text
from apex_edge.simulate.base import PhysicsSim, RolloutProblem, SimulateConfig
from apex_edge.simulate.candidates import candidate_grid
from apex_edge.simulate.euler import EulerSim
from apex_edge.simulate.kernel import KernelSim
from apex_edge.simulate.problem import CONTACT_EPS_M, NEVER, Outcomes
from apex_edge.simulate.score import clearance_m, safe, slack_s
from apex_edge.types import Array, Candidates
from firmware_bridge.kinematics import ArmModel

HELP = "cost of 1412 roll-outs: plain loop, stepped Euler, kernel; and do they agree"
EXAMPLE = "apex bench rollout --json rollout.json"

_FLAGS = ("collision_step", "blocked_step", "enter_step")
_METRES = (
    "min_distance_m",
    "final_distance_m",
    "landing_gap_m",
    "offset_ratio",
    "deflected_gap_m",
)
_SAME_M = 1e-9
_STEPS_S = (0.01, 0.01, 0.02, 0.05, 0.1)
_LEAST_CPU_S = 0.02


@dataclass
class Agreement:
    """How two back ends compared; ``n_collided`` and so on show that every case occurred."""

    n_scenes: int = 0
    n_rollouts: int = 0
    n_collided: int = 0
    n_blocked: int = 0
    n_safe: int = 0
    n_different_flags: int = 0
    n_different_distances: int = 0
    max_difference_m: float = 0.0

    @property
    def is_full(self) -> bool:
        """Say whether nothing differed."""
        return self.n_different_flags == 0 and self.n_different_distances == 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures here")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random scenes")
    parser.add_argument("--scenes", type=int, default=2000, help="random scenes to compare on")


def run(args: argparse.Namespace) -> int:
    """Measure, compare, print and write; return 1 when the back ends differ.

    Raises
    ------
    InputError : a number of scenes below 1, or a folder for the JSON file that is not there.
    """
    if args.scenes < 1:
        raise InputError(f"--scenes {args.scenes}: expected at least 1")
    if args.json is not None and not args.json.parent.is_dir():
        raise InputError(f"--json {args.json}: the folder {args.json.parent} does not exist")
    arm = ArmModel.load()
    grid = candidate_grid(arm, SimulateConfig().n_candidates)
    cpu_ms, is_loop_same = measure(arm, grid)
    print(_table(cpu_ms, len(grid.tip_m)), flush=True)
    agreement = compare(grid, args.seed, args.scenes)
    _finish_progress()
    print(_verdict(agreement, is_loop_same))
    if args.json is not None:
        report = _report(args, len(grid.tip_m), cpu_ms, agreement, is_loop_same)
        write_whole_text(args.json, json.dumps(report, indent=2) + "\n")
    return 0 if agreement.is_full and is_loop_same else 1


def measure(arm: ArmModel, grid: Candidates) -> Tuple[Dict[str, float], bool]:
    """Return CPU milliseconds per form, and whether the plain loop found the same flags."""
    problem = head_on(arm)
    coarse = replace(problem, dt_s=0.1)
    arrival_s = from_home_s(arm, grid)
    tips = np.ascontiguousarray(grid.tip_m[:, :2])
    kernel, euler = KernelSim(), EulerSim()
    forms: Dict[str, Callable[[], object]] = {
        "plain loop, dt 0.1": lambda: plain_loop(coarse, tips, arrival_s),
        "plain loop, dt 0.01": lambda: plain_loop(problem, tips, arrival_s),
        "stepped Euler, dt 0.1": lambda: euler.outcomes(coarse, tips, arrival_s),
        "stepped Euler, dt 0.01": lambda: euler.outcomes(problem, tips, arrival_s),
        "kernel, dt 0.01": lambda: kernel.outcomes(problem, tips, arrival_s),
        "kernel, dt 0.01, scored on all paths": lambda: kernel.rollout(problem, grid, arrival_s),
    }
    cpu_ms = {name: cpu_time_ms(form) for name, form in forms.items()}
    found = kernel.outcomes(problem, tips, arrival_s)
    by_loop = plain_loop(problem, tips, arrival_s)
    is_same = all(
        (collided, blocked) == (found.collision_step[i] != NEVER, found.blocked_step[i] != NEVER)
        for i, (collided, blocked, _) in enumerate(by_loop)
    )
    return cpu_ms, is_same


def cpu_time_ms(call: Callable[[], object], n_repeats: int = 7) -> float:
    """Return the median CPU time of a call in milliseconds, short calls taken many at a time."""
    started = time.process_time()
    call()
    n_calls = max(1, int(_LEAST_CPU_S / max(time.process_time() - started, 1e-6)))
    taken = []
    for _ in range(n_repeats):
        started = time.process_time()
        for _ in range(n_calls):
            call()
        taken.append((time.process_time() - started) / n_calls)
    return statistics.median(taken) * 1e3


def plain_loop(
    problem: RolloutProblem, tips: Array, arrival_s: Array
) -> List[Tuple[bool, bool, float]]:
    """Roll out each point on its own, step by step, in plain Python.

    Returns (collided, blocked, final distance) per point. Written in the manner the paper
    describes; contacts are discs, and a point counts from the arm's arrival on, as in ours. The
    target rests and nothing brakes, as in the paper's own scene.
    """
    target_x, target_y, _ = problem.target_pos_m.tolist()
    reach, touch = problem.block_m + CONTACT_EPS_M, problem.contact_m + CONTACT_EPS_M
    dt = problem.dt_s
    results = []
    for (tip_x, tip_y), ready_s in zip(tips.tolist(), arrival_s.tolist()):
        x, y, _ = problem.mover_pos_m.tolist()
        vx, vy, _ = problem.mover_vel_m_s.tolist()
        collided = blocked = False
        distance = math.inf
        for step in range(problem.n_steps + 1):
            distance = math.hypot(x - target_x, y - target_y)
            if distance <= touch:
                collided = True
                break
            if step * dt >= ready_s - 1e-9 and math.hypot(x - tip_x, y - tip_y) <= reach:
                blocked = True
                break
            x += vx * dt
            y += vy * dt
        results.append((collided, blocked, distance))
    return results


def head_on(arm: ArmModel) -> RolloutProblem:
    """Return the scene that is timed: a ball 0.4 m out rolls at a resting one, 2.2 s to contact."""
    start, target = np.array([0.40, 0.06, 0.0]), np.array([0.14, 0.0, 0.0])
    away = target - start
    return RolloutProblem(
        seq=0,
        t_s=0.0,
        mover_id=1,
        target_id=2,
        mover_pos_m=start,
        mover_vel_m_s=0.1 * away / np.linalg.norm(away),
        mover_acc_m_s2=np.zeros(3),
        mover_cov=np.diag([1e-6] * 3 + [1e-5] * 3),
        mover_radius_m=0.015,
        target_pos_m=target,
        target_vel_m_s=np.zeros(3),
        target_radius_m=0.015,
        obstacle_pos_m=np.zeros((0, 3)),
        obstacle_radius_m=np.zeros(0),
        tip_radius_m=arm.tip_radius_m,
    )


def from_home_s(arm: ArmModel, grid: Candidates) -> Array:
    """Return the arm's travel time (n,) from rest to above each point and down."""
    above_s = arm.travel_time_s(arm.home_rad, grid.hover_rad)
    arrival_s: Array = above_s + arm.travel_time_s(grid.hover_rad, grid.joints_rad) + arm.lag_s
    return arrival_s


def compare(grid: Candidates, seed: int, n_scenes: int) -> Agreement:
    """Run both back ends on random scenes over the whole grid and count what differs."""
    rng = np.random.default_rng(seed)
    kernel, euler = KernelSim(), EulerSim()
    total = Agreement()
    for number in range(n_scenes):
        problem = random_scene(rng, number)
        arrival_s = rng.uniform(0.0, 3.0, len(grid.tip_m))
        arrival_s[rng.random(len(arrival_s)) < 0.05] = np.inf
        _add(total, problem, grid, arrival_s, (kernel, euler))
        if number % 20 == 19:
            _show_progress(number + 1, n_scenes)
    return total


def random_scene(rng: np.random.Generator, number: int) -> RolloutProblem:
    """Draw a scene; in turn a steady, a braking and a curving mover, then a moving target."""
    kind = number % 4
    target = np.append(rng.uniform([0.05, -0.15], [0.2, 0.15]), 0.0)
    start = np.append(rng.uniform([0.0, -0.35], [0.45, 0.35]), 0.0)
    aim = target + np.append(rng.normal(0.0, 0.03, 2), 0.0) - start
    velocity = aim / rng.uniform(0.8, 6.0)
    acceleration = np.zeros(3)
    if kind == 1:
        acceleration = -velocity * rng.uniform(0.0, 0.6)
    elif kind == 2:
        acceleration[:2] = rng.normal(0.0, 0.05, 2)
    target_velocity = np.append(rng.normal(0.0, 0.04, 2), 0.0) if kind == 3 else np.zeros(3)
    return RolloutProblem(
        seq=number,
        t_s=0.0,
        mover_id=1,
        target_id=2,
        mover_pos_m=start,
        mover_vel_m_s=velocity,
        mover_acc_m_s2=acceleration,
        mover_cov=np.zeros((6, 6)),
        mover_radius_m=float(rng.uniform(0.01, 0.03)),
        target_pos_m=target,
        target_vel_m_s=target_velocity,
        target_radius_m=float(rng.uniform(0.01, 0.03)),
        obstacle_pos_m=np.append(rng.uniform([0.0, -0.2], [0.2, 0.2]), 0.0).reshape(1, 3),
        obstacle_radius_m=np.array([0.02]),
        tip_radius_m=0.012,
        dt_s=float(rng.choice(_STEPS_S)),
    )


def _add(
    total: Agreement,
    problem: RolloutProblem,
    grid: Candidates,
    arrival_s: Array,
    back_ends: Tuple[PhysicsSim, PhysicsSim],
) -> None:
    tips = np.ascontiguousarray(grid.tip_m[:, :2])
    left, right = (sim.outcomes(problem, tips, arrival_s) for sim in back_ends)
    left_safe, right_safe = (_is_safe(problem, grid, arrival_s, found) for found in (left, right))
    total.n_scenes += 1
    total.n_rollouts += len(tips)
    total.n_collided += int((right.collision_step != NEVER).sum())
    total.n_blocked += int((right.blocked_step != NEVER).sum())
    total.n_safe += int(right_safe.sum())
    is_other = left_safe != right_safe
    for name in _FLAGS:
        is_other |= getattr(left, name) != getattr(right, name)
    total.n_different_flags += int(is_other.sum())
    total.n_different_flags += int(left.free_collision_step != right.free_collision_step)
    for name in _METRES:
        one, other = getattr(left, name), getattr(right, name)
        is_number = np.isfinite(one) & np.isfinite(other)
        off = np.abs(one[is_number] - other[is_number])
        total.n_different_distances += int((off > _SAME_M).sum())
        total.n_different_distances += int((np.isfinite(one) != np.isfinite(other)).sum())
        total.max_difference_m = max(total.max_difference_m, float(off.max(initial=0.0)))


def _is_safe(problem: RolloutProblem, grid: Candidates, arrival_s: Array, found: Outcomes) -> Array:
    clearance = clearance_m(problem, grid, arrival_s, found)
    return safe(problem, found, slack_s(found, problem, arrival_s), clearance)


def _report(
    args: argparse.Namespace,
    n_candidates: int,
    cpu_ms: Dict[str, float],
    agreement: Agreement,
    is_loop_same: bool,
) -> Dict[str, Any]:
    return {
        "format": "apex-bench-rollout-1",
        "seed": args.seed,
        "n_candidates": n_candidates,
        "horizon_s": SimulateConfig().horizon_s,
        "machine": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "processor": platform.machine(),
            "n_cores": os.cpu_count(),
        },
        "cpu_ms": cpu_ms,
        "times_the_kernel": {name: ms / cpu_ms["kernel, dt 0.01"] for name, ms in cpu_ms.items()},
        "agreement": dict(vars(agreement), is_full=agreement.is_full, is_loop_same=is_loop_same),
    }


def _table(cpu_ms: Dict[str, float], n_candidates: int) -> str:
    base = cpu_ms["kernel, dt 0.01"]
    lines = [f"{f'{n_candidates} roll-outs of 5 s':<38}{'CPU ms':>10}{'x kernel':>10}"]
    lines += [f"{name:<38}{ms:>10.3f}{ms / base:>10.1f}" for name, ms in cpu_ms.items()]
    return "\n".join(lines)


def _verdict(agreement: Agreement, is_loop_same: bool) -> str:
    a = agreement
    return (
        f"{a.n_scenes} random scenes, {a.n_rollouts} roll-outs: {a.n_collided} collide, "
        f"{a.n_blocked} blocked, {a.n_safe} safe\n"
        f"kernel against stepped Euler: {a.n_different_flags} flags and "
        f"{a.n_different_distances} distances differ (largest {a.max_difference_m:.1e} m)\n"
        f"plain loop on the timed scene: {'the same flags' if is_loop_same else 'OTHER FLAGS'}"
    )


def _show_progress(done: int, n_scenes: int) -> None:
    if sys.stderr.isatty():
        sys.stderr.write(f"\rcomparing on random scenes: {done}/{n_scenes}")
        sys.stderr.flush()


def _finish_progress() -> None:
    if sys.stderr.isatty():
        sys.stderr.write("\r" + " " * 60 + "\r")
