"""Listening socket that counts every connection from accept on, before any TLS handshake."""

from __future__ import annotations

import errno
import logging
import resource
import select
import socket
from typing import Any

from gss.api.connections.admission import Connections

log = logging.getLogger("gss.connections")
OUT_OF_RESOURCES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
DESCRIPTORS_MOST = 1024
"""FD_SETSIZE: pyserial watches the port with select(), which fails for descriptors from this number on."""
ACCEPTED_IN_A_ROW = 4
"""Connections accepted per turn of the event loop. asyncio reads from a new connection a few turns later; the limit
prevents a connection whose request has arrived from being dropped for newer ones before that request is read."""
SILENT_S = 5
"""The kernel reports a connection when its first bytes have arrived, or after this many seconds."""


class LimitedListener(socket.socket):
    """Listening socket that takes over another socket's descriptor and reports accepted connections to ``connections``."""

    def __init__(self, connections: Connections, descriptor: int) -> None:
        super().__init__(fileno=descriptor)
        self._connections, self._remaining = connections, ACCEPTED_IN_A_ROW

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection. If descriptors run out, an unauthenticated one is dropped and the event loop retries."""
        try:
            if self._remaining == 0:
                raise BlockingIOError(errno.EAGAIN, "the event loop's turn")
            accepted, address = super().accept()
        except BlockingIOError:
            self._remaining = ACCEPTED_IN_A_ROW
            raise
        except OSError as error:
            if error.errno in OUT_OF_RESOURCES:
                self._make_room(error)
            raise
        self._remaining -= 1
        self._connections.accepted(accepted, str(address[0]) if address else "")
        return accepted, address

    def _make_room(self, error: OSError) -> None:
        """Drop a connection and raise BlockingIOError if that helps. Otherwise the event loop pauses for a second; it
        would log once per place in the backlog."""
        waiting = select.poll()
        waiting.register(self, select.POLLIN)
        if not waiting.poll(0):  # the kernel checks for a free descriptor before it checks for a connection
            raise BlockingIOError(errno.EAGAIN, "no connection waits") from error
        log.warning("Cannot accept a connection: %s", error.strerror)
        if self._connections.drop_one():
            raise BlockingIOError(errno.EAGAIN, "a connection was dropped") from error
        self._remaining = 0


def prefer_requests(listener: socket.socket) -> None:
    """Deliver connections that have sent data first, on systems that support it (Linux)."""
    if hasattr(socket, "TCP_DEFER_ACCEPT"):
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, SILENT_S)


def raise_descriptor_limit() -> int:
    """Set the limit of open files of this process and its children to ``DESCRIPTORS_MOST``, or as close as the system permits.
    Returns the limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = DESCRIPTORS_MOST if hard == resource.RLIM_INFINITY else min(DESCRIPTORS_MOST, hard)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
    except (OSError, ValueError):
        return soft
    return most
