"""The event stream from the link process to a worker, and the private socket application that serves it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from pathlib import Path

from starlette.types import ASGIApp, Receive, Scope, Send

from gss.api.stream.fanout import Fanout, Wire
from gss.api.stream.route import EventStream
from gss.api.workers.forward import peer_of
from gss.wiring import Services

STREAM = "/worker-stream"
AGAIN_S = 0.2
LONGEST_MESSAGE = 64 << 20


class PrivateDoor:
    """Application on the link process's Unix socket: requests that a worker forwards, and the event stream for the
    workers. No other user can open the socket."""

    def __init__(self, app: ASGIApp, services: Services, fanout: Fanout) -> None:
        self._app, self._services, self._fanout = app, services, fanout
        self.workers = 0
        """Number of workers on the stream: those that answer or are about to."""
        self.changed: Callable[[], None] = lambda: None
        """Called when ``workers`` changes."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
        elif scope["path"] == STREAM:
            await self._stream(scope, receive, send)
        else:
            await self._app(peer_of(scope), receive, send)

    async def _stream(self, scope: Scope, receive: Receive, send: Send) -> None:
        self.workers += 1
        self.changed()
        try:
            await EventStream(self._services, self._fanout)(scope, receive, send)
        finally:
            self.workers -= 1
            self.changed()


class Upstream:
    """Feeds the worker's fan-out from the link process. If the stream breaks, every listener is closed; clients
    reconnect and receive what they missed."""

    def __init__(self, path: Path, fanout: Fanout) -> None:
        self._path, self._fanout = str(path), fanout
        self._first = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Start reading, and wait for the first state."""
        self._task = asyncio.create_task(self._run())
        await self._first.wait()

    async def stop(self) -> None:
        """Stop reading."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    async def _run(self) -> None:
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError):
                await self._read()
            self._fanout.hang_up()
            await asyncio.sleep(AGAIN_S)

    async def _read(self) -> None:
        reader, writer = await asyncio.open_unix_connection(self._path, limit=LONGEST_MESSAGE)
        try:
            # HTTP/1.0 has no chunked encoding: the response is read as sent until the connection closes.
            writer.write(f"GET {STREAM} HTTP/1.0\r\nHost: localhost\r\n\r\n".encode())
            await reader.readuntil(b"\r\n\r\n")
            while True:
                self._fanout.spread(received(await reader.readuntil(b"\n\n")))
                if self._fanout.newest is not None:
                    self._first.set()
        finally:
            writer.close()


def received(block: bytes) -> list[Wire]:
    """Return the message in a block written by the link process; empty for a comment."""
    head, _, _ = block.partition(b"\n")
    if not head.startswith(b"event: "):
        return []
    topic = head[len(b"event: ") :].decode()
    _, mark, number = block.rstrip(b"\n").rpartition(b"\nid: ")
    return [Wire(topic, block, int(number) if mark and topic == "event" else None)]
