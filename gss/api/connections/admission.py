"""Determines which connections stay open if there are too many.

A new connection is unauthenticated until its first request. It is always accepted, and if the limit is exceeded, an
older unauthenticated connection is dropped. If a connection becomes authenticated and the limit for authenticated
connections is exceeded, an authenticated connection that waits for its client is dropped.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
from collections.abc import Callable
from dataclasses import dataclass
from ipaddress import IPv6Address, ip_address

log = logging.getLogger("gss.connections")
DESCRIPTORS_SHARE = 2
"""Divisor of the number of file descriptors. The quotient is the share for connections; the remaining descriptors are
for files, the database and the line."""
UNAUTHENTICATED_SHARE = 2
"""Divisor of the number of connections. The quotient is the share of unauthenticated connections; the remaining
connections are reserved for signed-in users."""


@dataclass(frozen=True)
class ConnectionLimits:
    """Maximum numbers of open connections. ``unauthenticated``: connections without an authenticated request. At most
    ``per_address`` unauthenticated connections are open from one address (IPv6: one /64 network)."""

    authenticated: int
    unauthenticated: int
    per_address: int

    @classmethod
    def within(cls, max_connections: int, descriptors: int, *, behind_proxy: bool) -> ConnectionLimits:
        """Return the limits for ``max_connections`` connections in a process with ``descriptors`` file descriptors.
        Behind a proxy all clients share its address."""
        total = max(4, min(max_connections, descriptors // DESCRIPTORS_SHARE))
        unauthenticated = total // UNAUTHENTICATED_SHARE
        per_address = unauthenticated if behind_proxy else max(1, unauthenticated // 2)
        return cls(total - unauthenticated, unauthenticated, per_address)


class Connection:
    """An accepted connection. Until the TLS handshake ends, it has only a socket and no transport."""

    def __init__(
        self, accepted: socket.socket | None, origin: str, authenticated: Callable[[Connection], None]
    ) -> None:
        self._socket, self.origin, self._on_authenticated = accepted, origin, authenticated
        self.authenticated = False
        self._transport: asyncio.Transport | None = None
        self._waits: Callable[[], bool] | None = None

    def attach(self, transport: asyncio.Transport, waits: Callable[[], bool]) -> None:
        """Attach the transport when the protocol starts. ``waits``: function that returns True while the protocol waits
        for the client."""
        self._transport, self._waits = transport, waits

    def mark_authenticated(self) -> None:
        """Record that a request carried a valid session or token. New unauthenticated connections no longer displace
        this connection."""
        if not self.authenticated:
            self.authenticated = True
            self._on_authenticated(self)

    @property
    def waits_for_client(self) -> bool:
        """True during the handshake, between requests, and until a request is complete."""
        return self._waits is None or self._waits()

    @property
    def is_closed(self) -> bool:
        """True if the socket was closed before the protocol began, as after a failed TLS handshake."""
        return self._transport is None and self._socket is not None and self._socket.fileno() < 0

    def drop(self) -> None:
        """Close the connection immediately, without a response."""
        if self._transport is not None:
            self._transport.abort()
        elif self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)  # the event loop, which owns the socket, then closes it


Pool = dict[Connection, None]
"""Connections, oldest first."""


class Connections:
    """The open connections of a process."""

    def __init__(self, limits: ConnectionLimits) -> None:
        self.limits = limits
        self._by_descriptor: dict[int, Connection] = {}
        """Connections whose protocol has not begun."""
        self._users: Pool = {}
        self._unauthenticated: dict[str, Pool] = {}
        """By origin."""

    @property
    def unauthenticated(self) -> int:
        """Number of connections that have not carried an authenticated request."""
        return sum(map(len, self._unauthenticated.values()))

    def accepted(self, accepted: socket.socket, address: str) -> Connection:
        """Register a new connection and drop others that exceed the limits."""
        return self._add(accepted.fileno(), accepted, address)

    def begun(self, transport: asyncio.Transport, waits: Callable[[], bool]) -> Connection:
        """Return the connection of a transport whose protocol starts."""
        descriptor, peer = transport.get_extra_info("socket").fileno(), transport.get_extra_info("peername")
        connection = self._by_descriptor.get(descriptor)
        if connection is None or connection.is_closed:  # accepted by another listener
            connection = self._add(descriptor, None, str(peer[0]) if peer else "")
        connection.attach(transport, waits)
        del self._by_descriptor[descriptor]
        return connection

    def ended(self, connection: Connection) -> None:
        """Remove a closed connection."""
        self._users.pop(connection, None)
        pool = self._unauthenticated.get(connection.origin, {})
        pool.pop(connection, None)
        if not pool:
            self._unauthenticated.pop(connection.origin, None)

    def drop_one(self) -> bool:
        """Drop an unauthenticated connection to free its descriptor. Return False if none exists."""
        self._forget_closed()
        if not self._unauthenticated:
            return False
        self._drop(_victim(max(self._unauthenticated.values(), key=len)))
        return True

    def _add(self, descriptor: int, accepted: socket.socket | None, address: str) -> Connection:
        self._forget_closed()
        new = Connection(accepted, origin_of(address), self._move)
        same_origin = self._unauthenticated.get(new.origin, {})
        if len(same_origin) >= self.limits.per_address:
            self._drop(_victim(same_origin))
        elif self.unauthenticated >= self.limits.unauthenticated:
            self.drop_one()
        self._unauthenticated.setdefault(new.origin, {})[new] = None
        self._by_descriptor[descriptor] = new
        return new

    def _forget_closed(self) -> None:
        for descriptor, connection in list(self._by_descriptor.items()):
            if connection.is_closed:
                del self._by_descriptor[descriptor]
                self.ended(connection)

    def _move(self, connection: Connection) -> None:
        """Count the connection as authenticated. Above the limit, drop an idle connection, preferably from the same
        origin."""
        if connection not in self._unauthenticated.get(connection.origin, {}):
            return
        self.ended(connection)
        if len(self._users) >= self.limits.authenticated:
            idle = [candidate for candidate in self._users if candidate.waits_for_client]
            same_origin = [candidate for candidate in idle if candidate.origin == connection.origin]
            self._drop(next(iter(same_origin or idle), None))
        self._users[connection] = None

    def _drop(self, connection: Connection | None) -> None:
        if connection is not None:
            kind = "authenticated" if connection.authenticated else "unauthenticated"
            log.warning("Connection limit reached: dropped an %s connection from %s", kind, connection.origin)
            self.ended(connection)
            connection.drop()


def _victim(pool: Pool) -> Connection:
    """Return the oldest connection that waits for its client. If every connection has a request in progress, return the
    oldest."""
    return next((candidate for candidate in pool if candidate.waits_for_client), next(iter(pool)))


def origin_of(address: str) -> str:
    """Return the key that identifies one client: an IPv4 address, or the /64 network of an IPv6 address."""
    try:
        parsed = ip_address(address.partition("%")[0])
    except ValueError:
        return address or "-"
    if not isinstance(parsed, IPv6Address):
        return str(parsed)
    if parsed.ipv4_mapped is not None:
        return str(parsed.ipv4_mapped)
    return f"{IPv6Address(int(parsed) >> 64 << 64)}/64"
