"""Who acts, when, and on what proof: the deadline and the verification (Simplex architecture).

The reflex, the best simulated candidate, is ready before any planner is asked and fires at the
deadline at the latest. A planner's answer is an index into the candidates and is only a wish: it is
checked against roll-outs of the newest state, and it can never make the outcome less safe than
the reflex. No clock, no thread and no socket in here: the same inputs give the same decisions.
Source: ours; the paper's section "LLM: Guided Decision Synthesis" leaves the timing open.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Optional, Tuple

import numpy as np

from apex_edge.config import setting
from apex_edge.types import Decision, Proposal, Rollouts

REFLEX_FIRST = "reflex_first"
WAIT_UNTIL_DEADLINE = "wait_until_deadline"
WAY_HOME_S = 3.0
"""Longer than any way home takes."""


@dataclass(frozen=True)
class DecideConfig:
    """When to act and how long to stay."""

    mode: str = setting(
        REFLEX_FIRST,
        "explicit hazards: act at once; implicit ones: let the planner speak until the deadline",
        choices=(REFLEX_FIRST, WAIT_UNTIL_DEADLINE),
    )
    margin_s: float = setting(0.25, "s kept between the latest start of the arm and the need", 0, 2)
    clear_s: float = setting(0.4, "s without an alarm after which a watched hazard is over", 0, 5)
    hold_s: float = setting(3.0, "s without an alarm after which the arm leaves its post", 0, 60)
    score_drop: float = setting(0.2, "how far below the reflex's score a planner may go", 0, 1)
    good_score: float = setting(0.8, "waiting ends when no candidate scores this any more", 0, 1)
    n_confirm: int = setting(2, "frames in a row that must fault the post before it is left", 1, 10)


@dataclass(frozen=True)
class OpenHazard:
    """The most urgent alarm about a protected object in one frame; times in s from ``t_s``."""

    mover_id: int
    target_id: int
    ttc_s: float
    ttc_early_s: float

    @property
    def pair(self) -> Tuple[int, int]:
        """Return (mover track, target track)."""
        return (self.mover_id, self.target_id)


@dataclass(frozen=True)
class Situation:
    """All that one decision rests on.

    ``hazard`` is None when no alarm is up; ``rollouts`` are of the newest state, with arrival times
    from the arm's pose of now; ``mover_gap_m`` is the edge-to-edge gap between tip and mover.
    """

    seq: int
    t_s: float
    hazard: Optional[OpenHazard]
    rollouts: Optional[Rollouts]
    proposal: Optional[Proposal] = None
    mover_gap_m: float = float("inf")
    period_s: float = 1.0 / 30.0
    summary: str = ""


class Phase(Enum):
    """Where the decider stands with the hazard it follows."""

    IDLE = "idle"
    WATCHING = "watching"
    STANDING = "standing"


class Decider:
    """Turn situations into decisions, one a frame.

    Parameters
    ----------
    config : see DecideConfig.
    """

    def __init__(self, config: DecideConfig) -> None:
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget everything, as at start-up."""
        self.phase = Phase.IDLE
        self.pair: Optional[Tuple[int, int]] = None
        self.snapshot = -1
        self.index = -1
        self.target_m: Optional[Tuple[float, float, float]] = None
        self.arrives_s = float("inf")
        self._last_alarm_s = float("-inf")
        self._returned_s = float("-inf")
        self._n_faults = 0
        self._pending: Optional[Proposal] = None
        self._accepted = Proposal("none", "failure", -1)
        self._before: Tuple[Phase, int, Optional[Tuple[float, float, float]], float] = (
            self.phase,
            self.index,
            self.target_m,
            self.arrives_s,
        )

    def refuse(self) -> None:
        """Take back the last move: the arm did not accept it, so it is still where it was."""
        self.phase, self.index, self.target_m, self.arrives_s = self._before

    def blind(self, t_s: float) -> None:
        """Forget what was foreseen: no picture came, and the arm was stopped on its way.

        An arm away from home goes home once pictures have come for ``hold_s`` without an alarm.
        """
        is_out = self.index >= 0 or self.phase is Phase.STANDING
        is_out = is_out or t_s - self._returned_s < WAY_HOME_S
        self.reset()
        if is_out:
            self.phase = Phase.STANDING
            self._last_alarm_s = t_s

    def remaining_s(self, t_s: float) -> float:
        """Return how long the arm still needs to its commanded post (0 when there)."""
        return max(0.0, self.arrives_s - t_s)

    def step(self, now: Situation) -> Decision:
        """Decide about one frame."""
        if now.proposal is not None:
            self._pending = now.proposal
        if now.hazard is not None:
            self._last_alarm_s = now.t_s
            if now.hazard.pair != self.pair:
                self._open(now)
        if self.phase is Phase.IDLE:
            self._pending = None
            return self._decision(now, "none", verdict="stale" if now.proposal else "")
        if self.phase is Phase.WATCHING:
            return self._watch(now)
        return self._stand(now)

    def _open(self, now: Situation) -> None:
        assert now.hazard is not None
        self.pair = now.hazard.pair
        self.snapshot = now.seq
        self.phase = Phase.WATCHING
        self._n_faults = 0
        self._pending = None

    def _watch(self, now: Situation) -> Decision:
        if now.t_s - self._last_alarm_s > self._config.clear_s:
            return self._close(now)
        if self._does_post_serve(now):
            self.phase = Phase.STANDING
            return self._decision(
                now, "hold", reason="from where it stands the arm stops this one too"
            )
        verdict = self._judge(now)
        if verdict == "accepted":
            return self._go(now, self._accepted.index, self._accepted.source, verdict)
        if now.rollouts is None or len(now.rollouts.best) == 0:
            return self._decision(now, "watch", verdict=verdict, reason="no safe candidate yet")
        deadline_s = self._deadline_s(now)
        is_due = now.t_s + now.period_s >= deadline_s
        if now.hazard is not None and (self._config.mode == REFLEX_FIRST or is_due):
            return self._go(now, int(now.rollouts.best[0]), "reflex", verdict)
        return self._decision(now, "watch", verdict=verdict, reason="waiting for the deadline")

    def _does_post_serve(self, now: Situation) -> bool:
        """Say whether an arm that already stands somewhere stops the mover from there."""
        rollouts = now.rollouts
        if self.index < 0 or rollouts is None:
            return False
        return bool(rollouts.is_blocked[self.index] and not rollouts.is_collision[self.index])

    def _close(self, now: Situation) -> Decision:
        """End a watch whose alarm went away; an arm that still stands guard keeps standing."""
        is_standing = self.index >= 0
        self.phase = Phase.STANDING if is_standing else Phase.IDLE
        self.pair = None
        action = "hold" if is_standing else "none"
        return self._decision(now, action, reason="the hazard went away")

    def _stand(self, now: Situation) -> Decision:
        if now.t_s - self._last_alarm_s > self._config.hold_s:
            before = (self.phase, self.index, self.target_m, self.arrives_s)
            self.reset()
            self._before, self._returned_s = before, now.t_s
            return self._decision(now, "return", reason="no alarm any more")
        verdict = self._judge(now)
        if verdict == "accepted":
            return self._go(now, self._accepted.index, self._accepted.source, verdict)
        if self._is_post_useless(now):
            assert now.rollouts is not None
            return self._go(now, int(now.rollouts.best[0]), "reflex", verdict)
        return self._decision(now, "hold", verdict=verdict)

    def _is_post_useless(self, now: Situation) -> bool:
        """Say whether a newer look shows that the post will not stop the mover and another will."""
        rollouts = now.rollouts
        if now.hazard is None or rollouts is None or now.mover_gap_m < 0.008:
            self._n_faults = 0
            return False
        self._n_faults = 0 if self._does_post_serve(now) else self._n_faults + 1
        has_better = len(rollouts.best) > 0 and int(rollouts.best[0]) != self.index
        return self._n_faults >= self._config.n_confirm and has_better

    def _judge(self, now: Situation) -> str:
        """Verify a proposal against the newest roll-outs and name the verdict.

        It is "" without a proposal, and while one waits out a frame that shows no alarm.
        """
        proposal, rollouts = self._pending, now.rollouts
        if proposal is None:
            return ""
        is_about_now = proposal.kind == "move" and proposal.snapshot == self.snapshot
        if is_about_now and (now.hazard is None or rollouts is None):
            return ""
        self._pending = None
        if proposal.kind == "failure":
            return f"failed: {proposal.detail}"
        if proposal.snapshot != self.snapshot:
            return "stale"
        if proposal.kind == "no_action":
            return "refused: still collides" if now.hazard is not None else "agreed: no action"
        assert rollouts is not None
        self._accepted = proposal
        if not 0 <= proposal.index < len(rollouts.is_safe):
            return "refused: not a candidate"
        if proposal.index == self.index and self.phase is Phase.STANDING:
            return "agreed"
        if not rollouts.is_safe[proposal.index]:
            return "refused: unsafe"
        return self._judge_score(rollouts, proposal.index)

    def _judge_score(self, rollouts: Rollouts, index: int) -> str:
        rival = self.index if self.phase is Phase.STANDING else int(rollouts.best[0])
        if rollouts.score[index] < rollouts.score[rival] - self._config.score_drop:
            return "refused: worse than the reflex"
        return "accepted"

    def _go(self, now: Situation, index: int, source: str, verdict: str) -> Decision:
        assert now.rollouts is not None
        action = "redirect" if self.index >= 0 else "intervene"
        self._before = (Phase.WATCHING, self.index, self.target_m, self.arrives_s)
        self.phase = Phase.STANDING
        self.index = index
        x_m, y_m, z_m = (float(v) for v in now.rollouts.candidates.tip_m[index])
        self.target_m = (x_m, y_m, z_m)
        self.arrives_s = now.t_s + float(now.rollouts.arrival_s[index])
        self._n_faults = 0
        return self._decision(now, action, source, verdict)

    def _deadline_s(self, now: Situation) -> float:
        """Return the latest start: pessimistic need - arm travel - margin, over the good ones.

        Waiting uses candidates up, the best first. So it ends with the last good one, not with the
        last safe one; when none is good, the latest start is now.
        """
        rollouts = now.rollouts
        if rollouts is None or len(rollouts.best) == 0:
            return float("nan")
        good = rollouts.best[rollouts.score[rollouts.best] >= self._config.good_score]
        if len(good) == 0:
            return now.t_s
        return now.t_s + float(np.max(rollouts.slack_s[good])) - self._config.margin_s

    def _decision(
        self,
        now: Situation,
        action: str,
        source: str = "none",
        verdict: str = "",
        reason: str = "",
    ) -> Decision:
        mover_id, target_id = self.pair or (-1, -1)
        return Decision(
            seq=now.seq,
            t_s=now.t_s,
            action=action,
            source=source,
            index=self.index,
            target_m=self.target_m,
            mover_id=mover_id,
            target_id=target_id,
            deadline_s=self._deadline_s(now) if self.pair is not None else float("nan"),
            ttc_s=now.hazard.ttc_s if now.hazard is not None else float("inf"),
            verdict=verdict,
            reason=reason,
            summary=now.summary,
        )
