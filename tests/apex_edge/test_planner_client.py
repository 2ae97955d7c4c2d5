import gc
import logging
import socket
import time

import pytest
from planner_scene import QUESTION, wait_for, workers

from apex_edge.planners.base import FAILURES, PlannerConfig
from apex_edge.planners.client import ChatClient
from apex_edge.planners.endpoint import Endpoint, Secret, chat_url
from apex_edge.planners.fake_server import (
    FAULTS,
    FakeReply,
    FakeServer,
    completion,
    failing,
    sequence,
)

CANARY = "sk-canary-77d0e2"
OK = completion('{"index": 2}')
BUDGET_S = 0.3
# Far above what was measured (0.03 s under load) and far below what an unbounded wait would take.
SLACK_S = 2.0

KIND = {
    "hang": "timeout",
    "drip": "timeout",
    "drip_head": "timeout",
    "reset": "connect",
    "close": "connect",
    "reset_body": "truncated",
    "truncated_body": "truncated",
    "truncated_json": "bad_json",
    "garbage": "bad_http",
    "html": "bad_json",
    "bad_chunk": "truncated",
    "endless": "too_large",
    "huge": "too_large",
}


@pytest.fixture
def connect():
    """Return a function that starts a server and a client of it; both end with the test."""
    opened = []

    def start(behaviour, wall_clock=time.monotonic, **config):
        server = FakeServer(behaviour)
        endpoint = Endpoint(chat_url(server.url), "fake", Secret(CANARY), "")
        client = ChatClient(endpoint, PlannerConfig(**config), 1, wall_clock)
        opened.extend([client, server])
        return client, server

    yield start
    for thing in opened:
        thing.close()


def test_every_fault_of_the_server_is_tried():
    assert set(KIND) == set(FAULTS)


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_becomes_one_typed_failure_before_the_deadline(connect, fault):
    client, _ = connect(failing(fault))
    began_s = time.monotonic()
    reply = client.ask(QUESTION, BUDGET_S)
    assert time.monotonic() - began_s < BUDGET_S + SLACK_S
    assert (reply.text, reply.failure) == ("", KIND[fault])
    assert reply.failure in FAILURES
    wait_for(lambda: not workers())


@pytest.mark.parametrize("fault", ["hang", "drip", "drip_head"])
def test_a_call_nobody_polls_ends_at_its_deadline_by_itself(connect, fault):
    client, _ = connect(failing(fault))
    call = client.start(QUESTION, 0.1)
    wait_for(lambda: call.result() is not None)
    assert call.result().failure == "timeout"
    wait_for(lambda: not workers())


def test_starting_does_not_wait_for_the_server(connect):
    client, _ = connect(failing("hang"))
    call = client.start(QUESTION, 60.0)
    assert call.result() is None  # reached long before the 60 s are over
    call.cancel()
    wait_for(lambda: not workers())


def test_a_cancelled_call_lets_go_of_its_thread_and_says_nothing(connect):
    client, server = connect(failing("drip"))
    call = client.start(QUESTION, 60.0)
    wait_for(lambda: server.requests)
    call.cancel()
    wait_for(lambda: not workers())
    assert call.result() is None


def test_an_answer_after_the_deadline_is_dropped(connect):
    client, _ = connect(lambda request: completion('{"index": 2}', latency_s=0.5))
    call = client.start(QUESTION, 0.1)
    assert call.wait(10.0).failure == "timeout"
    time.sleep(0.6)
    assert (call.result().text, call.result().failure) == ("", "timeout")


def test_without_time_left_nothing_is_sent(connect):
    client, server = connect(sequence(OK))
    for budget_s in (0.0, -1.0, float("nan")):
        assert client.ask(QUESTION, budget_s).failure == "timeout"
    assert server.requests == []


def test_the_connection_is_kept_for_the_next_call(connect):
    client, server = connect(sequence(OK))
    assert [client.ask(QUESTION, 5.0).text for _ in range(5)] == ['{"index": 2}'] * 5
    assert server.n_connections == 1


def test_a_kept_connection_that_the_server_closed_is_replaced_within_the_call(connect):
    client, server = connect(sequence(OK, FakeReply(fault="close"), OK))
    assert client.ask(QUESTION, 5.0).failure == ""
    reply = client.ask(QUESTION, 5.0)
    assert (reply.failure, reply.n_attempts) == ("", 2)


