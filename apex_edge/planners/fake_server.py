"""A scripted chat-completions server: try the LLM path with no key and no network.

``python -m apex_edge.planners.fake_server --port 0 --latency 0.5 --answer first`` prints its URL;
give that to the agent as APEX_LLM_BASE_URL. In code, ``FakeServer(behaviour)`` serves whatever a
callable says, also the faults real servers have: it writes raw bytes, one thread per connection.
"""

import argparse
import json
import signal
import socket
import ssl
import struct
import sys
import threading
from typing import Dict, List, Mapping, Optional, Tuple

from apex_edge.planners.endpoint import Secret
from apex_edge.planners.fake_answers import (
    ANSWERS,
    Behaviour,
    FakeReply,
    FakeRequest,
    answering,
    completion,
    completion_body,
    read_choices,
    sequence,
)

__all__ = [
    "ANSWERS",
    "FAULTS",
    "Behaviour",
    "FakeReply",
    "FakeRequest",
    "FakeServer",
    "answering",
    "completion",
    "completion_body",
    "failing",
    "read_choices",
    "sequence",
]

FAULTS = (
    "hang",  # never answers
    "drip",  # one byte of a body every 50 ms
    "drip_head",  # one byte of a header every 50 ms
    "reset",  # TCP reset before any byte
    "close",  # closes before any byte
    "reset_body",  # TCP reset within the body
    "truncated_body",  # closes before Content-Length is reached
    "truncated_json",  # a whole response whose JSON stops half way
    "garbage",  # bytes that are not HTTP
    "html",  # status 200 with an error page
    "bad_chunk",  # chunked body with a length that is no number
    "endless",  # chunked body that never ends
    "huge",  # announces a body of 128 MB
)
DRIP_S = 0.05
REQUEST_LIMIT_BYTES = 1 << 20


class FakeServer:
    """Serve ``behaviour`` on 127.0.0.1 until closed; use as a context manager.

    ``requests`` lists what came in. ``tls`` is a server-side context for https.
    """

    def __init__(
        self, behaviour: Behaviour, port: int = 0, tls: Optional[ssl.SSLContext] = None
    ) -> None:
        self.behaviour = behaviour
        self.requests: List[FakeRequest] = []
        self._tls = tls
        self._stop = threading.Event()
        self._lock = threading.Lock()
        self._connections: Dict[int, socket.socket] = {}
        self._threads: List[threading.Thread] = []
        self._listener = _listen(port)
        self._accepter = threading.Thread(target=self._accept, name="fake-llm", daemon=True)
        self._accepter.start()

    @property
    def url(self) -> str:
        """Return the base URL to hand to a client."""
        scheme = "https" if self._tls else "http"
        return f"{scheme}://127.0.0.1:{self._listener.getsockname()[1]}/v1"

    @property
    def n_connections(self) -> int:
        """Return how many connections were ever accepted."""
        return len(self._threads)

    def close(self) -> None:
        """Stop serving, cut every connection and wait for the threads."""
        if self._stop.is_set():
            return
        self._stop.set()
        _shut(self._listener)
        self._accepter.join()
        self._listener.close()
        with self._lock:
            for connection in self._connections.values():
                _shut(connection)
        for thread in self._threads:
            thread.join()

    def __enter__(self) -> "FakeServer":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _accept(self) -> None:
        while not self._stop.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError:
                continue  # the time-out, or the listener was shut
            # without it a header and a body sent apart cost the 40 ms of a delayed ACK
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            thread = threading.Thread(target=self._serve, args=(connection,), daemon=True)
            self._threads.append(thread)
            thread.start()

    def _serve(self, connection: socket.socket) -> None:
        key = id(connection)
        try:
            connection.settimeout(None)
            if self._tls:
                connection = self._tls.wrap_socket(connection, server_side=True)
            with self._lock:
                self._connections[key] = connection
            while not self._stop.is_set() and self._exchange(connection):
                pass
        except OSError:
            return  # the client has gone, which is its right
        finally:
            with self._lock:
                self._connections.pop(key, None)
            connection.close()

    def _exchange(self, connection: socket.socket) -> bool:
        """Answer one request; say whether the connection may carry another."""
        received = _receive(connection)
        if received is None:
            return False
        path, headers, data = received
        with self._lock:
            request = _request(len(self.requests), path, headers, data)
            self.requests.append(request)
        reply = self.behaviour(request)
        self._stop.wait(reply.latency_s)
        if reply.fault:
            self._misbehave(connection, reply.fault)
            return False
        connection.sendall(_response(reply.status, reply.body, reply.headers))
        return reply.headers.get("Connection", "") != "close"

    def _misbehave(self, connection: socket.socket, fault: str) -> None:
        body = completion_body('{"index": 1}')
        whole = _response(200, body, {})
        chunked = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
        n_head = len(whole) - len(body)
        if fault == "hang":
            self._until_gone(connection)
        elif fault in ("drip", "drip_head"):
            self._drip(connection, whole, n_head if fault == "drip" else 20)
        elif fault in ("reset", "reset_body"):
            connection.sendall(whole[: n_head + 10] if fault == "reset_body" else b"")
            linger = struct.pack("ii", 1, 0)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        elif fault == "endless":
            connection.sendall(chunked)
            while not self._stop.is_set():
                connection.sendall(b"1000\r\n" + b" " * 4096 + b"\r\n")
        elif fault != "close":
            connection.sendall(
                {
                    "truncated_body": whole[:-20],
                    "truncated_json": _response(200, body[:-20], {}),
                    "garbage": b"\x00\xff\xfe not http at all\r\n\r\n",
                    "html": _response(200, b"<html>502 Bad Gateway</html>", {}),
                    "bad_chunk": chunked + b"zzz\r\n" + body + b"\r\n0\r\n\r\n",
                    "huge": b"HTTP/1.1 200 OK\r\nContent-Length: 134217728\r\n\r\n" + b" " * 4096,
                }[fault]
            )

    def _drip(self, connection: socket.socket, data: bytes, n_at_once: int) -> None:
        connection.sendall(data[:n_at_once])
        for position in range(n_at_once, len(data)):
            if self._stop.wait(DRIP_S):
                return
            connection.sendall(data[position : position + 1])

    def _until_gone(self, connection: socket.socket) -> None:
        while not self._stop.is_set() and connection.recv(4096):
            pass


