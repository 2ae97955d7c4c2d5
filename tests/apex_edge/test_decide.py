"""The decider: the reflex fires in time, a planner's answer is only ever a wish."""

from typing import Optional, Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apex_edge.decide import (
    REFLEX_FIRST,
    WAIT_UNTIL_DEADLINE,
    DecideConfig,
    Decider,
    OpenHazard,
    Phase,
    Situation,
)
from apex_edge.types import Candidates, Decision, Proposal, Rollouts

PERIOD_S = 1.0 / 30.0
HAZARD = OpenHazard(mover_id=1, target_id=2, ttc_s=3.0, ttc_early_s=2.7)


def make_rollouts(
    slack_s: Sequence[float],
    score: Sequence[float],
    seq: int = 0,
    is_safe: Optional[Sequence[bool]] = None,
    arrival_s: float = 0.5,
) -> Rollouts:
    n = len(slack_s)
    safe = np.array(is_safe if is_safe is not None else [True] * n)
    ranked = [i for i in np.argsort(-np.asarray(score), kind="stable") if safe[i]]
    full = np.full(n, 1.0)
    points = np.column_stack([np.linspace(0.1, 0.19, n), np.zeros(n), np.full(n, 0.005)])
    return Rollouts(
        seq=seq,
        t_s=seq * PERIOD_S,
        candidates=Candidates(1, points, np.zeros((n, 4)), np.zeros((n, 4))),
        mover_id=1,
        target_id=2,
        t_free_collision_s=3.0,
        arrival_s=np.full(n, arrival_s),
        is_collision=~safe,
        is_blocked=safe,
        t_blocked_s=full,
        t_collision_s=full,
        min_distance_m=full,
        t_min_s=full,
        final_distance_m=full,
        slack_s=np.asarray(slack_s, dtype=float),
        clearance_m=full,
        is_safe=safe,
        score=np.where(safe, np.asarray(score, dtype=float), -np.inf),
        best=np.array(ranked[:5], dtype=np.int64),
    )


def situation(
    seq: int,
    hazard: Optional[OpenHazard] = HAZARD,
    rollouts: Optional[Rollouts] = None,
    proposal: Optional[Proposal] = None,
) -> Situation:
    return Situation(
        seq=seq, t_s=seq * PERIOD_S, hazard=hazard, rollouts=rollouts, proposal=proposal
    )


def llm(index: int, snapshot: int = 0, kind: str = "move") -> Proposal:
    return Proposal(source="llm", kind=kind, snapshot=snapshot, index=index)


def waiting() -> Decider:
    return Decider(DecideConfig(mode=WAIT_UNTIL_DEADLINE, margin_s=0.2))


def test_no_alarm_means_no_action() -> None:
    decider = Decider(DecideConfig())
    assert decider.step(situation(0, hazard=None)).action == "none"
    assert decider.phase is Phase.IDLE


def test_reflex_first_acts_on_the_first_frame_with_a_safe_candidate() -> None:
    decider = Decider(DecideConfig(mode=REFLEX_FIRST))
    assert decider.step(situation(0, rollouts=None)).action == "watch"
    decision = decider.step(situation(1, rollouts=make_rollouts([1, 1], [0.2, 0.9], 1)))
    assert (decision.action, decision.source, decision.index) == ("intervene", "reflex", 1)
    assert decision.target_m is not None
    assert decision.target_m[0] == pytest.approx(0.19)


def test_waiting_mode_fires_the_reflex_no_later_than_the_deadline() -> None:
    decider = waiting()
    acted = None
    for seq in range(60):
        slack = 1.0 - seq * PERIOD_S
        decision = decider.step(situation(seq, rollouts=make_rollouts([slack], [1.0], seq)))
        if decision.action == "intervene":
            acted = decision
            break
        assert decision.action == "watch"
        assert decision.deadline_s == pytest.approx(0.8)
    assert acted is not None
    assert acted.source == "reflex"
    assert 0.8 - 2 * PERIOD_S <= acted.t_s <= 0.8


