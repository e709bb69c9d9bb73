"""Which connections stay open when there are too many: those that carried an authenticated request take precedence.

A new connection shows who uses it only with its first request, so it is always accepted and an older one is dropped for it.
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
"""Divisor of the process's file descriptors that gives those for connections; files, the database and the line use the others."""
UNAUTHENTICATED_SHARE = 2
"""Divisor of all connections that gives those allowed without authentication; the others are reserved for signed-in users."""


@dataclass(frozen=True)
class ConnectionLimits:
    """Maximum numbers of open connections. ``unauthenticated``: those that have not carried an authenticated request;
    at most ``per_address`` of them come from one address (IPv6: one /64 network)."""

    authenticated: int
    unauthenticated: int
    per_address: int

    @classmethod
    def within(cls, most: int, descriptors: int, *, behind_proxy: bool) -> ConnectionLimits:
        """Return the limits for ``most`` connections in a process with that many file descriptors. Behind a proxy all
        clients share its address."""
        total = max(4, min(most, descriptors // DESCRIPTORS_SHARE))
        unauthenticated = total // UNAUTHENTICATED_SHARE
        per_address = unauthenticated if behind_proxy else max(1, unauthenticated // 2)
        return cls(total - unauthenticated, unauthenticated, per_address)


class Connection:
    """An accepted connection. Until its TLS handshake ends there is no transport, only the socket."""

    def __init__(
        self, accepted: socket.socket | None, origin: str, authenticated: Callable[[Connection], None]
    ) -> None:
        self._socket, self.origin, self._proved = accepted, origin, authenticated
        self.authenticated = False
        self._transport: asyncio.Transport | None = None
        self._waits: Callable[[], bool] | None = None

    def attach(self, transport: asyncio.Transport, waits: Callable[[], bool]) -> None:
        """Attach the transport when the protocol starts. ``waits``: returns True while it waits for the client."""
        self._transport, self._waits = transport, waits

    def mark_authenticated(self) -> None:
        """Mark that a request on this connection proved a session or token; it is then no longer dropped in favour of
        unauthenticated ones."""
        if not self.authenticated:
            self.authenticated = True
            self._proved(self)

    @property
    def waits_for_client(self) -> bool:
        """True during the handshake, between requests, and until a request is complete."""
        return self._waits is None or self._waits()

    def drop(self) -> None:
        """Close the connection at once, without a response."""
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
        self._users: Pool = {}
        self._strangers: dict[str, Pool] = {}
        """Unauthenticated connections by origin."""

    @property
    def unauthenticated(self) -> int:
        """Number of connections that have not carried an authenticated request."""
        return sum(map(len, self._strangers.values()))

    def accepted(self, accepted: socket.socket, address: str) -> Connection:
        """Register a new connection and drop others that exceed the limits."""
        return self._add(accepted.fileno(), accepted, address)

    def begun(self, transport: asyncio.Transport, waits: Callable[[], bool]) -> Connection:
        """Return the connection of a transport whose protocol starts."""
        descriptor, peer = transport.get_extra_info("socket").fileno(), transport.get_extra_info("peername")
        connection = self._by_descriptor.get(descriptor)
        if connection is None:  # it was accepted by another listener
            connection = self._add(descriptor, None, str(peer[0]) if peer else "")
        connection.attach(transport, waits)
        del self._by_descriptor[descriptor]
        return connection

    def ended(self, connection: Connection) -> None:
        """Forget a closed connection."""
        self._users.pop(connection, None)
        pool = self._strangers.get(connection.origin, {})
        pool.pop(connection, None)
        if not pool:
            self._strangers.pop(connection.origin, None)

    def drop_one(self) -> bool:
        """Drop an unauthenticated connection to free its descriptor. False if there is none."""
        if not self._strangers:
            return False
        self._drop(_victim(max(self._strangers.values(), key=len)))
        return True

    def _add(self, descriptor: int, accepted: socket.socket | None, address: str) -> Connection:
        new = Connection(accepted, origin_of(address), self._move)
        neighbours = self._strangers.get(new.origin, {})
        if len(neighbours) >= self.limits.per_address:
            self._drop(_victim(neighbours))
        elif self.unauthenticated >= self.limits.unauthenticated:
            self.drop_one()
        if len(self._users) > self.limits.authenticated:
            self._drop(next((one for one in self._users if one.waits_for_client), None))
        self._strangers.setdefault(new.origin, {})[new] = None
        self._by_descriptor[descriptor] = new
        return new

    def _move(self, connection: Connection) -> None:
        if connection in self._strangers.get(connection.origin, {}):
            self.ended(connection)
            self._users[connection] = None

    def _drop(self, connection: Connection | None) -> None:
        if connection is not None:
            kind = "authenticated" if connection.authenticated else "unauthenticated"
            log.warning("Connection limit reached: dropped an %s connection from %s", kind, connection.origin)
            self.ended(connection)
            connection.drop()


def _victim(pool: Pool) -> Connection:
    """Return the oldest connection that waits for its client; the oldest of all if every one has a response in progress."""
    return next((one for one in pool if one.waits_for_client), next(iter(pool)))


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
