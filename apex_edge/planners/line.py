"""The sockets of one call, within reach of another thread."""

import socket
import threading
from typing import Any, Dict


class Line:
    """The sockets one call uses, so that another thread can end the call."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._handles: Dict[int, socket.socket] = {}
        self._is_cut = False

    def note(self, connection: object, sock: Any) -> None:
        """Keep a handle of ``sock`` (works for TLS too); shut it at once when already cut."""
        with self._lock:
            if id(connection) in self._handles:
                self._handles.pop(id(connection)).close()
            try:
                handle = socket.fromfd(sock.fileno(), sock.family, sock.type)
            except OSError:
                return
            self._handles[id(connection)] = handle
            if self._is_cut:
                _shut(handle)

    def cut(self) -> None:
        """Shut every socket of the call; whoever reads from one wakes up."""
        with self._lock:
            self._is_cut = True
            for handle in self._handles.values():
                _shut(handle)

    def release(self) -> None:
        """Drop the handles; the connections themselves stay open for the next call."""
        with self._lock:
            for handle in self._handles.values():
                handle.close()
            self._handles.clear()


def _shut(handle: socket.socket) -> None:
    try:
        handle.shutdown(socket.SHUT_RDWR)
    except OSError:
        return  # already closed by the other side
