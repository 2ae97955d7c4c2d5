"""The values that flow, from photon to servo byte.

``Frame -> Detections -> Tracks -> SceneGraph -> HazardScores -> Rollouts -> Proposal ->
Decision -> ArmCommand -> ArmAck``

Frozen dataclasses, struct of arrays, no logic and no I/O. Each carries ``t_s``, the monotonic
capture time of the frame it stems from, and ``seq``, that frame's number, so latency can be
read off at any stage. All lengths are metres in the table frame unless the name says otherwise:
origin on the table under the arm's base axis, x forward, y left, z up (ROS REP-103).
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Mapping, Optional, Tuple

import numpy as np

Array = np.ndarray


class TrackStatus(IntEnum):
    """Say how a track got its position in this frame."""

    SEEN = 0
    PREDICTED = 1
    LOST = 2


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole lens: picture size, focal lengths, principal point; ``dist`` (k1, k2, p1, p2, k3)."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    dist: Array


@dataclass(frozen=True)
class CameraModel(Intrinsics):
    """Pinhole camera and its pose over the table.

    ``table_from_cam`` is a (4, 4) rigid transform; the camera looks along its own +z,
    x right, y down (OpenCV).
    """

    table_from_cam: Array


@dataclass(frozen=True)
class Frame:
    """One picture: colour (h, w, 3) uint8 BGR, depth (h, w) uint16 in mm.

    A depth of 0 is a hole, 65535 is saturated; neither is a distance.
    """

    seq: int
    t_s: float
    colour_bgr: Array
    depth_mm: Optional[Array] = None
    camera: Optional[CameraModel] = None
    is_repeated: bool = False


@dataclass(frozen=True)
class Detections:
    """Blobs found in one frame, n of them.

    ``centre_px (n, 2)``, ``area_px2 (n,)``, ``box_px (n, 4)`` x, y, w, h;
    ``spread_px2 (n, 3)`` second central moments xx, xy, yy; ``is_part (n,)`` cut out of a blob
    that several objects share; ``pos_m (n, 3)``, ``pos_sd_m (n,)`` and ``radius_m (n,)`` are NaN
    without a calibration.
    """

    seq: int
    t_s: float
    name: Tuple[str, ...]
    centre_px: Array
    area_px2: Array
    box_px: Array
    touches_border: Array
    spread_px2: Array
    is_part: Array
    pos_m: Array
    pos_sd_m: Array
    radius_m: Array


@dataclass(frozen=True)
class Tracks:
    """Objects followed over time, n of them, all at the same capture time ``t_s``.

    ``track_id (n,)`` int64, ``pos_m (n, 3)``, ``vel_m_s (n, 3)``, ``acc_m_s2 (n, 3)``,
    ``cov (n, 6, 6)`` of position and velocity, ``radius_m (n,)``, ``n_samples (n,)`` behind the
    motion fit, ``status (n,)`` of TrackStatus, ``age_s (n,)`` since last seen,
    ``centre_px (n, 2)``, ``area_px2 (n,)``, ``is_manoeuvre (n,)`` when the motion just
    changed, ``is_blurred (n,)`` when the picture smears it along its motion. Without a calibration
    the metric fields are NaN. ``smooth_m (n, 3)`` is the paper's mean of the last five positions.
    ``seen_m (n, 3)`` is the raw sighting in this frame, ``seen_sd_m (n,)`` its stated random sd;
    both NaN when this frame does not show the object.
    """

    seq: int
    t_s: float
    name: Tuple[str, ...]
    track_id: Array
    pos_m: Array
    vel_m_s: Array
    acc_m_s2: Array
    cov: Array
    radius_m: Array
    n_samples: Array
    status: Array
    age_s: Array
    centre_px: Array
    area_px2: Array
    is_manoeuvre: Array
    is_blurred: Array
    smooth_m: Array
    seen_m: Array
    seen_sd_m: Array


@dataclass(frozen=True)
class SceneGraph:
    """Relational graph G_t: the tracks as nodes and all m ordered-once pairs (i < j) as edges.

    ``edges (m, 2)`` index into ``tracks``; ``offset_m (m, 3)`` is pos[j] - pos[i];
    ``rel_vel_m_s (m, 3)`` is vel[j] - vel[i]; ``distance_m (m,)`` between centres.
    Source: APEX section "Graph: Relational Scene Representation".
    """

    seq: int
    t_s: float
    tracks: Tracks
    edges: Array
    offset_m: Array
    rel_vel_m_s: Array
    distance_m: Array


@dataclass(frozen=True)
class DifferenceGraph:
    """dG = G_{t+dt} - G_t on the edges of the newer graph.

    ``displacement_m (m, 3)`` change of the pair's offset, ``rel_vel_m_s (m, 3)``,
    ``closing_m_s (m,)`` (positive when nearing), ``is_new (m,)``; ``vanished`` lists
    (track_id, track_id) of relations that ended. Source: APEX section "Trigger".
    """

    seq: int
    t_s: float
    dt_s: float
    graph: SceneGraph
    displacement_m: Array
    rel_vel_m_s: Array
    closing_m_s: Array
    is_new: Array
    vanished: Tuple[Tuple[int, int], ...]


@dataclass(frozen=True)
class HazardScores:
    """What a trigger says of each edge of a graph, m edges.

    ``mover_id (m,)`` and ``target_id (m,)`` are track ids (the faster of the two moves),
    ``probability (m,)``, ``dca_m (m,)`` distance at closest approach between centres within the
    horizon, ``tca_s (m,)`` its time from now, ``ttc_s (m,)`` time to contact (inf when none),
    ``ttc_early_s (m,)`` pessimistic time to contact (inf when none), ``sigma_m (m,)`` sd of
    the miss distance, ``is_fired (m,)``, ``is_fallback (m,)`` when the analytic rule stood in for
    an out-of-domain input.
    """

    seq: int
    t_s: float
    mover_id: Array
    target_id: Array
    probability: Array
    dca_m: Array
    tca_s: Array
    ttc_s: Array
    ttc_early_s: Array
    sigma_m: Array
    is_fired: Array
    is_fallback: Array


@dataclass(frozen=True)
class Candidates:
    """Intercept points the arm can stand at, n of them; immutable for the life of a run.

    ``tip_m (n, 3)``, ``joints_rad (n, k)`` to stand there, ``hover_rad (n, k)`` straight above.
    """

    version: int
    tip_m: Array
    joints_rad: Array
    hover_rad: Array


@dataclass(frozen=True)
class Rollouts:
    """Outcome descriptors r_i of n candidates, simulated from the state at ``t_s``.

    ``arrival_s (n,)`` arm arrival from now; ``is_collision (n,)`` mover still reaches the target;
    ``is_blocked (n,)`` the arm stops the mover; ``t_blocked_s``, ``t_collision_s (n,)`` (inf when
    never); ``min_distance_m``, ``t_min_s``, ``final_distance_m (n,)`` mover to target, between
    centres; ``slack_s (n,)`` between arm arrival and need; ``clearance_m (n,)`` arm tip to the
    nearest object that must not be touched; ``is_safe (n,)``; ``score (n,)`` higher is better
    (-inf when not safe); ``best (k,)`` indices of the best safe ones, best first.
    Source: APEX section "Simulate", algorithm 1 lines 6-9.
    """

    seq: int
    t_s: float
    candidates: Candidates
    mover_id: int
    target_id: int
    t_free_collision_s: float
    arrival_s: Array
    is_collision: Array
    is_blocked: Array
    t_blocked_s: Array
    t_collision_s: Array
    min_distance_m: Array
    t_min_s: Array
    final_distance_m: Array
    slack_s: Array
    clearance_m: Array
    is_safe: Array
    score: Array
    best: Array


@dataclass(frozen=True)
class Proposal:
    """What a planner wants: an index into the candidates, or no action; never more than a wish.

    ``kind`` is "move", "no_action" or "failure"; ``detail`` holds the failure kind or the reason.
    ``snapshot`` is the ``seq`` of the rollouts the planner was shown.
    """

    source: str
    kind: str
    snapshot: int
    index: int = -1
    latency_s: float = 0.0
    detail: str = ""


@dataclass(frozen=True)
class Decision:
    """What is done about the newest frame, and on what proof.

    ``action``: "none", "watch" (hazard open, deadline not yet), "intervene", "redirect", "hold",
    "return"; ``index`` and ``target_m`` say where the arm was sent. ``source``: "reflex", "llm" or
    "none". ``deadline_s`` is the latest start of the arm on the capture clock (NaN when no hazard
    is open). ``verdict`` says what became of a planner's proposal ("accepted", "stale",
    "refused: unsafe", ... or "").
    """

    seq: int
    t_s: float
    action: str
    source: str
    index: int = -1
    target_m: Optional[Tuple[float, float, float]] = None
    mover_id: int = -1
    target_id: int = -1
    deadline_s: float = float("nan")
    ttc_s: float = float("inf")
    verdict: str = ""
    reason: str = ""
    summary: str = ""


@dataclass(frozen=True)
class ArmState:
    """Where the arm is: ``joints_rad (k,)`` and ``tip_m (3,)``.

    ``source`` is "commanded" for an arm that cannot measure itself, else "measured".
    """

    t_s: float
    joints_rad: Array
    tip_m: Array
    is_moving: bool
    source: str


@dataclass(frozen=True)
class ArmCommand:
    """Joint way-points ``joints_rad (w, k)``, each reached after its own ``duration_s (w,)``."""

    seq: int
    t_s: float
    joints_rad: Array
    duration_s: Array


@dataclass(frozen=True)
class ArmAck:
    """What was really sent: the clipped or accepted way-points, or why nothing was.

    ``t_sent_s`` is when the last byte had been written, on the capture clock.
    """

    seq: int
    t_s: float
    t_sent_s: float
    is_accepted: bool
    joints_rad: Array
    duration_s: Array
    reason: str = ""


@dataclass(frozen=True)
class Step:
    """All that one frame led to; what the recorder stores and the report shows.

    ``timing_s`` maps stage name to the wall time it took; it never enters the decision log.
    """

    frame: Frame
    detections: Detections
    tracks: Tracks
    difference: Optional[DifferenceGraph]
    hazards: Optional[HazardScores]
    rollouts: Optional[Rollouts]
    proposal: Optional[Proposal]
    decision: Decision
    command: Optional[ArmCommand]
    ack: Optional[ArmAck]
    arm: Optional[ArmState]
    timing_s: Mapping[str, float]
