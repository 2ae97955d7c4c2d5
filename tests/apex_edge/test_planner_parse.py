import json
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apex_edge.planners.base import FAILURES
from apex_edge.planners.parse import (
    parse_completion,
    parse_index,
    parse_point,
    retry_after_s,
    status_kind,
    strip_wrapping,
)


@pytest.mark.parametrize(
    "text",
    [
        '{"index": 3}',
        ' {"index": 3}   \n\n',
        '```json\n{"index": 3}\n```',
        '```\n{"index": 3}',
        '<think>maybe {"index": 1}</think>{"index": 3}',
        'maybe {"index": 1}</think>\n{"index": 3}',
        '<THINK>a<think>b</think>c</THINK>{"index": "3"}',
        'I choose {"index": 1}. No: {"index": 3}. Done {really}.',
        '{"why": "a } brace and a \\" quote", "index": 3}',
        '{"index": 3.0}',
        "3",
        '"3".',
    ],
)
def test_an_index_is_found_in_any_wrapping(text):
    answer = parse_index(text, 5)
    assert (answer.kind, answer.index) == ("index", 3)


@pytest.mark.parametrize(
    "text, failure",
    [
        ("", "bad_json"),
        ("the third one", "bad_json"),
        ("I pick 3 because it is near", "bad_json"),
        ('<think>{"index": 3}', "bad_json"),
        ('{"index": 3', "bad_json"),
        ('{"index": 3, "index": 2}', "bad_json"),
        ('{"index": 3, "a": {"b": 1, "b": 2}}', "bad_json"),
        ('{"index": 1} wait {"index": NaN}', "not_finite"),
        ('{"index": Infinity}', "not_finite"),
        ('{"index": 1e999}', "not_finite"),
        ('{"index": ' + "9" * 5000 + "}", "not_finite"),
        ('{"index": true}', "schema"),
        ('{"index": null}', "schema"),
        ('{"index": [3]}', "schema"),
        ('{"index": 2.5}', "schema"),
        ('{"index": "three"}', "schema"),
        ('{"index": "٣"}', "schema"),
        ('{"answer": {"index": 3}}', "schema"),
        ('{"choice": 3}', "schema"),
        ('{"index": 6}', "out_of_set"),
        ('{"index": -1}', "out_of_set"),
        ('{"index": -99}', "out_of_set"),
        ("6", "out_of_set"),
        ("{" * 60000, "bad_json"),
        ('{"a":' * 12000 + "1" + "}" * 12000, "bad_json"),
    ],
)
def test_what_is_not_exactly_one_index_is_a_typed_failure(text, failure):
    answer = parse_index(text, 5)
    assert (answer.kind, answer.failure) == ("failure", failure)


def test_zero_means_no_action():
    assert parse_index('{"index": 0}', 5).kind == "no_action"
    assert parse_index("0", 5).kind == "no_action"


def test_a_point_is_read_as_the_model_wrote_it():
    answer = parse_point('```json\n{"x": "0.12", "y": -3e-2}```')
    assert (answer.kind, answer.x_m, answer.y_m) == ("point", 0.12, -0.03)


def test_both_sentinels_mean_no_action_and_one_alone_is_a_failure():
    assert parse_point('{"x": -99, "y": -99.0}').kind == "no_action"
    for text in ('{"x": -99, "y": 0.1}', '{"x": 0.1, "y": "-99"}'):
        assert parse_point(text).failure == "schema"


@pytest.mark.parametrize(
    "text, failure",
    [
        ('{"x": 0.1}', "schema"),
        ('{"x": 0.1, "y": false}', "schema"),
        ('{"x": NaN, "y": 0.1}', "not_finite"),
        ("(0.1, 0.2)", "bad_json"),
        ("3", "bad_json"),
    ],
)
def test_what_is_not_a_point_is_a_typed_failure(text, failure):
    assert parse_point(text).failure == failure


def test_many_unclosed_thoughts_are_taken_off_in_linear_time():
    # a backtracking pattern would need billions of steps for this
    assert strip_wrapping("<think>" * 9000 + "</think>" * 8999) == ""


def body(message=None, **more):
    choice = {"message": message if message is not None else {"content": "ok"}}
    choice.update(more)
    return json.dumps({"choices": [choice]}).encode()


def test_the_message_is_read_in_each_form_that_servers_use():
    parts = [{"type": "text", "text": "o"}, {"type": "image"}, {"type": "text", "text": "k"}]
    tool = {"content": None, "tool_calls": [{"function": {"name": "f", "arguments": "ok"}}]}
    for message in ({"content": "ok", "refusal": None}, {"content": parts}, tool):
        found = parse_completion(body(message, finish_reason="stop"))
        assert (found.text, found.failure) == ("ok", "")


