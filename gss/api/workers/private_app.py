"""Application on the Unix socket of a link process: forwarded requests, and the event stream for the workers."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

from starlette.types import ASGIApp, Receive, Scope, Send

from gss.api.stream.broadcast import Broadcaster
from gss.api.stream.route import EventStream
from gss.wiring.services import Services

STREAM = "/worker-stream"
PEER = b"x-gss-peer"
"""Header with the original client: address, port and scheme. Accepted on the private socket only; the worker drops it
from a browser's request."""


class PrivateApp:
    """Application for the API workers or the front process; no other user can open the socket. ``following``: context
    that is active while a process has the event stream open."""

    def __init__(
        self,
        app: ASGIApp,
        services: Services,
        broadcaster: Broadcaster,
        following: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._app, self._services, self._broadcaster, self._following = app, services, broadcaster, following

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
        elif scope["path"] == STREAM:
            with self._following():
                await EventStream(self._services, self._broadcaster)(scope, receive, send)
        else:
            await self._app(peer_of(scope), receive, send)


def peer_of(scope: Scope) -> Scope:
    """Return the scope of a forwarded request as if its client had connected directly."""
    peers = [value for name, value in scope["headers"] if name == PEER]
    headers = [(name, value) for name, value in scope["headers"] if name != PEER]
    if len(peers) != 1:
        return {**scope, "headers": headers}
    host, port, scheme = peers[0].decode("ascii", "replace").split(" ")
    return {**scope, "headers": headers, "client": (host, int(port)), "scheme": scheme}