def test_an_answer_in_time_is_taken_before_the_deadline() -> None:
    decider = waiting()
    decider.step(situation(0, rollouts=make_rollouts([1, 1], [1.0, 0.9])))
    decision = decider.step(
        situation(1, rollouts=make_rollouts([1, 1], [1.0, 0.9], 1), proposal=llm(1))
    )
    assert (decision.action, decision.source, decision.verdict) == ("intervene", "llm", "accepted")
    assert decision.index == 1


@pytest.mark.parametrize(
    ("proposal", "verdict"),
    [
        (llm(2), "refused: unsafe"),
        (llm(7), "refused: not a candidate"),
        (llm(-1), "refused: not a candidate"),
        (llm(1, snapshot=99), "stale"),
        (llm(1), "refused: worse than the reflex"),
        (llm(-1, kind="no_action"), "refused: still collides"),
        (Proposal("llm", "failure", 0, detail="timeout"), "failed: timeout"),
    ],
)
def test_a_bad_answer_is_refused_and_the_reflex_still_fires(
    proposal: Proposal, verdict: str
) -> None:
    decider = waiting()

    def rolled(seq: int, slack: float) -> Rollouts:
        return make_rollouts([slack] * 3, [2.0, 0.1, 9.0], seq, is_safe=[True, True, False])

    decider.step(situation(0, rollouts=rolled(0, 1.0)))
    answered = decider.step(situation(1, rollouts=rolled(1, 0.9), proposal=proposal))
    assert (answered.action, answered.verdict) == ("watch", verdict)
    due = decider.step(situation(2, rollouts=rolled(2, 0.1)))
    assert (due.action, due.source, due.index) == ("intervene", "reflex", 0)


def test_a_no_action_answer_is_agreed_only_when_the_alarm_is_gone() -> None:
    decider = waiting()
    rollouts = make_rollouts([1.0], [1.0])
    decider.step(situation(0, rollouts=rollouts))
    decision = decider.step(
        situation(1, hazard=None, rollouts=rollouts, proposal=llm(-1, kind="no_action"))
    )
    assert (decision.action, decision.verdict) == ("watch", "agreed: no action")


def test_the_hazard_that_goes_away_is_closed_without_moving() -> None:
    decider = waiting()
    actions = [decider.step(situation(0, rollouts=make_rollouts([1.0], [1.0]))).action]
    actions += [decider.step(situation(seq, hazard=None)).action for seq in range(1, 30)]
    assert set(actions) == {"watch", "none"}
    assert decider.phase is Phase.IDLE


def test_a_post_that_no_longer_blocks_is_left_after_confirmation() -> None:
    decider = Decider(DecideConfig(n_confirm=2))
    decider.step(situation(0, rollouts=make_rollouts([1, 1], [1.0, 0.9])))
    missed = [False, True]
    first = decider.step(situation(1, rollouts=make_rollouts([1, 1], [1, 1], 1, missed)))
    second = decider.step(situation(2, rollouts=make_rollouts([1, 1], [1, 1], 2, missed)))
    assert first.action == "hold"
    assert (second.action, second.source, second.index) == ("redirect", "reflex", 1)


def test_a_late_answer_may_redirect_only_to_a_safe_point_as_good_as_the_post() -> None:
    decider = Decider(DecideConfig(score_drop=0.1))
    decider.step(situation(0, rollouts=make_rollouts([1, 1, 1], [1.0, 0.95, 0.2])))
    rollouts = make_rollouts([1, 1, 1], [1.0, 0.95, 0.2], 1)
    worse = decider.step(situation(1, rollouts=rollouts, proposal=llm(2)))
    assert (worse.action, worse.verdict) == ("hold", "refused: worse than the reflex")
    good = decider.step(situation(2, rollouts=rollouts, proposal=llm(1)))
    assert (good.action, good.source, good.index) == ("redirect", "llm", 1)


def test_the_arm_returns_once_the_table_has_been_quiet() -> None:
    decider = Decider(DecideConfig(hold_s=1.0))
    decider.step(situation(0, rollouts=make_rollouts([1], [1])))
    actions = [decider.step(situation(seq, hazard=None)).action for seq in range(1, 40)]
    assert actions.count("return") == 1
    assert actions[:25] == ["hold"] * 25
    assert actions[-1] == "none"