def test_tokens_are_counted_and_nonsense_counts_as_none():
    usage = {"prompt_tokens": 12, "completion_tokens": True}
    data = json.dumps({"choices": [{"message": {"content": "ok"}}], "usage": usage}).encode()
    found = parse_completion(data)
    assert (found.n_prompt_tokens, found.n_completion_tokens) == (12, 0)


@pytest.mark.parametrize(
    "data, failure",
    [
        (body(finish_reason="length"), "truncated"),
        (body(finish_reason="content_filter"), "content_filter"),
        (body({"content": "ok", "refusal": "I will not"}), "refusal"),
        (body({"content": [{"type": "refusal", "refusal": "no"}]}), "refusal"),
        (body({"content": None}), "schema"),
        (body({"content": "  "}), "schema"),
        (body("text"), "schema"),
        (b'{"choices": []}', "schema"),
        (b'{"choices": {"0": 1}}', "schema"),
        (b"[]", "schema"),
        (b"", "bad_json"),
        (b"\xff\xfe", "bad_json"),
        (b"<html>", "bad_json"),
        (b'{"choices": NaN}', "not_finite"),
        (b'{"error": {"code": 402, "message": "pay"}}', "auth"),
        (b'{"error": {"code": 429}}', "rate_limited"),
        (b'{"error": {"code": "overloaded"}}', "http_5xx"),
        (b'{"error": "overloaded"}', "http_5xx"),
        (b'{"error": {"code": 200}}', "http_5xx"),
        (b"[" * 60000, "bad_json"),
    ],
)
def test_a_body_without_a_whole_answer_is_a_typed_failure(data, failure):
    found = parse_completion(data)
    assert (found.text, found.failure) == ("", failure)


def test_every_error_status_has_a_kind():
    assert status_kind(200) == ""
    for status in list(range(300, 600)) + [0, 999]:
        assert status_kind(status) in FAILURES


def test_retry_after_is_read_in_its_three_forms():
    assert retry_after_s({"retry-after": "3"}, 0.0) == 3.0
    assert retry_after_s({"retry-after": "3", "retry-after-ms": "250"}, 0.0) == 0.25
    date = "Thu, 01 Jan 1970 00:01:00 GMT"
    assert retry_after_s({"retry-after": date}, 50.0) == 10.0
    for text in ("", "soon", "-1", "nan", "1e9", "٣"):
        assert retry_after_s({"retry-after": text}, 0.0) is None


PIECES = [
    '{"index": 3}', '{"index": 99}', '{"x": 0.1, "y": 0.2}', '{"x": -99, "y": -99}', "<think>",
    "</think>", "```json", "```", "{", "}", '"', "\\", "NaN", "true", "index", '"index":', "3",
    "-99", "1e400", "[", "]", ",", "\x00", "\ud800", " ",
]  # fmt: skip
TEXTS = st.one_of(st.text(), st.lists(st.sampled_from(PIECES), max_size=12).map("".join))


@settings(max_examples=300, deadline=None)
@given(text=TEXTS, n_choices=st.integers(0, 20))
def test_no_text_makes_the_parser_raise_or_name_what_was_not_shown(text, n_choices):
    answer = parse_index(text, n_choices)
    if answer.kind == "index":
        assert 1 <= answer.index <= n_choices
    else:
        assert answer.kind == "no_action" or answer.failure in FAILURES
    point = parse_point(text)
    if point.kind == "point":
        assert math.isfinite(point.x_m) and math.isfinite(point.y_m)
        assert -99.0 not in (point.x_m, point.y_m)
    else:
        assert point.kind == "no_action" or point.failure in FAILURES


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                ["choices", "message", "content", "error", "code", "text", "tool_calls", "function"]
                + ["arguments", "usage", "prompt_tokens", "refusal", "finish_reason", "type"]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=20,
)


@settings(max_examples=300, deadline=None)
@given(data=st.one_of(st.binary(max_size=200), JSON.map(lambda value: json.dumps(value).encode())))
def test_no_body_makes_the_reader_raise(data):
    found = parse_completion(data)
    assert bool(found.text) != bool(found.failure)
    assert found.failure == "" or found.failure in FAILURES


@settings(max_examples=200, deadline=None)
@given(
    message=JSON, finish=st.one_of(st.none(), st.sampled_from(["stop", "length"]), st.integers())
)
def test_no_message_makes_the_reader_raise(message, finish):
    data = json.dumps({"choices": [{"message": message, "finish_reason": finish}]}).encode()
    found = parse_completion(data)
    assert isinstance(found.text, str)
    assert bool(found.text) != bool(found.failure)
