import json
import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planner_scene import BEST, TIP_M, request, rollouts

from apex_edge import plugins
from apex_edge.planners.base import FAILURES, Planner, PlannerConfig
from apex_edge.planners.client import Reply
from apex_edge.planners.fake_server import (
    ANSWERS,
    FakeReply,
    FakeServer,
    answering,
    completion,
    failing,
    read_choices,
    sequence,
)
from apex_edge.planners.llm import LlmPlanner, interpret, order_seed
from apex_edge.planners.prompts import render

PROFILES = ("compact", "explicit", "implicit")


@pytest.fixture
def plan():
    """Return a function that starts a server and a planner on it; both end with the test."""
    opened = []

    def start(behaviour, clock=lambda: 1.0, seed=3, **config):
        server = FakeServer(behaviour)
        env = {"APEX_LLM_BASE_URL": server.url}
        planner = LlmPlanner(PlannerConfig(**config), env, clock, seed)
        opened.extend([planner, server])
        return planner, server

    yield start
    for thing in opened:
        thing.close()


def ask(planner, asked):
    planner.ask(asked)
    return planner.wait(10.0)


@pytest.mark.parametrize("name", ["none", "llm"])
def test_each_planner_is_published_with_the_common_constructor(name):
    kind = plugins.load("planners", name)
    config = PlannerConfig(base_url="http://127.0.0.1:9/v1")
    planner = kind(config, {}, lambda: 0.0, 1)
    assert isinstance(planner, Planner)
    assert not planner.is_pending
    assert planner.poll(0.0) is None
    assert planner.wait(0.0) is None
    planner.cancel()
    planner.close()


@pytest.mark.parametrize("profile", PROFILES)
def test_the_candidate_the_model_names_is_proposed(plan, profile):
    planner, server = plan(answering("first"), profile=profile)
    proposal = ask(planner, request())
    shown = render(profile, request(), 5, order_seed(3, 7)).indices
    assert (proposal.source, proposal.kind, proposal.snapshot) == ("llm", "move", 7)
    assert proposal.index == shown[0]
    assert proposal.latency_s > 0.0
    assert f"order seed {order_seed(3, 7)}" in proposal.detail


@pytest.mark.parametrize("profile", PROFILES)
def test_the_worst_candidate_can_be_asked_of_the_fake_server(plan, profile):
    planner, _ = plan(answering("worst"), profile=profile)
    worst = min(BEST[:5], key=lambda i: rollouts().min_distance_m[i])
    assert ask(planner, request()).index == worst


@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize(
    "kind, expected",
    [
        ("no_action", ("no_action", None)),
        ("out_of_set", ("failure", "out_of_set")),
        ("nan", ("failure", "not_finite")),
        ("prose", ("failure", "bad_json")),
    ],
)
def test_an_answer_that_names_no_candidate_moves_nothing(plan, profile, kind, expected):
    planner, _ = plan(answering(kind), profile=profile)
    proposal = ask(planner, request())
    assert (proposal.kind, proposal.index) == (expected[0], -1)
    if expected[1]:
        assert proposal.detail == expected[1]


@pytest.mark.parametrize("offset_m, is_taken", [(0.0, True), (0.0049, True), (0.0051, False)])
def test_a_point_is_snapped_to_a_candidate_within_half_a_centimetre(plan, offset_m, is_taken):
    x, y = TIP_M[4] + (offset_m, 0.0)
    planner, _ = plan(sequence(completion(json.dumps({"x": x, "y": y}))), profile="explicit")
    proposal = ask(planner, request())
    found = (proposal.kind, proposal.index)
    assert found == (("move", 4) if is_taken else ("failure", -1))


def test_one_sentinel_alone_is_a_failure(plan):
    planner, _ = plan(sequence(completion('{"x": -99, "y": 0.01}')), profile="implicit")
    assert ask(planner, request()).detail == "schema"


def test_the_shown_order_differs_between_snapshots_and_repeats_with_the_seed(plan):
    planner, server = plan(answering("first"))
    for snapshot in (7, 8, 7):
        ask(planner, request(snapshot=snapshot))
    first, second, again = (r.prompt for r in server.requests)
    assert first != second
    assert first == again


def test_asking_and_polling_do_not_wait_for_the_answer(plan):
    now_s = [1.0]
    planner, _ = plan(failing("hang"), lambda: now_s[0], timeout_s=60.0)
    planner.ask(request(deadline_s=61.0))
    assert planner.poll(1.0) is None  # reached long before the 60 s are over
    assert planner.is_pending
    planner.cancel()
    assert not planner.is_pending


def test_polling_returns_the_answer_once(plan):
    planner, _ = plan(answering("first"))
    planner.ask(request())
    found = []
    while not found:
        found = [p for p in [planner.poll(1.0)] if p is not None]
        time.sleep(0.002)
    assert found[0].kind == "move"
    assert planner.poll(1.0) is None
    assert not planner.is_pending


def test_past_the_deadline_of_the_scene_even_a_good_answer_is_late(plan):
    planner, server = plan(answering("first"))
    planner.ask(request(deadline_s=5.0))
    while not server.requests:
        time.sleep(0.002)
    time.sleep(0.2)
    proposal = planner.poll(5.0)
    assert (proposal.kind, proposal.detail, proposal.index) == ("failure", "timeout", -1)