@pytest.mark.parametrize(("serves", "action"), [(True, "hold"), (False, "redirect")])
def test_a_second_mover_moves_the_arm_only_when_its_post_does_not_stop_that_one_too(
    serves: bool, action: str
) -> None:
    decider = Decider(DecideConfig())
    decider.step(situation(0, rollouts=make_rollouts([1, 1], [1.0, 0.5])))
    other = OpenHazard(mover_id=5, target_id=2, ttc_s=2.0, ttc_early_s=1.8)
    rollouts = make_rollouts([1, 1], [0.5, 1.0], 1, is_safe=[serves, True])
    decision = decider.step(situation(1, hazard=other, rollouts=rollouts))
    assert (decision.action, decision.mover_id) == (action, 5)
    assert decision.index == (0 if serves else 1)


@given(
    index=st.integers(-3, 12),
    snapshot=st.integers(-1, 3),
    kind=st.sampled_from(["move", "no_action", "failure"]),
    is_safe=st.lists(st.booleans(), min_size=1, max_size=8),
    mode=st.sampled_from([REFLEX_FIRST, WAIT_UNTIL_DEADLINE]),
)
def test_no_answer_ever_moves_the_arm_to_an_unsafe_point(
    index: int, snapshot: int, kind: str, is_safe: Sequence[bool], mode: str
) -> None:
    decider = Decider(DecideConfig(mode=mode))
    rollouts = make_rollouts([1.0] * len(is_safe), [1.0] * len(is_safe), 0, is_safe)
    decisions: Sequence[Decision] = [
        decider.step(situation(0, rollouts=rollouts)),
        decider.step(situation(1, rollouts=rollouts, proposal=llm(index, snapshot, kind))),
    ]
    for decision in decisions:
        if decision.action in ("intervene", "redirect"):
            assert is_safe[decision.index]


def test_a_refused_move_is_taken_back_and_tried_again() -> None:
    decider = Decider(DecideConfig())
    first = decider.step(situation(0, rollouts=make_rollouts([1, 1], [1.0, 0.5])))
    decider.refuse()
    second = decider.step(situation(1, rollouts=make_rollouts([1, 1], [0.5, 1.0], 1)))
    assert (first.action, first.index) == ("intervene", 0)
    assert (second.action, second.index) == ("intervene", 1)


def test_an_answer_waits_out_a_frame_without_an_alarm() -> None:
    decider = waiting()
    rollouts = make_rollouts([1, 1], [1.0, 0.95])
    decider.step(situation(0, rollouts=rollouts))
    flicker = decider.step(situation(1, hazard=None, rollouts=rollouts, proposal=llm(1)))
    assert (flicker.action, flicker.verdict) == ("watch", "")
    decision = decider.step(situation(2, rollouts=rollouts))
    assert (decision.action, decision.source, decision.index) == ("intervene", "llm", 1)


def test_a_blind_arm_away_from_home_goes_home_when_all_stays_quiet() -> None:
    decider = Decider(DecideConfig(hold_s=1.0))
    decider.step(situation(0, rollouts=make_rollouts([1], [1])))
    decider.blind(0.1)
    actions = [decider.step(situation(seq, hazard=None)).action for seq in range(4, 45)]
    assert actions.count("return") == 1
    assert "intervene" not in actions


def test_a_blind_arm_at_home_stays_there() -> None:
    decider = Decider(DecideConfig(hold_s=1.0))
    decider.blind(0.1)
    actions = {decider.step(situation(seq, hazard=None)).action for seq in range(4, 45)}
    assert actions == {"none"}


def test_an_arm_stopped_on_its_way_home_sets_out_again() -> None:
    decider = Decider(DecideConfig(hold_s=0.5))
    decider.step(situation(0, rollouts=make_rollouts([1], [1])))
    first = [decider.step(situation(seq, hazard=None)).action for seq in range(1, 20)]
    decider.blind(20 * PERIOD_S)
    second = [decider.step(situation(seq, hazard=None)).action for seq in range(21, 60)]
    assert (first.count("return"), second.count("return")) == (1, 1)
