"""The values that flow as plain JSON: what recordings and the decision log hold."""

import base64
import math
from typing import Any, Dict, List, Mapping, Optional

import numpy as np

from apex_edge.types import (
    ArmAck,
    ArmCommand,
    ArmState,
    Array,
    Decision,
    HazardScores,
    Proposal,
    Rollouts,
    Tracks,
    TrackStatus,
)

Plain = Dict[str, Any]


def plain(value: Any, decimals: Optional[int] = None) -> Any:
    """Turn numbers, arrays, tuples and mappings into what strict JSON can say.

    NaN and infinity become None (JSON has neither); with ``decimals`` floats are rounded, and
    -0.0 becomes 0.0 so that equal values are equal text.
    """
    if isinstance(value, np.ndarray):
        return plain(value.tolist(), decimals)
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if isinstance(value, (int, np.integer)):
        return int(value)
    if isinstance(value, (float, np.floating)):
        number = float(value)
        if not math.isfinite(number):
            return None
        return number if decimals is None else round(number, decimals) + 0.0
    if isinstance(value, Mapping):
        return {str(key): plain(item, decimals) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item, decimals) for item in value]
    return value


def packed(values: Array, dtype: str) -> str:
    """Return an array as base64 of little-endian ``dtype`` (e.g. ``<f4``)."""
    return base64.b64encode(np.ascontiguousarray(values, dtype=dtype).tobytes()).decode("ascii")


def tracks_message(tracks: Tracks) -> List[Plain]:
    """List the tracks: id, name, status, pos_m, vel_m_s, radius_m, centre_px."""
    return [
        {
            "id": int(tracks.track_id[i]),
            "name": tracks.name[i],
            "status": TrackStatus(int(tracks.status[i])).name.lower(),
            "pos_m": tracks.pos_m[i],
            "vel_m_s": tracks.vel_m_s[i],
            "radius_m": tracks.radius_m[i],
            "centre_px": tracks.centre_px[i],
        }
        for i in range(len(tracks.name))
    ]


def hazards_message(hazards: HazardScores, n_most: int) -> List[Plain]:
    """List the ``n_most`` edges most worth reading: fired first, then by probability."""
    # ids break ties, so the order does not hang on the order of the edges
    order = np.lexsort(
        (hazards.target_id, hazards.mover_id, -np.nan_to_num(hazards.probability), ~_fired(hazards))
    )
    return [
        {
            "mover": hazards.mover_id[i],
            "target": hazards.target_id[i],
            "probability": hazards.probability[i],
            "dca_m": hazards.dca_m[i],
            "tca_s": hazards.tca_s[i],
            "ttc_s": hazards.ttc_s[i],
            "ttc_early_s": hazards.ttc_early_s[i],
            "is_fired": hazards.is_fired[i],
            "is_fallback": hazards.is_fallback[i],
        }
        for i in order[:n_most]
    ]


def _fired(hazards: HazardScores) -> Array:
    fired: Array = np.asarray(hazards.is_fired, dtype=bool)
    return fired


def rollouts_message(rollouts: Rollouts) -> Plain:
    """Sum up the rollouts: counts, the best candidates and why they are the best."""
    best = np.asarray(rollouts.best, dtype=np.int64)
    return {
        "mover": rollouts.mover_id,
        "target": rollouts.target_id,
        "t_free_collision_s": rollouts.t_free_collision_s,
        "candidates_version": rollouts.candidates.version,
        "n": len(rollouts.is_safe),
        "n_safe": np.count_nonzero(rollouts.is_safe),
        "n_collision": np.count_nonzero(rollouts.is_collision),
        "n_blocked": np.count_nonzero(rollouts.is_blocked),
        "best": best,
        "best_tip_m": rollouts.candidates.tip_m[best],
        "best_slack_s": rollouts.slack_s[best],
    }


def rollouts_detail(rollouts: Rollouts) -> Plain:
    """Pack every candidate's outcome: ``score`` as float32, flags as one byte each.

    Bit 0 of a flag is collision, bit 1 blocked, bit 2 safe.
    """
    flags = (
        np.asarray(rollouts.is_collision, dtype=np.uint8)
        | np.asarray(rollouts.is_blocked, dtype=np.uint8) << 1
        | np.asarray(rollouts.is_safe, dtype=np.uint8) << 2
    )
    return {
        "score_f4_base64": packed(rollouts.score, "<f4"),
        "slack_s_f4_base64": packed(rollouts.slack_s, "<f4"),
        "flags_u1_base64": packed(flags, "u1"),
    }


def decision_message(decision: Decision) -> Plain:
    """Return a decision without its number and time."""
    return {
        "action": decision.action,
        "source": decision.source,
        "index": decision.index,
        "target_m": decision.target_m,
        "mover": decision.mover_id,
        "target": decision.target_id,
        "deadline_s": decision.deadline_s,
        "ttc_s": decision.ttc_s,
        "verdict": decision.verdict,
        "reason": decision.reason,
        "summary": decision.summary,
    }


def proposal_message(proposal: Proposal) -> Plain:
    """Return a planner's proposal; ``latency_s`` is a wall time and stays out of the log."""
    return {
        "source": proposal.source,
        "kind": proposal.kind,
        "snapshot": proposal.snapshot,
        "index": proposal.index,
        "detail": proposal.detail,
    }


def proposal_from(message: Mapping[str, Any]) -> Proposal:
    """Read back a recorded proposal.

    Raises
    ------
    KeyError, TypeError, ValueError : the message is not one.
    """
    return Proposal(
        source=str(message["source"]),
        kind=str(message["kind"]),
        snapshot=int(message["snapshot"]),
        index=int(message["index"]),
        latency_s=float(message.get("latency_s", 0.0)),
        detail=str(message["detail"]),
    )


def command_message(command: ArmCommand) -> Plain:
    """Return the joint way-points."""
    return {"joints_rad": command.joints_rad, "duration_s": command.duration_s}


def ack_message(ack: ArmAck) -> Plain:
    """Return what was really sent; ``t_sent_s`` is a wall time and stays out of the log."""
    return {
        "is_accepted": ack.is_accepted,
        "joints_rad": ack.joints_rad,
        "duration_s": ack.duration_s,
        "reason": ack.reason,
    }


def arm_message(arm: ArmState) -> Plain:
    """Return where the arm is."""
    return {
        "t_s": arm.t_s,
        "joints_rad": arm.joints_rad,
        "tip_m": arm.tip_m,
        "is_moving": arm.is_moving,
        "source": arm.source,
    }


def arm_from(message: Mapping[str, Any]) -> ArmState:
    """Read back a recorded arm state.

    Raises
    ------
    KeyError, TypeError, ValueError : the message is not one.
    """
    return ArmState(
        t_s=float(message["t_s"]),
        joints_rad=np.array(message["joints_rad"], dtype=np.float64),
        tip_m=np.array(message["tip_m"], dtype=np.float64),
        is_moving=bool(message["is_moving"]),
        source=str(message["source"]),
    )
