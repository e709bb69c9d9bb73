"""Proxy from an API worker to the link process: streams requests and responses unchanged over a private Unix socket."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import h11
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gss.api.errors import problem
from gss.api.guard.door import is_change, is_open
from gss.api.workers.local_routes import is_local

PEER = b"x-gss-peer"
"""Original client: address, port and scheme. Accepted on the private socket only; this header from a browser is dropped."""
OWN = {
    b"connection",
    b"keep-alive",
    b"proxy-connection",
    b"te",
    b"trailer",
    b"transfer-encoding",
    b"upgrade",
    b"expect",
    PEER,
}
SET_AGAIN = OWN | {b"date", b"server"}
PIECE = 1 << 16


class Gateway:
    """Innermost middleware of a worker: requests that are not local go to ``forward``. The guard runs before it."""

    def __init__(self, app: ASGIApp, forward: ASGIApp) -> None:
        self._app, self._forward = app, forward

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request locally or forward it."""
        if scope["type"] != "http" or is_local(scope["method"], scope["path"]):
            await self._app(scope, receive, send)
            return
        if is_open(scope) and is_change(scope):
            whole = await _whole_body(receive)
            if whole is None:
                return  # the client disconnected; nothing was forwarded
            receive = whole
        scope["gss.forwarded"] = True
        await self._forward(scope, receive, send)


async def _whole_body(receive: Receive) -> Receive | None:
    """Read the complete body, so that a slow client without an account holds no connection to the link process. Such
    bodies are small. Returns a ``receive`` that yields it in one message; None if the client disconnected."""
    body, more = b"", True
    while more:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        body, more = body + message.get("body", b""), message.get("more_body", False)
    pieces = [{"type": "http.request", "body": body, "more_body": False}]

    async def one_piece() -> Message:
        return pieces.pop() if pieces else await receive()

    return one_piece


class Forward:
    """Forwards each request on a separate connection and never retries it, so no request is sent twice."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Forward one request; 503 if the link process cannot be reached."""
        try:
            reader, writer = await asyncio.open_unix_connection(self._path)
        except OSError as error:
            refusal = problem(503, "the link process does not answer", got=str(error), hint="try again in a moment")
            await refusal(scope, receive, send)
            return
        exchange = _Exchange(scope, receive, send, reader, writer)
        try:
            await exchange.run()
        finally:
            writer.close()


class _Exchange:
    """One forwarded request and its response."""

    def __init__(
        self, scope: Scope, receive: Receive, send: Send, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._scope, self._receive, self._send = scope, receive, send
        self._reader, self._writer = reader, writer
        self._http = h11.Connection(h11.CLIENT)
        self._started = False

    async def run(self) -> None:
        """Run until the response is complete or the client disconnects; the link process sees the disconnect at once."""
        asking = asyncio.create_task(self._ask())
        answering = asyncio.create_task(self._answer())
        try:
            await asyncio.wait((asking, answering), return_when=asyncio.FIRST_COMPLETED)
            if not answering.done() and asking.exception() is not None:
                await answering  # the link process rejected the rest of the request; its response may still arrive
            if answering.done():
                answering.result()
        except (OSError, h11.RemoteProtocolError) as error:
            await self._broken(error)
        finally:
            for task in (asking, answering):
                task.cancel()
            await asyncio.gather(asking, answering, return_exceptions=True)

    async def _ask(self) -> None:
        scope = self._scope
        target = scope.get("raw_path") or scope["path"].encode()
        if scope["query_string"]:
            target += b"?" + scope["query_string"]
        host, port = scope.get("client") or ("", 0)
        headers = [(name, value) for name, value in scope["headers"] if name not in OWN]
        headers += [(PEER, f"{host or '-'} {port} {scope['scheme']}".encode()), (b"connection", b"close")]
        await self._write(h11.Request(method=scope["method"], target=target, headers=headers))
        has_body = any(name == b"content-length" for name, _ in headers)
        more = True
        while more:
            message = await self._receive()
            if message["type"] == "http.disconnect":
                return
            more = message.get("more_body", False)
            if has_body and message.get("body"):
                await self._write(h11.Data(data=message["body"]))
        await self._write(h11.EndOfMessage())
        while (await self._receive())["type"] != "http.disconnect":
            pass

    async def _write(self, event: Any) -> None:
        self._writer.write(self._http.send(event) or b"")
        await self._writer.drain()

    async def _answer(self) -> None:
        while True:
            event = self._http.next_event()
            if event is h11.NEED_DATA:
                self._http.receive_data(await self._reader.read(PIECE))
            elif isinstance(event, h11.Response):
                headers = [(name, value) for name, value in event.headers if name not in SET_AGAIN]
                await self._send({"type": "http.response.start", "status": event.status_code, "headers": headers})
                self._started = True
            elif isinstance(event, h11.Data):
                await self._send({"type": "http.response.body", "body": bytes(event.data), "more_body": True})
            elif isinstance(event, h11.EndOfMessage):
                await self._send({"type": "http.response.body", "body": b""})
                return
            elif isinstance(event, h11.ConnectionClosed):
                raise ConnectionResetError("the connection was closed before the answer")

    async def _broken(self, error: Exception) -> None:
        """Answer 503 if no response has started; otherwise cut the connection, so that the browser detects an
        incomplete response."""
        if self._started:
            return
        changed = is_change(self._scope)
        hint = "it may have been done: look before you send it again" if changed else "try again in a moment"
        refusal = problem(503, "the link process did not answer to the end", got=str(error), hint=hint)
        await refusal(self._scope, self._receive, self._send)


def peer_of(scope: Scope) -> Scope:
    """In the link process: return the scope as if the browser had connected directly."""
    told = [value for name, value in scope["headers"] if name == PEER]
    headers = [(name, value) for name, value in scope["headers"] if name != PEER]
    if len(told) != 1:
        return {**scope, "headers": headers}
    host, port, scheme = told[0].decode("ascii", "replace").split(" ")
    return {**scope, "headers": headers, "client": (host, int(port)), "scheme": scheme}
