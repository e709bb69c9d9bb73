"""Serve the public socket from the link process while no API worker is alive, so that ABORT always gets through."""

from __future__ import annotations

import asyncio
import os
import socket
from typing import Any

import uvicorn
from starlette.types import ASGIApp

from gss.api.connections.admission import Connections
from gss.api.connections.limited_listener import LimitedListener
from gss.api.workers.upstream import PrivateDoor


class StandIn:
    """Accepts on the public socket from when the last worker ends until the first one is back.

    A worker opens its stream before it starts to answer; the operating system closes that stream when the process ends,
    whatever the cause. Requests on connections accepted here are completed even if a worker is back.
    """

    def __init__(
        self,
        app: ASGIApp,
        listener: socket.socket,
        door: PrivateDoor,
        connections: Connections,
        options: dict[str, Any],
    ) -> None:
        self._config = uvicorn.Config(app, lifespan="off", log_level="warning", **options)
        self._listener, self._door, self._connections = listener, door, connections
        self._open: asyncio.Server | None = None
        self._over = False
        self._task: asyncio.Task[None] | None = None

    async def watch(self, state: uvicorn.server.ServerState) -> None:
        """Start watching, on this event loop. ``state``: of the link process's server, which closes these connections
        with its own."""
        self._config.load()
        self._state, self._turn = state, asyncio.Lock()
        self._door.changed = self._changed
        await self._settle()

    def end(self) -> None:
        """Stop accepting because the server stops. Call on the event loop."""
        self._over = True
        self._changed()

    def _changed(self) -> None:
        self._task = asyncio.get_running_loop().create_task(self._settle())

    async def _settle(self) -> None:
        async with self._turn:
            wanted = self._door.workers == 0 and not self._over
            if wanted and self._open is None:
                loop = asyncio.get_running_loop()
                shared = LimitedListener(
                    self._connections, os.dup(self._listener.fileno())
                )  # closing it leaves the workers' descriptor open
                self._open = await loop.create_server(
                    self._protocol, sock=shared, ssl=self._config.ssl, backlog=self._config.backlog
                )
            elif not wanted and self._open is not None:
                self._open.close()
                self._open = None

    def _protocol(self) -> asyncio.Protocol:
        made: asyncio.Protocol = self._config.http_protocol_class(  # type: ignore[call-arg]  # uvicorn only says that it is one
            config=self._config, server_state=self._state, app_state={}
        )
        return made
