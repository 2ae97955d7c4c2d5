"""A small scene for the planner tests: green rolls towards red, seven candidates, six safe."""

import threading
import time

import numpy as np

from apex_edge.planners.base import PlanRequest
from apex_edge.planners.dialect import Question
from apex_edge.planners.prompts import index_schema
from apex_edge.types import Candidates, Rollouts, Tracks

TIP_M = np.array(
    [
        [0.100, 0.000],
        [0.120, 0.030],
        [0.140, 0.060],
        [0.160, -0.020],
        [0.180, 0.010],
        [0.150, -0.070],
        [0.110, 0.090],
    ]
)
QUESTION = Question("pick one", index_schema(5))
BEST = (4, 2, 0, 6, 1, 3)  # candidate 5 is not safe


def tracks(
    names=("green", "red"), pos_m=((0.22, 0.14), (0.12, 0.03)), vel=((-0.06, -0.03), (0, 0))
):
    n = len(names)
    pos = np.zeros((n, 3))
    pos[:, :2] = pos_m
    vel_m_s = np.zeros((n, 3))
    vel_m_s[:, :2] = vel
    return Tracks(
        seq=7,
        t_s=1.0,
        name=tuple(names),
        track_id=np.arange(1, n + 1),
        pos_m=pos,
        vel_m_s=vel_m_s,
        acc_m_s2=np.zeros((n, 3)),
        cov=np.zeros((n, 6, 6)),
        radius_m=np.full(n, 0.015),
        n_samples=np.full(n, 5),
        status=np.zeros(n, dtype=np.int64),
        age_s=np.zeros(n),
        centre_px=np.zeros((n, 2)),
        area_px2=np.full(n, 300.0),
        is_manoeuvre=np.zeros(n, dtype=bool),
        is_blurred=np.zeros(n, dtype=bool),
        smooth_m=pos,
        seen_m=pos,
        seen_sd_m=np.full(n, 0.001),
    )


def rollouts(best=BEST, seq=7):
    n = len(TIP_M)
    tip_m = np.zeros((n, 3))
    tip_m[:, :2] = TIP_M
    tip_m[:, 2] = 0.005
    is_safe = np.ones(n, dtype=bool)
    is_safe[5] = False
    return Rollouts(
        seq=seq,
        t_s=1.0,
        candidates=Candidates(1, tip_m, np.zeros((n, 4)), np.zeros((n, 4))),
        mover_id=1,
        target_id=2,
        t_free_collision_s=2.1,
        arrival_s=np.array([0.9, 1.1, 0.8, 1.0, 0.7, 0.5, 1.4]),
        is_collision=~is_safe,
        is_blocked=is_safe,
        t_blocked_s=np.full(n, 1.5),
        t_collision_s=np.where(is_safe, np.inf, 2.1),
        min_distance_m=np.array([0.021, 0.032, 0.062, 0.043, 0.055, 0.01, 0.081]),
        t_min_s=np.full(n, 1.5),
        final_distance_m=np.full(n, 0.05),
        slack_s=np.full(n, 0.6),
        clearance_m=np.full(n, 0.02),
        is_safe=is_safe,
        score=np.where(is_safe, 1.0, -np.inf),
        best=np.array(best, dtype=np.int64),
    )


def request(deadline_s=5.0, **changes):
    values = dict(
        snapshot=7,
        t_s=1.0,
        deadline_s=deadline_s,
        mode="reflex_first",
        summary="green will hit red",
        tracks=tracks(),
        rollouts=rollouts(),
    )
    values.update(changes)
    return PlanRequest(**values)


def wait_for(condition):
    deadline_s = time.monotonic() + 10.0
    while not condition() and time.monotonic() < deadline_s:
        time.sleep(0.005)
    assert condition()


def workers():
    return [
        t for t in threading.enumerate() if t.name == "apex-llm" or isinstance(t, threading.Timer)
    ]
