"""Client of a link process: HTTP over its Unix socket."""

from __future__ import annotations

from collections.abc import AsyncGenerator, AsyncIterator
from pathlib import Path

import anyio
import httpx2
from starlette.datastructures import Headers
from starlette.types import Message, Receive, Scope, Send

from gss.api.errors import problem
from gss.api.guard.bodies import MAX_OPEN_BODY_BYTES
from gss.api.guard.route_table import is_change
from gss.api.stream.broadcast import Wire, received
from gss.api.workers.private_app import PEER, STREAM

HOP_BY_HOP = frozenset(b"connection keep-alive proxy-connection te trailer transfer-encoding upgrade expect".split())
SET_BY_WORKER = HOP_BY_HOP | {b"date", b"server"}
MAX_MESSAGE_BYTES = 64 << 20


class LinkProcessClient:
    """HTTP client of one link process. ``name``: name of the process; ``path``: path of its socket.

    Each request uses a new connection and is never retried, so no request is sent twice. If requests shared a
    connection, the server could close the connection while the next request is written, and it would not be known
    whether the server read this request.
    """

    def __init__(self, name: str, path: Path) -> None:
        self.name = name
        limits = httpx2.Limits(max_connections=None, max_keepalive_connections=0)
        self._transport = httpx2.AsyncHTTPTransport(uds=str(path), limits=limits, trust_env=False)

    async def forward(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward a request and its response as streams; end both when the client disconnects. If the response is
        incomplete, send 503, or abort the connection to the client if the response has started."""
        body = _Body(scope, receive)
        content = body.parts() if body.is_long else await body.read_all()
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
        started = False

        async def send_and_note(message: Message) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self._relay(request, send_and_note)
            return
        except httpx2.ConnectError:
            text, received_error, hint = (
                "does not respond: it is starting or restarting",
                "",
                "try again in a few seconds",
            )
        except httpx2.TransportError as error:
            text, received_error, hint = "did not send a complete response", str(error), "try again in a few seconds"
            if is_change(scope):
                hint = "the request may have been executed. Check before you repeat it"
        if not started:
            await problem(503, f"the link process {self.name} {text}", got=received_error, hint=hint)(
                scope, receive, send
            )

    async def _relay(self, request: httpx2.Request, send: Send) -> None:
        response = await self._transport.handle_async_request(request)
        try:
            raw = ((name.lower(), value) for name, value in response.headers.raw)
            headers = [(name, value) for name, value in raw if name not in SET_BY_WORKER]
            await send({"type": "http.response.start", "status": response.status_code, "headers": headers})
            async for part in response.aiter_raw():
                await send({"type": "http.response.body", "body": part, "more_body": True})
            await send({"type": "http.response.body", "body": b""})
        finally:
            await response.aclose()


class _Body:
    """Body of a client's request. ``is_long``: true if it is larger than the limit of routes without sign-in. A shorter
    body is read before the link process is contacted, so that a slow client without an account does not occupy a
    connection to it."""

    def __init__(self, scope: Scope, receive: Receive) -> None:
        self.is_long = int(Headers(scope=scope).get("content-length", "0")) > MAX_OPEN_BODY_BYTES
        self._receive = receive
        self._complete = anyio.Event()

    async def parts(self) -> AsyncIterator[bytes]:
        """Yield the body in parts. If the client disconnects, the generator ends early, which breaks the connection to
        the link process."""
        while not self._complete.is_set():
            message = await self._receive()
            if message["type"] == "http.disconnect":
                return
            if not message.get("more_body", False):
                self._complete.set()
            yield message.get("body", b"")

    async def read_all(self) -> bytes | None:
        """Return the body, or None if the client disconnects before its end."""
        body = b"".join([part async for part in self.parts()])
        return body if self._complete.is_set() else None

    async def disconnected(self) -> None:
        """Wait until the client disconnects after the end of the body."""
        await self._complete.wait()
        while (await self._receive())["type"] != "http.disconnect":
            pass


def _request(scope: Scope, content: bytes | AsyncIterator[bytes]) -> httpx2.Request:
    """Return the request to the link process, with the target and headers of the client's request."""
    target = scope.get("raw_path") or scope["path"].encode()
    if scope["query_string"]:
        target += b"?" + scope["query_string"]
    host, port = scope.get("client") or ("-", 0)
    headers = [(name, value) for name, value in scope["headers"] if name not in HOP_BY_HOP and name != PEER]
    headers += [(PEER, f"{host} {port} {scope['scheme']}".encode()), (b"connection", b"close")]
    as_sent = {"target": target}
    return httpx2.Request(scope["method"], "http://localhost", headers=headers, content=content, extensions=as_sent)