@pytest.mark.parametrize("status", [408, 409, 429, 500, 502, 503, 504, 529])
def test_a_passing_failure_is_asked_about_once_more(connect, status):
    client, server = connect(sequence(FakeReply(status=status), OK))
    assert client.ask(QUESTION, 5.0).text == '{"index": 2}'
    client, server = connect(sequence(FakeReply(status=status)))
    assert client.ask(QUESTION, 5.0).failure in ("http_4xx", "http_5xx", "rate_limited")
    assert len(server.requests) == 2


@pytest.mark.parametrize(
    "status, kind",
    [(401, "auth"), (402, "auth"), (403, "auth"), (404, "http_4xx"), (422, "http_4xx")],
)
def test_a_lasting_refusal_is_not_asked_about_again(connect, status, kind):
    client, server = connect(sequence(FakeReply(status=status), OK))
    assert client.ask(QUESTION, 5.0).failure == kind
    assert len(server.requests) == 1


def test_retry_after_is_honoured_when_it_fits_and_ends_the_call_when_not(connect):
    soon = FakeReply(status=429, headers={"Retry-After": "0.2"})
    client, _ = connect(sequence(soon, OK))
    reply = client.ask(QUESTION, 5.0)
    assert (reply.failure, reply.latency_s >= 0.2) == ("", True)
    late = FakeReply(status=429, headers={"Retry-After": "30"})
    client, server = connect(sequence(late, OK))
    reply = client.ask(QUESTION, 5.0)
    assert (reply.failure, len(server.requests)) == ("rate_limited", 1)
    assert reply.latency_s < 5.0


def test_a_server_that_says_no_retry_is_obeyed(connect):
    client, server = connect(
        sequence(FakeReply(status=500, headers={"x-should-retry": "false"}), OK)
    )
    assert client.ask(QUESTION, 5.0).failure == "http_5xx"
    assert len(server.requests) == 1


def test_a_retry_that_would_fail_as_late_again_is_not_made(connect):
    # a real server was seen to send 500 after it had generated the answer
    client, server = connect(sequence(FakeReply(status=500, latency_s=0.6), OK))
    assert client.ask(QUESTION, 1.0).failure == "http_5xx"
    assert len(server.requests) == 1


def test_a_redirect_is_not_followed(connect):
    elsewhere, other = connect(sequence(OK))
    moved = FakeReply(status=307, headers={"Location": other.url + "/chat/completions"})
    client, _ = connect(sequence(moved))
    assert client.ask(QUESTION, 5.0).failure == "http_3xx"
    assert other.requests == []


def test_a_proxy_in_the_environment_is_not_used(connect, monkeypatch):
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.setenv("no_proxy", "")
    client, server = connect(sequence(OK))
    assert client.ask(QUESTION, 5.0).failure == ""
    assert len(server.requests) == 1


def test_a_cookie_is_not_sent_back(connect):
    client, server = connect(lambda request: FakeReply(OK.body, headers={"Set-Cookie": "a=b"}))
    client.ask(QUESTION, 5.0)
    client.ask(QUESTION, 5.0)
    assert "cookie" not in server.requests[1].headers


def speaks(refuses):
    """Return a behaviour that refuses what ``refuses`` names in a request body with a 400."""

    def behave(request):
        message = refuses(request.body)
        return FakeReply(message.encode(), status=400) if message else OK

    return behave


def format_of(request):
    return request.body.get("response_format", {}).get("type", "plain")


def test_the_schema_is_given_up_step_by_step_and_that_is_remembered(connect):
    client, server = connect(speaks(lambda body: "unknown" if "response_format" in body else ""))
    assert client.ask(QUESTION, 5.0).failure == ""
    assert client.ask(QUESTION, 5.0).failure == ""
    asked = [format_of(request) for request in server.requests]
    assert asked == ["json_schema", "json_object", "plain", "plain"]


def test_a_newer_model_gets_the_newer_name_of_the_limit_and_no_temperature(connect):
    def refuses(body):
        if "max_tokens" in body:
            return "Unsupported parameter: use 'max_completion_tokens' instead"
        return "Unsupported value: temperature" if "temperature" in body else ""

    client, server = connect(speaks(refuses))
    assert client.ask(QUESTION, 5.0).failure == ""
    assert client.ask(QUESTION, 5.0).failure == ""
    assert len(server.requests) == 4
    body = server.requests[-1].body
    assert body["max_completion_tokens"] == 48
    assert format_of(server.requests[-1]) == "json_schema"


