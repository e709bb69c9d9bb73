"""Serve the public socket from the link process while no API worker is alive, so that ABORT is always accepted."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import uvicorn
from starlette.types import ASGIApp

from gss.api.connections.admission import Connections
from gss.api.connections.limited_listener import LimitedListener


class FallbackServer:
    """Server that accepts on the public socket while no worker runs.

    A worker opens its event stream before it handles requests; the operating system closes the stream when the worker
    ends for any reason. Requests on connections accepted here are completed even if a worker has started again. All
    methods run on the event loop.
    """

    def __init__(
        self, app: ASGIApp, listener: socket.socket, connections: Connections, options: dict[str, Any]
    ) -> None:
        self._config = uvicorn.Config(app, lifespan="off", log_level="warning", **options)
        self._listener, self._connections = listener, connections
        self._workers = 0
        self._changed = asyncio.Event()

    @contextmanager
    def worker(self) -> Iterator[None]:
        """Count a worker while its stream is open."""
        self._workers += 1
        self._changed.set()
        try:
            yield
        finally:
            self._workers -= 1
            self._changed.set()

    async def run(self, state: uvicorn.server.ServerState) -> None:
        """Accept connections while no worker runs, until cancelled. ``state``: state of the link process's server,
        which closes these connections together with those of the workers."""
        self._config.load()
        server: asyncio.Server | None = None
        try:
            while True:
                if self._workers == 0 and server is None:
                    server = await self._accept(state)
                elif self._workers > 0 and server is not None:
                    server.close()
                    server = None
                self._changed.clear()
                await self._changed.wait()
        finally:
            if server is not None:
                server.close()

    async def _accept(self, state: uvicorn.server.ServerState) -> asyncio.Server:
        def protocol() -> asyncio.Protocol:
            connection: asyncio.Protocol = self._config.http_protocol_class(  # type: ignore[call-arg]  # uvicorn declares only asyncio.Protocol
                config=self._config, server_state=state, app_state={}
            )
            return connection

        # The listener uses a duplicate of the descriptor, because the workers' descriptor must stay open when the
        # listener is closed.
        shared = LimitedListener(self._connections, os.dup(self._listener.fileno()))
        return await asyncio.get_running_loop().create_server(
            protocol, sock=shared, ssl=self._config.ssl, backlog=self._config.backlog
        )
