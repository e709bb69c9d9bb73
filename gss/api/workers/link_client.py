"""Client of a link process: HTTP over its Unix socket."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator
from pathlib import Path

import anyio
import httpx2
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from gss.api.errors import problem
from gss.api.guard.bodies import SMALL_BODY_BYTES
from gss.api.guard.route_table import is_change
from gss.api.stream.broadcast import Wire, received
from gss.api.workers.private_app import PEER, STREAM

HOP_BY_HOP = frozenset(b"connection keep-alive proxy-connection te trailer transfer-encoding upgrade expect".split())
SET_BY_WORKER = HOP_BY_HOP | {b"date", b"server"}
MAX_MESSAGE_BYTES = 64 << 20


class LinkProcessClient:
    """Client of one link process. ``name``: of the process; ``path``: of its socket.

    Every request has its own connection and is never retried, so that none is sent twice: a connection that is kept open
    may be closed by the server while the next request is written, and whether it was read is then unknown.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        limits = httpx2.Limits(max_connections=None, max_keepalive_connections=0)
        self._transport = httpx2.AsyncHTTPTransport(uds=str(path), limits=limits, trust_env=False)

    async def forward(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward a request and its response as streams; end both when the client disconnects. Without a complete
        response answer 503, or break the connection to the client if the response has begun."""
        body = _Body(scope, receive)
        content = body.pieces() if body.is_long else await body.whole()
        if content is None:
            return
        async with anyio.create_task_group() as tasks:

            async def watch() -> None:
                await body.disconnected()
                tasks.cancel_scope.cancel()

            tasks.start_soon(watch)
            await self._exchange(scope, receive, send, _request(scope, content))
            tasks.cancel_scope.cancel()

    async def messages(self) -> AsyncGenerator[Wire]:
        """Yield the messages of the event stream. Raises httpx2.TransportError when the connection breaks."""
        request = httpx2.Request("GET", f"http://localhost{STREAM}")
        response = await self._transport.handle_async_request(request)
        response.request = request
        try:
            async for event in httpx2.EventSource(response, MAX_MESSAGE_BYTES):
                yield received(event.event, event.data, event.id)
        finally:
            await response.aclose()

    async def _exchange(self, scope: Scope, receive: Receive, send: Send, request: httpx2.Request) -> None:
        begun = False

        async def note_begin(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._relay(request, note_begin)
            return
        except httpx2.ConnectError:
            text, got, hint = "does not respond: it is starting or restarting", "", "try again in a few seconds"
        except httpx2.TransportError as error:
            text, got, hint = "did not send a complete response", str(error), "try again in a few seconds"
            if is_change(scope):
                hint = "the request may have been executed. Check before you repeat it"
        if not begun:
            await problem(503, f"the link process {self.name} {text}", got=got, hint=hint)(scope, receive, send)

    async def _relay(self, request: httpx2.Request, send: Send) -> None:
        response = await self._transport.handle_async_request(request)
        try:
            raw = ((name.lower(), value) for name, value in response.headers.raw)
            headers = [(name, value) for name, value in raw if name not in SET_BY_WORKER]
            await send({"type": "http.response.start", "status": response.status_code, "headers": headers})
            async for piece in response.aiter_raw():
                await send({"type": "http.response.body", "body": piece, "more_body": True})
            await send({"type": "http.response.body", "body": b""})
        finally:
            await response.aclose()


class _Body:
    """The body of a client's request. ``is_long``: larger than the limit of routes without sign-in. A shorter one is read
    before the link process is contacted, so that a slow client without an account holds no connection to it."""

    def __init__(self, scope: Scope, receive: Receive) -> None:
        self.is_long = int(Headers(scope=scope).get("content-length", "0")) > SMALL_BODY_BYTES
        self._receive = receive
        self._complete = anyio.Event()

    async def pieces(self) -> AsyncIterator[bytes]:
        """Yield the body. If the client disconnects, it ends early, which breaks the connection to the link process."""
        while not self._complete.is_set():
            message = await self._receive()
            if message["type"] == "http.disconnect":
                return
            if not message.get("more_body", False):
                self._complete.set()
            yield message.get("body", b"")

    async def whole(self) -> bytes | None:
        """Return the body, or None if the client disconnects before its end."""
        body = b"".join([piece async for piece in self.pieces()])
        return body if self._complete.is_set() else None

    async def disconnected(self) -> None:
        """Return when the client disconnects after the end of the body."""
        await self._complete.wait()
        while (await self._receive())["type"] != "http.disconnect":
            pass


def _request(scope: Scope, content: bytes | AsyncIterator[bytes]) -> httpx2.Request:
    """Return the request with the target and headers that the client sent."""
    target = scope.get("raw_path") or scope["path"].encode()
    if scope["query_string"]:
        target += b"?" + scope["query_string"]
    host, port = scope.get("client") or ("-", 0)
    headers = [(name, value) for name, value in scope["headers"] if name not in HOP_BY_HOP and name != PEER]
    headers += [(PEER, f"{host} {port} {scope['scheme']}".encode()), (b"connection", b"close")]
    as_sent = {"target": target}
    return httpx2.Request(scope["method"], "http://localhost", headers=headers, content=content, extensions=as_sent)
