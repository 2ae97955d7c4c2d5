import ssl

import pytest
from planner_scene import QUESTION, wait_for, workers

from apex_edge.planners.base import PlannerConfig
from apex_edge.planners.client import ChatClient
from apex_edge.planners.endpoint import Endpoint, Secret, chat_url
from apex_edge.planners.fake_server import FakeReply, FakeServer, completion, sequence

OK = completion('{"index": 2}')

# Made for these tests and used nowhere else; valid from 2020 to 2120.
TEST_KEY = """\
-----BEGIN EC PRIVATE KEY-----
MHcCAQEEIP1dg9wznEh00T1rgBYq36GOr9eE1lhKm0gFjcTKU0MRoAoGCCqGSM49
AwEHoUQDQgAEpMjfREHMUz0NZsr4b+gCpDKsQsvKYCuhbGaHDNTy0gyZ9LrZSx89
xeO6F9Mp+fnc8Asnn3SRh5qkmvWq3107FA==
-----END EC PRIVATE KEY-----
"""
TEST_CERTIFICATE = """\
-----BEGIN CERTIFICATE-----
MIIBfjCCASWgAwIBAgIUBQROMQL2S/xf3LVmkdrEz/bobUswCgYIKoZIzj0EAwIw
FDESMBAGA1UEAwwJMTI3LjAuMC4xMCAXDTIwMDEwMTAwMDAwMFoYDzIxMjAwMTAx
MDAwMDAwWjAUMRIwEAYDVQQDDAkxMjcuMC4wLjEwWTATBgcqhkjOPQIBBggqhkjO
PQMBBwNCAASkyN9EQcxTPQ1myvhv6AKkMqxCy8pgK6FsZocM1PLSDJn0utlLHz3F
47oX0yn5+dzwCyefdJGHmqSa9arfXTsUo1MwUTAdBgNVHQ4EFgQUNTFDalq0vdWF
lIlDgD3+57PPapUwDwYDVR0RBAgwBocEfwAAATAOBgNVHQ8BAf8EBAMCAoQwDwYD
VR0TAQH/BAUwAwEB/zAKBggqhkjOPQQDAgNHADBEAiBdDXnGGMjWebG/FNDgcTSt
C4Wh1S5cl+6VYkvf7m1f2AIgIyodpeY4ZMmkkjF02WV8KyPxxCcUAkyfbqeW3Xia
wGc=
-----END CERTIFICATE-----
"""


@pytest.fixture
def tls(tmp_path):
    """Return the server side of TLS and the file a client may trust it by."""
    (tmp_path / "pair.pem").write_text(TEST_KEY + TEST_CERTIFICATE)
    (tmp_path / "ca.pem").write_text(TEST_CERTIFICATE)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(str(tmp_path / "pair.pem"))
    return context, str(tmp_path / "ca.pem")


def ask_over_tls(server, ca_file, budget_s):
    client = ChatClient(Endpoint(chat_url(server.url), "", None, ca_file), PlannerConfig(), 1)
    replies = [client.ask(QUESTION, budget_s) for _ in range(2)]
    client.close()
    return replies


def test_https_works_with_a_trusted_authority_over_one_connection(tls):
    with FakeServer(sequence(OK), tls=tls[0]) as server:
        assert [reply.failure for reply in ask_over_tls(server, tls[1], 10.0)] == ["", ""]
        assert server.n_connections == 1


def test_an_untrusted_certificate_is_a_tls_failure_and_nothing_is_sent(tls):
    with FakeServer(sequence(OK), tls=tls[0]) as server:
        assert [reply.failure for reply in ask_over_tls(server, "", 10.0)] == ["tls", "tls"]
        assert server.requests == []


@pytest.mark.parametrize("fault", ["hang", "drip"])
def test_a_server_that_stalls_under_tls_is_cut_off_too(tls, fault):
    with FakeServer(sequence(OK, FakeReply(fault=fault)), tls=tls[0]) as server:
        client = ChatClient(Endpoint(chat_url(server.url), "", None, tls[1]), PlannerConfig(), 1)
        assert client.ask(QUESTION, 10.0).failure == ""
        assert client.ask(QUESTION, 0.3).failure == "timeout"
        wait_for(lambda: not workers())
        client.close()


def test_plain_http_where_tls_is_expected_never_gets_the_request():
    with FakeServer(sequence(OK)) as server:
        url = chat_url(server.url).replace("http:", "https:")
        client = ChatClient(Endpoint(url, "", Secret("k"), ""), PlannerConfig(), 1)
        assert client.ask(QUESTION, 5.0).failure in ("tls", "connect")
        assert server.requests == []
        client.close()