def test_a_request_that_is_already_late_is_not_sent(plan):
    planner, server = plan(answering("first"))
    planner.ask(request(deadline_s=0.5))
    assert planner.poll(1.0).detail == "timeout"
    assert server.requests == []


@pytest.mark.parametrize("deadline_s", [float("nan"), float("-inf")])
def test_a_deadline_that_is_no_time_is_late(plan, deadline_s):
    planner, server = plan(answering("first"))
    planner.ask(request(deadline_s=deadline_s))
    assert planner.poll(1.0).detail == "timeout"
    assert server.requests == []


def test_waiting_ends_with_the_settings_own_limit(plan):
    planner, _ = plan(failing("hang"), timeout_s=0.1)
    planner.ask(request(deadline_s=1e6))
    assert planner.wait(1e6).detail == "timeout"


def test_waiting_less_than_the_answer_takes_leaves_it_pending(plan):
    planner, _ = plan(answering("first", latency_s=0.3))
    planner.ask(request())
    assert planner.wait(0.01) is None
    assert planner.is_pending
    assert planner.wait(10.0).kind == "move"


def test_a_newer_hazard_cancels_the_older_question(plan):
    planner, server = plan(lambda r: FakeReply(fault="hang") if r.number == 0 else completion("1"))
    planner.ask(request(snapshot=7))
    while not server.requests:
        time.sleep(0.002)
    assert ask(planner, request(snapshot=8)).snapshot == 8
    assert planner.poll(1.0) is None


def test_without_a_safe_candidate_nobody_is_asked(plan):
    planner, server = plan(answering("first"))
    assert ask(planner, request(rollouts=rollouts(best=()))).detail == "no_candidates"
    assert server.requests == []


def test_the_hourly_cap_stops_asking_until_the_hour_is_over(plan):
    now_s = [1.0]
    planner, server = plan(answering("first"), lambda: now_s[0], max_calls_per_hour=2)
    kinds = [ask(planner, request()).kind for _ in range(3)]
    assert kinds == ["move", "move", "failure"]
    now_s[0] = 3601.0
    assert ask(planner, request(deadline_s=3605.0)).kind == "move"
    assert len(server.requests) == 3


def test_calls_tokens_and_cost_are_counted(plan):
    prices = {"price_prompt_per_mtok": 10.0, "price_completion_per_mtok": 100.0}
    planner, _ = plan(sequence(completion("1"), completion("no")), **prices)
    ask(planner, request())
    ask(planner, request())
    used = planner.usage
    assert (used.n_calls, used.n_failures) == (2, 1)
    assert (used.n_prompt_tokens, used.n_completion_tokens) == (200, 16)
    assert used.cost == pytest.approx(200 * 10e-6 + 16 * 100e-6)


def test_a_closed_planner_answers_that_it_is_closed(plan):
    planner, server = plan(answering("first"))
    planner.close()
    planner.ask(request())
    assert planner.poll(1.0).detail == "closed"
    assert server.requests == []


TEXTS = st.one_of(
    st.text(),
    st.builds(lambda i: json.dumps({"index": i}), st.integers(-3, 9)),
    st.builds(lambda x, y: json.dumps({"x": x, "y": y}), st.floats(), st.floats()),
    st.builds(
        lambda i, dx: json.dumps({"x": TIP_M[i][0] + dx, "y": TIP_M[i][1]}),
        st.integers(0, 6),
        st.floats(-0.01, 0.01),
    ),
)


@settings(max_examples=300, deadline=None)
@given(text=TEXTS, profile=st.sampled_from(PROFILES), seed=st.integers(0, 50))
def test_no_text_makes_a_proposal_outside_the_candidates(text, profile, seed):
    asked = request()
    prompt = render(profile, asked, 5, seed)
    proposal = interpret(asked, prompt, Reply(text=text))
    if proposal.kind == "move":
        assert 0 <= proposal.index < len(TIP_M)
        if profile == "compact":
            assert proposal.index in BEST[:5]
    else:
        assert proposal.index == -1
        assert proposal.kind == "no_action" or proposal.detail in FAILURES


@pytest.mark.parametrize("profile", PROFILES)
def test_every_canned_answer_reads_the_prompt_it_gets(plan, profile):
    text = render(profile, request(), 5, 1).text
    assert len(read_choices(text)) == 5
    for kind in ANSWERS:
        planner, _ = plan(answering(kind), profile=profile, timeout_s=0.3)
        proposal = ask(planner, request())
        expected = "move" if kind in ("first", "random", "worst") else "failure"
        assert proposal.kind == ("no_action" if kind == "no_action" else expected)


def test_the_prompt_has_no_number_that_json_or_a_model_cannot_read():
    wild = rollouts()
    wild = replace(wild, arrival_s=np.full_like(wild.arrival_s, 1e308), t_free_collision_s=np.inf)
    for profile in PROFILES:
        text = render(profile, request(rollouts=wild), 5, 1).text
        assert "1e+308" not in text and "Infinity" not in text
        assert len(read_choices(text)) == 5
