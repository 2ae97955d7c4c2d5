"""What a session tells: where it stands, where the arm is, and what became of a move."""

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from apex_edge.types import Array

COMMANDED, MEASURED = "commanded", "measured"


class SessionState(Enum):
    """Where the session stands; FAULT and ESTOP are left by ``reset`` alone."""

    CLOSED = "closed"
    CONNECTED = "connected"
    ARMED = "armed"
    MOVING = "moving"
    FAULT = "fault"
    ESTOP = "estop"


LATCHED = (SessionState.FAULT, SessionState.ESTOP)
UP = (SessionState.ARMED, SessionState.MOVING)


def _none() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class JointState:
    """Pose ``joints_rad (k,)`` at ``t_s``, NaN where not ``is_valid (k,)``.

    ``source`` is "measured" where servos can be asked, "commanded" on PWM arms; ``speed_rad_s``
    (k,) likewise; ``age_s`` is how old a measurement is.
    """

    t_s: float
    joints_rad: Array
    is_moving: bool
    source: str = COMMANDED
    speed_rad_s: Array = field(default_factory=_none)
    age_s: float = 0.0
    is_valid: Array = field(default_factory=_none)


@dataclass(frozen=True, eq=False)
class MoveReport:
    """What became of a move: way-points ``(w, k)``, durations ``(w,)`` as accepted, or why not.

    ``t_sent_s`` is when the first segment's last byte had been written (NaN when refused).
    """

    is_accepted: bool
    joints_rad: Array
    duration_s: Array
    t_sent_s: float
    reason: str = ""


def refusal(reason: str, n_joints: int) -> MoveReport:
    """Return the report of a move of which nothing was sent."""
    return MoveReport(False, np.zeros((0, n_joints)), np.zeros(0), math.nan, reason)
