"""A small made-up run for the tests of cameras and recordings: a ball rolls at a red block."""

from typing import List, Optional

import numpy as np

from apex_edge.geometry import look_at, project
from apex_edge.types import (
    ArmAck,
    ArmCommand,
    ArmState,
    Array,
    CameraModel,
    Candidates,
    Decision,
    Detections,
    Frame,
    HazardScores,
    Proposal,
    Rollouts,
    Step,
    Tracks,
)

HEIGHT, WIDTH = 120, 160


def camera_model(width: int = WIDTH, height: int = HEIGHT) -> CameraModel:
    return CameraModel(
        width_px=width,
        height_px=height,
        fx_px=0.875 * width,
        fy_px=0.875 * width,
        cx_px=(width - 1) / 2,
        cy_px=(height - 1) / 2,
        dist=np.array([0.01, -0.02, 0.001, -0.001, 0.0]),
        table_from_cam=look_at(np.array([0.60, 0.0, 0.55]), np.array([0.20, 0.0, 0.0])),
    )


def picture(seq: int, width: int = WIDTH, height: int = HEIGHT) -> Array:
    rng = np.random.RandomState(seq)
    base = rng.randint(90, 200, (height // 8, width // 8, 3)).astype(np.uint8)
    return np.repeat(np.repeat(base, 8, axis=0), 8, axis=1)


def frame(seq: int, camera: Optional[CameraModel] = None, has_depth: bool = True) -> Frame:
    depth = None
    if has_depth:
        depth = np.random.RandomState(seq + 999).randint(0, 65536, (HEIGHT, WIDTH))
        depth = depth.astype(np.uint16)
    return Frame(
        seq=seq, t_s=10.0 + seq / 30.0, colour_bgr=picture(seq), depth_mm=depth, camera=camera
    )


def candidates(n: int = 60) -> Candidates:
    yaw = np.linspace(-1.4, 1.4, n)
    radius = 0.08 + 0.118 * (np.arange(n) % 7) / 6.0
    tip = np.column_stack([radius * np.cos(yaw), radius * np.sin(yaw), np.full(n, 0.005)])
    joints = np.column_stack([yaw, np.full(n, 0.5), np.full(n, 1.0), np.full(n, -0.5)])
    return Candidates(version=1, tip_m=tip, joints_rad=joints, hover_rad=joints + 0.1)


def tracks(of: Frame, camera: Optional[CameraModel]) -> Tracks:
    t = of.t_s - 10.0
    pos = np.array([[0.42 - 0.10 * t, 0.16 - 0.06 * t, 0.015], [0.13, 0.0, 0.02]])
    vel = np.array([[-0.10, -0.06, 0.0], [0.0, 0.0, 0.0]])
    centre = np.array([[40.0 + of.seq, 50.0], [80.0, 90.0]])
    if camera is not None:
        centre, _ = project(camera, pos)
    else:
        pos, vel = np.full((2, 3), np.nan), np.full((2, 3), np.nan)
    scale = of.colour_bgr.shape[0] / 480.0
    return Tracks(
        seq=of.seq,
        t_s=of.t_s,
        name=("green", "red"),
        track_id=np.array([1, 2]),
        pos_m=pos,
        vel_m_s=vel,
        acc_m_s2=np.zeros((2, 3)),
        cov=np.tile(np.eye(6) * 1e-6, (2, 1, 1)),
        radius_m=np.array([0.015, 0.02]),
        n_samples=np.array([5, 5]),
        status=np.array([0, 0]),
        age_s=np.zeros(2),
        centre_px=centre,
        area_px2=np.array([900.0, 1400.0]) * scale * scale,
        is_manoeuvre=np.zeros(2, dtype=bool),
        is_blurred=np.zeros(2, dtype=bool),
        smooth_m=pos,
        seen_m=pos,
        seen_sd_m=np.full(2, 0.001),
    )


def detections(found: Tracks) -> Detections:
    side = np.sqrt(found.area_px2)
    corner = found.centre_px - side[:, None] / 2
    return Detections(
        seq=found.seq,
        t_s=found.t_s,
        name=found.name,
        centre_px=found.centre_px,
        area_px2=found.area_px2,
        box_px=np.column_stack([corner, side, side]),
        touches_border=np.zeros(2, dtype=bool),
        spread_px2=np.zeros((2, 3)),
        is_part=np.zeros(2, dtype=bool),
        pos_m=found.pos_m,
        pos_sd_m=np.full(2, 1e-3),
        radius_m=found.radius_m,
    )


def hazards(of: Frame) -> HazardScores:
    left = max(0.1, 2.6 - (of.t_s - 10.0))
    return HazardScores(
        seq=of.seq,
        t_s=of.t_s,
        mover_id=np.array([1]),
        target_id=np.array([2]),
        probability=np.array([0.97]),
        dca_m=np.array([0.008]),
        tca_s=np.array([left]),
        ttc_s=np.array([left - 0.2]),
        ttc_early_s=np.array([left - 0.4]),
        sigma_m=np.array([0.004]),
        is_fired=np.array([True]),
        is_fallback=np.array([False]),
    )


def rollouts(of: Frame, points: Candidates) -> Rollouts:
    n = len(points.tip_m)
    rng = np.random.RandomState(7)
    arrival = 0.5 + 0.8 * rng.rand(n)
    side = points.tip_m[:, 1] / np.maximum(points.tip_m[:, 0], 1e-6)
    is_blocked = np.abs(side - 0.35) < 0.25
    slack = 1.4 - arrival - points.tip_m[:, 0] * 3.0
    is_safe = is_blocked & (slack > 0)
    score = np.where(is_safe, slack, -np.inf)
    best = np.argsort(-score, kind="stable")[: min(5, int(is_safe.sum()))]
    return Rollouts(
        seq=of.seq,
        t_s=of.t_s,
        candidates=points,
        mover_id=1,
        target_id=2,
        t_free_collision_s=2.4,
        arrival_s=arrival,
        is_collision=~(is_blocked & (slack > 0)),
        is_blocked=is_blocked,
        t_blocked_s=np.where(is_blocked, 1.4, np.inf),
        t_collision_s=np.where(is_safe, np.inf, 2.4),
        min_distance_m=np.where(is_safe, 0.08, 0.03),
        t_min_s=np.full(n, 2.0),
        final_distance_m=np.full(n, 0.1),
        slack_s=slack,
        clearance_m=np.full(n, 0.05),
        is_safe=is_safe,
        score=score,
        best=best,
    )


def step(
    seq: int,
    camera: Optional[CameraModel] = None,
    points: Optional[Candidates] = None,
    picture_of: Optional[Frame] = None,
) -> Step:
    """Frame 0-9 quiet, 10-19 hazard seen, from 20 rollouts, frame 25 acts, then the arm stands."""
    of = picture_of if picture_of is not None else frame(seq, camera)
    found = tracks(of, camera)
    points = points if points is not None else candidates()
    has_hazard, has_rollouts, acts = 10 <= seq < 40, 20 <= seq < 40, seq == 25
    outcome = rollouts(of, points) if has_rollouts else None
    index = int(outcome.best[0]) if outcome is not None else -1
    action = "intervene" if acts else "watch" if 10 <= seq < 25 else "hold" if seq > 25 else "none"
    target = tuple(float(v) for v in points.tip_m[index]) if 25 <= seq < 40 else None
    joints = points.joints_rad[[index]]
    tip = points.tip_m[index] if 25 <= seq < 40 else np.array([0.10, 0.0, 0.12])
    return Step(
        frame=of,
        detections=detections(found),
        tracks=found,
        difference=None,
        hazards=hazards(of) if has_hazard else None,
        rollouts=outcome,
        proposal=Proposal("llm", "move", seq, index, 0.8) if acts else None,
        decision=Decision(
            seq=seq,
            t_s=of.t_s,
            action=action,
            source="reflex" if acts else "none",
            index=index if 25 <= seq < 40 else -1,
            target_m=target,
            mover_id=1 if has_hazard else -1,
            target_id=2 if has_hazard else -1,
            deadline_s=of.t_s + 0.4 if has_hazard else float("nan"),
            ttc_s=2.0 if has_hazard else float("inf"),
            verdict="late" if acts else "",
            reason="deadline reached, best verified candidate" if acts else "",
            summary="green ball will pass within 0.8 cm of the red block in 2.1 s"
            if has_hazard
            else "",
        ),
        command=ArmCommand(seq, of.t_s, joints, np.array([0.6])) if acts else None,
        ack=ArmAck(seq, of.t_s, of.t_s + 0.01, True, joints, np.array([0.6])) if acts else None,
        arm=ArmState(of.t_s, joints[0], tip, acts, "commanded"),
        timing_s={
            "perception": 0.004 + 0.001 * (seq % 3),
            "graph": 0.0005,
            "trigger": 0.0004,
            "simulate": 0.006 if has_rollouts else 0.0,
            "decide": 0.0003,
            "act": 0.002 if acts else 0.0,
        },
    )


def run(n: int, camera: Optional[CameraModel] = None) -> List[Step]:
    points = candidates()
    return [step(seq, camera, points) for seq in range(n)]