def failing(fault: str) -> Behaviour:
    """Return a behaviour that shows one of FAULTS, whatever is asked."""
    if fault not in FAULTS:
        raise ValueError(f"no fault is named {fault!r}; known: {', '.join(FAULTS)}")
    return lambda request: FakeReply(fault=fault)


def _listen(port: int) -> socket.socket:
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", port))
    listener.listen(16)
    listener.settimeout(0.1)
    return listener


def _shut(connection: socket.socket) -> None:
    try:
        connection.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # gone already


def _receive(connection: socket.socket) -> Optional[Tuple[str, Dict[str, str], bytes]]:
    """Read one request: path, headers, body; None when the client closes or talks no HTTP."""
    data = b""
    while b"\r\n\r\n" not in data:
        piece = connection.recv(65536)
        data += piece
        is_http = data[:1].isalpha()  # a TLS greeting is not
        if not piece or not is_http or len(data) > REQUEST_LIMIT_BYTES:
            return None
    head, _, body = data.partition(b"\r\n\r\n")
    lines = head.decode("latin-1").split("\r\n")
    words = lines[0].split(" ")
    headers = {}
    for line in lines[1:]:
        name, _, value = line.partition(":")
        headers[name.strip().lower()] = value.strip()
    length = headers.get("content-length", "0")
    if len(words) != 3 or not length.isdigit() or int(length) > REQUEST_LIMIT_BYTES:
        return None
    while len(body) < int(length):
        piece = connection.recv(65536)
        if not piece:
            return None
        body += piece
    return words[1], headers, body


def _request(number: int, path: str, headers: Dict[str, str], data: bytes) -> FakeRequest:
    scheme, _, key = headers.pop("authorization", "").partition(" ")
    try:
        body = json.loads(data.decode("utf-8"))
    except ValueError:
        body = None
    return FakeRequest(number, path, headers, body, Secret(key) if scheme == "Bearer" else None)


def _response(status: int, body: bytes, headers: Mapping[str, str]) -> bytes:
    lines = [f"HTTP/1.1 {status} Fake", f"Content-Length: {len(body)}"]
    lines += ["Content-Type: application/json"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    return "\r\n".join(lines).encode("latin-1") + b"\r\n\r\n" + body


def main(arguments: Optional[List[str]] = None) -> int:
    """Serve until interrupted; the first line printed is the URL."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--port", type=int, default=0, help="port on 127.0.0.1 (0: any free one)")
    parser.add_argument("--latency", type=float, default=0.5, metavar="S", help="of each answer, s")
    parser.add_argument("--answer", choices=ANSWERS, default="first", help="what to answer")
    parser.add_argument("--seed", type=int, default=0, help="seed of --answer random")
    args = parser.parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    with FakeServer(answering(args.answer, args.latency, args.seed), args.port) as server:
        sys.stdout.write(f"{server.url}\n")
        sys.stdout.flush()
        stop.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
