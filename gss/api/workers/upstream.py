"""The one stream between the link process and a worker, and the private door it comes through."""

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
    """What the link process serves on its Unix socket: the application for those whom a worker speaks for, and the stream for the
    workers themselves. Nobody else can open the socket."""

    def __init__(self, app: ASGIApp, services: Services, fanout: Fanout) -> None:
        self._app, self._services, self._fanout = app, services, fanout
        self.workers = 0
        """How many take the stream: they answer, or are about to."""
        self.changed: Callable[[], None] = lambda: None
        """Called when that number changed."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request."""
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
    """Keeps the worker's fan-out fed. When the stream breaks every listener is let go: he comes back and gets what he missed."""

    def __init__(self, path: Path, fanout: Fanout) -> None:
        self._path, self._fanout = str(path), fanout
        self._first = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> None:
        """Begin, and wait for the first state."""
        self._task = asyncio.create_task(self._run())
        await self._first.wait()

    async def stop(self) -> None:
        """End."""
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
            # HTTP/1.0: the answer comes without pieces of its own, as long as the connection lasts.
            writer.write(f"GET {STREAM} HTTP/1.0\r\nHost: localhost\r\n\r\n".encode())
            await reader.readuntil(b"\r\n\r\n")
            while True:
                self._fanout.spread(received(await reader.readuntil(b"\n\n")))
                if self._fanout.newest is not None:
                    self._first.set()
        finally:
            writer.close()


def received(block: bytes) -> list[Wire]:
    """The message in a block as the link process wrote it; none in a comment."""
    head, _, _ = block.partition(b"\n")
    if not head.startswith(b"event: "):
        return []
    topic = head[len(b"event: ") :].decode()
    _, mark, number = block.rstrip(b"\n").rpartition(b"\nid: ")
    return [Wire(topic, block, int(number) if mark and topic == "event" else None)]