def test_a_refusal_that_no_wording_helps_teaches_nothing(connect):
    client, server = connect(sequence(FakeReply(b"bad", status=400)))
    assert client.ask(QUESTION, 5.0).failure == "http_4xx"
    assert client.dialect.rung == 0
    overlong = FakeReply(b'{"error": {"type": "exceed_context_size_error"}}', status=400)
    client, server = connect(sequence(overlong))
    assert client.ask(QUESTION, 5.0).failure == "http_4xx"
    assert len(server.requests) == 1


def test_the_request_holds_what_the_settings_say(connect):
    client, server = connect(sequence(OK), max_tokens=16, temperature=0.5)
    reply = client.ask(QUESTION, 5.0)
    request = server.requests[0]
    assert request.path == "/v1/chat/completions"
    assert request.key.reveal() == CANARY
    assert request.body["messages"] == [{"role": "user", "content": "pick one"}]
    assert (request.body["max_tokens"], request.body["temperature"]) == (16, 0.5)
    assert request.body["response_format"]["json_schema"]["schema"] == QUESTION.schema
    assert (reply.n_prompt_tokens, reply.n_completion_tokens) == (100, 8)


def test_an_endpoint_that_keeps_failing_is_left_alone_for_ten_seconds(connect):
    offset_s = [0.0]
    client, server = connect(
        sequence(*[FakeReply(status=404)] * 3 + [OK]), lambda: time.monotonic() + offset_s[0]
    )
    kinds = [client.ask(QUESTION, 5.0).failure for _ in range(5)]
    assert kinds == ["http_4xx"] * 3 + ["circuit_open"] * 2
    assert len(server.requests) == 3
    offset_s[0] = 11.0
    assert [client.ask(QUESTION, 5.0).failure for _ in range(3)] == [""] * 3


def test_a_refused_key_is_not_tried_again(connect):
    offset_s = [0.0]
    client, server = connect(
        sequence(FakeReply(status=401), OK), lambda: time.monotonic() + offset_s[0]
    )
    assert client.ask(QUESTION, 5.0).failure == "auth"
    offset_s[0] = 1e6
    assert client.ask(QUESTION, 5.0).failure == "circuit_open"
    assert len(server.requests) == 1


def test_an_answer_that_is_only_useless_does_not_open_the_breaker(connect):
    client, _ = connect(sequence(completion("I would rather not say.")))
    assert [client.ask(QUESTION, 5.0).failure for _ in range(5)] == [""] * 5


def test_cancelled_calls_do_not_open_the_breaker(connect):
    client, server = connect(lambda r: OK if r.number >= 4 else FakeReply(fault="hang"))
    for n in range(4):
        call = client.start(QUESTION, 60.0)
        wait_for(lambda n=n: len(server.requests) == n + 1)
        call.cancel()
        wait_for(lambda: not workers())
    assert client.ask(QUESTION, 5.0).failure == ""


def test_nobody_listening_is_a_connect_failure(connect):
    client, server = connect(sequence(OK))
    server.close()
    assert client.ask(QUESTION, 5.0).failure == "connect"


def test_the_key_appears_in_no_log_reply_or_repr(connect, caplog):
    seen = []
    with caplog.at_level(logging.DEBUG):
        for fault in FAULTS + ("", "echo"):
            echo = FakeReply(CANARY.encode(), status=401, headers={"x-echo": CANARY})
            client, server = connect(sequence(echo if fault == "echo" else FakeReply(fault=fault)))
            seen.append(repr(client.ask(QUESTION, 0.1)))
            seen.append(repr([vars(client), server.requests, client.dialect]))
    assert server.requests[0].key.reveal() == CANARY
    assert caplog.records
    seen += [record.getMessage() + str(record.exc_info) for record in caplog.records]
    assert not [text for text in seen if CANARY in text]


def test_sixty_faults_leave_no_thread_and_no_socket(connect):
    def n_sockets():
        gc.collect()
        return sum(
            isinstance(thing, socket.socket) and thing.fileno() >= 0 for thing in gc.get_objects()
        )

    before = n_sockets()
    with FakeServer(
        lambda request: FakeReply(fault=FAULTS[request.number % len(FAULTS)])
    ) as server:
        endpoint = Endpoint(chat_url(server.url), "", None, "")
        for _ in range(20):
            client = ChatClient(endpoint, PlannerConfig(), 1)
            for _ in range(3):
                assert client.ask(QUESTION, 0.05).failure in FAILURES
            client.close()
        wait_for(lambda: not workers())
    wait_for(lambda: n_sockets() <= before)
