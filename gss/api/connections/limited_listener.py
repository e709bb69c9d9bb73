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
MAX_DESCRIPTORS = 1024
"""FD_SETSIZE. pyserial watches the port with select(), which fails for descriptors with this number or a higher
number."""
ACCEPTED_IN_A_ROW = 4
"""Connections accepted per iteration of the event loop. asyncio reads from a new connection a few iterations later. The
limit prevents newer connections from displacing a connection whose request has arrived but has not been read."""
SILENT_S = 5
"""The kernel reports a connection when its first bytes have arrived, or after this many seconds."""


class LimitedListener(socket.socket):
    """Listening socket that takes over the descriptor of another socket. It reports accepted connections to
    ``connections``."""

    def __init__(self, connections: Connections, descriptor: int) -> None:
        super().__init__(fileno=descriptor)
        self._connections, self._remaining = connections, ACCEPTED_IN_A_ROW

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection. If no descriptor is free, drop an unauthenticated connection; the event loop then
        retries."""
        try:
            if self._remaining == 0:
                raise BlockingIOError(errno.EAGAIN, "end of this event-loop iteration")
            accepted, address = super().accept()
        except BlockingIOError:
            self._remaining = ACCEPTED_IN_A_ROW
            raise
        except OSError as error:
            if error.errno in OUT_OF_RESOURCES:
                self._free_descriptor(error)
            raise
        self._remaining -= 1
        self._connections.accepted(accepted, str(address[0]) if address else "")
        return accepted, address

    def _free_descriptor(self, error: OSError) -> None:
        """Drop a connection and raise BlockingIOError if a descriptor becomes free. Otherwise make the event loop pause
        for one second, so that it does not log a message for every connection in the backlog."""
        poll = select.poll()
        poll.register(self, select.POLLIN)
        if not poll.poll(0):  # the kernel checks for a free descriptor before it checks for a connection
            raise BlockingIOError(errno.EAGAIN, "no connection is waiting") from error
        log.warning("Cannot accept a connection: %s", error.strerror)
        if self._connections.drop_one():
            raise BlockingIOError(errno.EAGAIN, "a connection was dropped") from error
        self._remaining = 0


def prefer_requests(listener: socket.socket) -> None:
    """Deliver connections that have sent data first, on systems that support it (Linux)."""
    if hasattr(socket, "TCP_DEFER_ACCEPT"):
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, SILENT_S)


def raise_descriptor_limit() -> int:
    """Set the limit of open files of this process and its children to ``MAX_DESCRIPTORS``, or as close as the system
    permits. Returns the limit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    target = MAX_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(MAX_DESCRIPTORS, hard)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (target, hard))
    except (OSError, ValueError):
        return soft
    return target
