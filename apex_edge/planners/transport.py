"""One HTTP exchange with a hard end: requests, made interruptible.

The time-out of requests counts between bytes, so a server that sends a byte now and then holds a
caller for as long as it likes (measured: 23 s at a time-out of 0.5 s). Here each connection leaves
a second handle of its socket with the call that uses it, and ending the call shuts that socket
down, which wakes the thread that reads from it. Imported only when an LLM is asked.
"""

import http.client
import socket
import threading
from dataclasses import dataclass, field
from http.cookiejar import DefaultCookiePolicy
from typing import Any, List, Mapping, Optional, Tuple

import requests
import requests.adapters
import urllib3
import urllib3.connection
import urllib3.connectionpool
import urllib3.exceptions

from apex_edge.planners.endpoint import Endpoint, Secret
from apex_edge.planners.line import Line
from apex_edge.planners.parse import status_kind

BODY_LIMIT_BYTES = 65536
CHUNK_BYTES = 4096
CONNECT_LIMIT_S = 0.5
CONNECT_SHARE = 0.2

_SLOW = (socket.timeout, urllib3.exceptions.ReadTimeoutError)

_current = threading.local()


class _NotedMixin:
    """Tell the current line about the socket, when it is made and when it is used again."""

    sock: Any

    def _new_conn(self) -> Any:
        sock = super()._new_conn()  # type: ignore[misc]
        self._note(sock)
        return sock

    def request(self, *args: Any, **kwargs: Any) -> None:
        if self.sock is not None:
            self._note(self.sock)
        super().request(*args, **kwargs)  # type: ignore[misc]

    def _note(self, sock: Any) -> None:
        line: Optional[Line] = getattr(_current, "line", None)
        if line is not None:
            line.note(self, sock)


class _HttpConnection(_NotedMixin, urllib3.connection.HTTPConnection):
    pass


class _HttpsConnection(_NotedMixin, urllib3.connection.HTTPSConnection):
    pass


class _HttpPool(urllib3.connectionpool.HTTPConnectionPool):
    ConnectionCls = _HttpConnection


class _HttpsPool(urllib3.connectionpool.HTTPSConnectionPool):
    ConnectionCls = _HttpsConnection


class _Adapter(requests.adapters.HTTPAdapter):
    def init_poolmanager(self, *args: Any, **kwargs: Any) -> None:
        parent: Any = super()
        parent.init_poolmanager(*args, **kwargs)
        pools: Any = self.poolmanager
        pools.pool_classes_by_scheme = {"http": _HttpPool, "https": _HttpsPool}


class _BearerAuth(requests.auth.AuthBase):
    """Write the Authorization header late, so that no session or dump holds it."""

    def __init__(self, key: Optional[Secret]) -> None:
        self._key = key

    def __call__(self, request: requests.PreparedRequest) -> requests.PreparedRequest:
        if self._key is not None:
            request.headers["Authorization"] = f"Bearer {self._key.reveal()}"
        return request


@dataclass(frozen=True)
class Exchange:
    """How one request ended: ``failure`` is "" when a whole 2xx body is there.

    ``is_unanswered`` means that not one byte of a response came, so asking again is harmless.
    """

    failure: str
    status: int = 0
    body: bytes = b""
    headers: Mapping[str, str] = field(default_factory=dict)
    is_unanswered: bool = False


class Transport:
    """Keep one session with one endpoint: no proxies from the environment, redirects or cookies."""

    def __init__(self, endpoint: Endpoint) -> None:
        self._url = endpoint.url
        self._session = requests.Session()
        self._session.trust_env = False
        self._session.verify = endpoint.ca_file or True
        self._session.auth = _BearerAuth(endpoint.key)
        self._session.cookies.set_policy(DefaultCookiePolicy(allowed_domains=[]))
        self._session.headers["Accept-Encoding"] = "identity"
        for scheme in ("http://", "https://"):
            self._session.mount(scheme, _Adapter(pool_maxsize=2))

    def post(self, body: Mapping[str, Any], remaining_s: float, line: Line) -> Exchange:
        """Send ``body`` as JSON and read the whole answer; blocks, so call it on a worker thread.

        Parameters
        ----------
        remaining_s : time left; connecting gets at most a fifth of it.
        line : learns the sockets, so that ``line.cut()`` from another thread ends this call.
        """
        _current.line = line
        response: Optional[requests.Response] = None
        try:
            response = self._session.post(
                self._url,
                json=body,
                stream=True,
                allow_redirects=False,
                timeout=(min(CONNECT_LIMIT_S, CONNECT_SHARE * remaining_s), remaining_s),
            )
            return _read(response)
        except (
            requests.RequestException,
            urllib3.exceptions.HTTPError,
            http.client.HTTPException,
            OSError,
            ValueError,
        ) as error:
            return _broken(error, response)
        finally:
            _current.line = None
            if response is not None:
                response.close()
            line.release()

    def close(self) -> None:
        """Close idle connections."""
        self._session.close()


def _read(response: requests.Response) -> Exchange:
    headers = {name.lower(): value for name, value in response.headers.items()}
    length = headers.get("content-length", "")
    announced = int(length) if length.isdigit() and len(length) < 10 else -1
    if announced > BODY_LIMIT_BYTES:
        return Exchange("too_large", response.status_code, headers=headers)
    pieces: List[bytes] = []
    n_bytes = 0
    for piece in response.iter_content(CHUNK_BYTES):
        pieces.append(piece)
        n_bytes += len(piece)
        if n_bytes > BODY_LIMIT_BYTES:
            return Exchange("too_large", response.status_code, headers=headers)
    # urllib3 1.26 hands a short body over without a word
    if announced > n_bytes and "content-encoding" not in headers:
        return Exchange("truncated", response.status_code, headers=headers)
    failure = status_kind(response.status_code)
    return Exchange(failure, response.status_code, b"".join(pieces), headers)


def _broken(error: BaseException, response: Optional[requests.Response]) -> Exchange:
    """Name what went wrong; never quotes the error, whose text is the server's."""
    if response is not None:
        kind = "timeout" if _has_cause(error, _SLOW) else "truncated"
        return Exchange(kind, response.status_code)
    if isinstance(error, requests.exceptions.SSLError):
        return Exchange("tls")
    if isinstance(error, requests.ReadTimeout):
        return Exchange("timeout")
    if _has_cause(error, (http.client.HTTPException,)) and not _has_cause(
        error, (ConnectionError,)
    ):
        return Exchange("bad_http")
    return Exchange("connect", is_unanswered=True)


def _has_cause(error: BaseException, kinds: Tuple[type, ...]) -> bool:
    """Look for an exception of ``kinds`` among the arguments and causes that wrap each other."""
    pending: List[BaseException] = [error]
    seen = set()
    while pending:
        found = pending.pop()
        if isinstance(found, kinds):
            return True
        if id(found) in seen:
            continue
        seen.add(id(found))
        pending += [a for a in found.args if isinstance(a, BaseException)]
        reason = getattr(found, "reason", None)
        pending += [e for e in (found.__cause__, reason) if isinstance(e, BaseException)]
    return False
