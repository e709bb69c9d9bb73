"""HTTP with time limits for clients that begin a request and do not complete it. uvicorn closes an idle connection
after some seconds, but waits for the remainder of a request without a limit.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

import h11
from uvicorn.config import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from gss.api.connections.admission import Connection, Connections
from gss.api.guard.route_table import is_open


@dataclass(frozen=True)
class HttpTimeouts:
    """Time limits for requests. ``head_s``: from the connection, or the previous response, to the end of the request's
    head. ``open_body_s``: from the end of the head to the end of the body, for open routes and unauthenticated
    connections. ``body_pause_s``: between two parts of any other body."""

    head_s: float = 15.0
    open_body_s: float = 10.0
    body_pause_s: float = 30.0
    check_every_s: float = 1.0


class TimedHttp(H11Protocol):
    """uvicorn's protocol with time limits for requests. Responses have no time limit, because an event stream does not
    end."""

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
        *,
        connections: Connections,
        timeouts: HttpTimeouts,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._connections, self._timeouts = connections, timeouts

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
        """Start the timeouts. The state of each request contains the connection, so that authentication can protect it
        from being dropped."""
        super().connection_made(transport)
        self._connection: Connection = self._connections.begun(transport, self._waits_for_client)
        self.app_state = {**self.app_state, "connection": self._connection}
        self._since_s = self._head_s = self.loop.time()
        self._timer = self.loop.call_later(self._timeouts.check_every_s, self._check)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the timeouts and remove the connection."""
        self._timer.cancel()
        self._connections.ended(self._connection)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Record the time when a head is complete and when a part of a body arrives."""
        previous_cycle = self.cycle
        super().data_received(data)
        if self.cycle is not previous_cycle:
            self._head_s = self.loop.time()
        if self._waits_for_body():
            self._since_s = self.loop.time()

    def send_400_response(self, msg: str) -> None:
        """Send a 400 response for invalid bytes. If the bytes are in the body of a request whose response is in
        progress, report to the application that the client has disconnected: without this, uvicorn would log one error
        here and one in the application."""
        if self._is_answering():
            self.cycle.disconnected = True
            self.cycle.message_event.set()
        try:
            super().send_400_response(msg)
        except h11.LocalProtocolError:  # the response has begun
            self.transport.close()

    def on_response_complete(self) -> None:
        """Reset the time limits for the next request."""
        self._since_s = self._head_s = self.loop.time()
        super().on_response_complete()

    def _is_answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _waits_for_body(self) -> bool:
        return self._is_answering() and self.conn.their_state is h11.SEND_BODY and not self.flow.read_paused

    def _waits_for_client(self) -> bool:
        return not self._is_answering() or self._waits_for_body()

    def _check(self) -> None:
        if self._is_overdue(self.loop.time()):
            self.transport.abort()
        else:
            self._timer = self.loop.call_later(self._timeouts.check_every_s, self._check)

    def _is_overdue(self, now_s: float) -> bool:
        if not self._waits_for_body():
            if self._is_answering():
                self._since_s = now_s
            return now_s - self._since_s >= self._timeouts.head_s
        if is_open({**self.scope}) or not self._connection.authenticated:
            return now_s - self._head_s >= self._timeouts.open_body_s
        return now_s - self._since_s >= self._timeouts.body_pause_s
