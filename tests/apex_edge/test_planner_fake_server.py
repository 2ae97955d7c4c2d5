import os
import signal
import socket
import subprocess
import sys
import time

import pytest
import requests

from apex_edge.planners.fake_server import FAULTS, FakeServer, answering, completion, failing


def test_a_user_can_start_it_from_the_command_line_and_stop_it():
    process = subprocess.Popen(
        [sys.executable, "-m", "apex_edge.planners.fake_server", "--latency", "0"]
        + ["--answer", "no_action"],
        stdout=subprocess.PIPE,
        universal_newlines=True,
    )
    try:
        url = process.stdout.readline().strip()
        body = {"messages": [{"role": "user", "content": '... {"index": n} ...'}]}
        answer = requests.post(url + "/chat/completions", json=body, timeout=10).json()
        assert answer["choices"][0]["message"]["content"] == '{"index": 0}'
        os.kill(process.pid, signal.SIGINT)
        assert process.wait(10) == 0
    finally:
        process.kill()
        process.stdout.close()
        process.wait()


def test_a_wrong_name_lists_what_there_is():
    with pytest.raises(ValueError, match="hang"):
        failing("hangs")
    with pytest.raises(ValueError, match="worst"):
        answering("best")


def test_each_request_is_logged_without_its_key():
    with FakeServer(lambda request: completion(request.prompt)) as server:
        headers = {"Authorization": "Bearer sk-secret"}
        body = {"messages": [{"content": "hello"}]}
        answer = requests.post(server.url + "/x", json=body, headers=headers, timeout=10).json()
    assert answer["choices"][0]["message"]["content"] == "hello"
    assert [(r.number, r.path, r.prompt) for r in server.requests] == [(0, "/v1/x", "hello")]
    assert server.requests[0].key.reveal() == "sk-secret"
    assert "sk-secret" not in repr(server.requests)


@pytest.mark.parametrize(
    "sent", [b"\x16\x03\x01", b"GET\r\n\r\n", b"POST / HTTP/1.1\r\nContent-Length: x\r\n\r\n"]
)
def test_what_is_no_request_is_hung_up_on(sent):
    with FakeServer(answering("first")) as server:
        port = int(server.url.split(":")[2].split("/")[0])
        with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
            client.sendall(sent)
            assert client.recv(100) == b""
    assert server.requests == []


def test_a_body_that_is_no_json_is_answered_all_the_same():
    with FakeServer(answering("prose")) as server:
        answer = requests.post(server.url, data=b"\xff{", timeout=10)
    assert answer.status_code == 200
    assert (server.requests[0].body, server.requests[0].prompt) == (None, "")


@pytest.mark.parametrize("fault", FAULTS)
def test_closing_ends_a_server_in_the_middle_of_any_fault(fault):
    with FakeServer(failing(fault)) as server:
        port = int(server.url.split(":")[2].split("/")[0])
        client = socket.create_connection(("127.0.0.1", port), timeout=10)
        client.sendall(b"POST / HTTP/1.1\r\nContent-Length: 0\r\n\r\n")
        while not server.requests:
            time.sleep(0.002)
    client.close()
