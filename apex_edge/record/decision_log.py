"""decisions.jsonl: one canonical line of JSON per frame, equal bytes for equal runs."""

import json
from typing import Any, Dict

from apex_edge.record.messages import (
    ack_message,
    command_message,
    decision_message,
    hazards_message,
    plain,
    proposal_message,
    rollouts_message,
    tracks_message,
)
from apex_edge.record.whole import WholeText
from apex_edge.types import Step

N_EDGES = 5
"""Most salient edges kept per line; the paper's top-k is 5."""

DECIMALS = 9
"""Absolute rounding: hides the last bits in which two numpy builds differ, keeps nanometres."""


def to_json_line(step: Step) -> str:
    """Return one frame's outcome as canonical JSON (sorted keys, fixed rounding), no line end.

    It holds nothing that was read off a wall clock, so the same recording, settings and seed give
    the same bytes. NaN and infinity are null.
    """
    entry: Dict[str, Any] = {
        "seq": step.decision.seq,
        "t_s": step.decision.t_s,
        "tracks": tracks_message(step.tracks),
        "decision": decision_message(step.decision),
    }
    if step.hazards is not None:
        entry["hazards"] = hazards_message(step.hazards, N_EDGES)
    if step.rollouts is not None:
        entry["rollouts"] = rollouts_message(step.rollouts)
    if step.proposal is not None:
        entry["proposal"] = proposal_message(step.proposal)
    if step.command is not None:
        entry["command"] = command_message(step.command)
    if step.ack is not None:
        entry["ack"] = ack_message(step.ack)
    return json.dumps(
        plain(entry, DECIMALS),
        sort_keys=True,
        separators=(",", ":"),
        ensure_ascii=False,
        allow_nan=False,
    )


class DecisionLog(WholeText):
    """Write decisions.jsonl; the file appears when closed.

    Raises
    ------
    RecordingError : the folder is missing or not writable.
    """

    def write(self, step: Step) -> None:
        """Append one frame."""
        self.write_text(to_json_line(step) + "\n")
