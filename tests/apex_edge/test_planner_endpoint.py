import logging
import pickle

import pytest

from apex_edge.errors import PlannerError
from apex_edge.planners.base import PlannerConfig
from apex_edge.planners.breaker import Breaker
from apex_edge.planners.build import build_planner
from apex_edge.planners.endpoint import Secret, chat_url, endpoint_from, with_environment
from apex_edge.planners.llm import LlmPlanner
from apex_edge.planners.none import NoPlanner

CANARY = "sk-canary-3f9a1c"
LOCAL = "http://127.0.0.1:9/v1"


def build(config=None, env=None):
    return build_planner(config or PlannerConfig(), env or {}, lambda: 0.0, 1)


def key_file(tmp_path, mode=0o600, text=CANARY + "\n"):
    path = tmp_path / "key"
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return str(path)


def test_without_an_endpoint_no_planner_is_built_and_it_is_said_once(caplog):
    with caplog.at_level(logging.INFO):
        planner = build()
    assert isinstance(planner, NoPlanner)
    said = [r for r in caplog.records if "APEX_LLM_BASE_URL" in r.getMessage()]
    assert len(said) == 1


def test_the_environment_gives_the_endpoint_and_the_model():
    config = PlannerConfig(base_url="https://elsewhere.example/v1", model="a")
    env = {"APEX_LLM_BASE_URL": LOCAL, "APEX_LLM_MODEL": "b", "APEX_LLM_API_KEY": CANARY}
    endpoint = endpoint_from(config, env)
    assert (endpoint.url, endpoint.model) == (LOCAL + "/chat/completions", "b")
    assert endpoint.key.reveal() == CANARY
    planner = build(env=env)
    assert isinstance(planner, LlmPlanner)
    planner.close()


def test_an_empty_variable_overrides_nothing():
    config = PlannerConfig(base_url=LOCAL, model="a")
    assert with_environment(config, {"APEX_LLM_BASE_URL": " ", "APEX_LLM_MODEL": ""}) == config


def test_type_none_is_obeyed_even_with_an_endpoint_in_the_environment():
    assert isinstance(build(PlannerConfig(type="none"), {"APEX_LLM_BASE_URL": LOCAL}), NoPlanner)


@pytest.mark.parametrize(
    "url",
    [
        "https://api.example.com/v1",
        "https://api.example.com/v1/",
        "https://api.example.com/v1/chat/completions",
    ],
)
def test_the_address_is_completed_once(url):
    assert chat_url(url) == "https://api.example.com/v1/chat/completions"


@pytest.mark.parametrize("host", ["localhost", "127.0.0.1", "127.8.9.1", "[::1]"])
def test_plain_http_is_allowed_to_this_machine(host):
    assert chat_url(f"http://{host}:8080/v1").startswith(f"http://{host}:8080/")


@pytest.mark.parametrize(
    "url",
    [
        "http://api.example.com/v1",
        "http://192.168.1.20:8080/v1",
        "http://localhost.evil.example/v1",
        "http://127.0.0.1.evil.example/v1",
        "http://127.0.0.1@evil.example/v1",
        f"https://user:{CANARY}@api.example.com/v1",
        f"https://api.example.com/v1?key={CANARY}",
        "https://api.example.com/v1#a",
        "https://api.example.com/a b",
        "https://api.example.com:port/v1",
        "https://[::1/v1",
        "ftp://api.example.com",
        "api.example.com/v1",
        "",
    ],
)
def test_an_address_that_is_unsafe_or_no_address_is_refused(url):
    with pytest.raises(PlannerError) as caught:
        chat_url(url)
    assert CANARY not in str(caught.value)


def test_a_key_comes_from_the_variable_before_the_file(tmp_path):
    config = PlannerConfig(
        base_url=LOCAL, api_key_env="MY_KEY", api_key_file=key_file(tmp_path, text="from-file")
    )
    env = {"APEX_LLM_API_KEY": "a", "APEX_LLM_API_KEY_FILE": key_file(tmp_path), "MY_KEY": "c"}
    assert endpoint_from(config, env).key.reveal() == "a"
    del env["APEX_LLM_API_KEY"]
    assert endpoint_from(config, env).key.reveal() == CANARY
    del env["APEX_LLM_API_KEY_FILE"]
    assert endpoint_from(config, env).key.reveal() == "c"
    with pytest.raises(PlannerError, match="MY_KEY"):
        endpoint_from(config, {})


def test_without_any_key_none_is_sent():
    assert endpoint_from(PlannerConfig(base_url=LOCAL), {}).key is None


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o644])
def test_a_key_file_that_others_can_read_is_refused(tmp_path, mode):
    path = key_file(tmp_path, mode)
    with pytest.raises(PlannerError, match="chmod 600") as caught:
        endpoint_from(PlannerConfig(base_url=LOCAL), {"APEX_LLM_API_KEY_FILE": path})
    assert path in str(caught.value)
    assert CANARY not in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "  \n", "two words", CANARY + "\nmore", "schlüssel", "k" * 5000]
)
def test_a_key_file_without_a_usable_key_is_refused_unquoted(tmp_path, text):
    path = key_file(tmp_path, text=text)
    with pytest.raises(PlannerError) as caught:
        endpoint_from(PlannerConfig(base_url=LOCAL), {"APEX_LLM_API_KEY_FILE": path})
    assert CANARY not in str(caught.value)


def test_a_missing_key_file_or_authority_is_named(tmp_path):
    for config in (
        PlannerConfig(base_url=LOCAL, api_key_file=str(tmp_path / "absent")),
        PlannerConfig(base_url=LOCAL, ca_file=str(tmp_path / "absent")),
        PlannerConfig(base_url=LOCAL, api_key_file=str(tmp_path)),
    ):
        with pytest.raises(PlannerError, match=str(tmp_path)):
            endpoint_from(config, {})


def test_a_secret_shows_itself_in_no_form():
    secret = Secret(CANARY)
    endpoint = endpoint_from(PlannerConfig(base_url=LOCAL), {"APEX_LLM_API_KEY": CANARY})
    for text in (repr(secret), str(secret), f"{secret}", repr(endpoint), str([secret])):
        assert CANARY not in text
    with pytest.raises(TypeError):
        pickle.dumps(secret)


def test_the_breaker_opens_after_three_failures_in_a_row():
    breaker = Breaker()
    for _ in range(2):
        breaker.fail(0.0)
    breaker.succeed()
    for _ in range(2):
        breaker.fail(0.0)
    assert breaker.allows(0.0)
    breaker.fail(0.0)
    assert not breaker.allows(9.9)


def test_the_open_breaker_lets_one_probe_through_after_ten_seconds():
    breaker = Breaker()
    for _ in range(3):
        breaker.fail(0.0)
    assert [breaker.allows(10.0), breaker.allows(10.0)] == [True, False]
    breaker.fail(11.0)
    assert not breaker.allows(20.9)
    assert breaker.allows(21.0)
    breaker.succeed()
    assert breaker.allows(21.0) and breaker.allows(21.0)


def test_a_cancelled_probe_leaves_room_for_the_next():
    breaker = Breaker()
    for _ in range(3):
        breaker.fail(0.0)
    assert breaker.allows(10.0)
    breaker.forget()
    assert breaker.allows(10.0)


def test_a_locked_breaker_never_opens_again():
    breaker = Breaker()
    breaker.lock()
    breaker.succeed()
    assert not breaker.allows(1e9)
