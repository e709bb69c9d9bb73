"""The link process behind API workers: serves a private socket, supervises the workers and replaces them if all are down."""

from __future__ import annotations

import asyncio
import signal
import socket
import threading
from types import FrameType

import uvicorn
from fastapi import FastAPI

from gss.api.connections.admission import Connections
from gss.api.serving import uvicorn_options
from gss.api.stopping import StopSignals, end_in_time, say_stopping
from gss.api.workers.crew import PRIVATE_BACKLOG, Crew, Order, private_socket
from gss.api.workers.stand_in import StandIn
from gss.api.workers.upstream import PrivateDoor
from gss.settings import Settings
from gss.wiring import Services

GRACE_S = 3


def serve_behind_workers(
    app: FastAPI,
    services: Services,
    settings: Settings,
    listener: socket.socket,
    connections: Connections,
    signals: StopSignals,
) -> None:
    """Serve until interrupted. ``listener``: the public socket, which the workers share; ``connections``: connection
    counter of this process for the public socket."""
    with private_socket() as (private, path):
        order = Order(settings, str(path), listener.fileno())

        def tell(severity: str, text: str) -> None:
            services.bus.record("server", severity, text)

        crew = Crew(order, settings.workers, tell)
        services.workers = crew.states
        door = PrivateDoor(app, services, app.state.fanout)
        config = uvicorn.Config(
            door,
            log_level="warning",
            timeout_graceful_shutdown=GRACE_S,
            backlog=PRIVATE_BACKLOG,
            server_header=False,
            proxy_headers=False,
        )
        try:
            stand_in = StandIn(app, listener, door, connections, uvicorn_options(settings, connections))
            server = LinkServer(config, services, crew, stand_in)
            signals.attach(server)
            server.run(sockets=[private])
        finally:
            crew.stop()


class LinkServer(uvicorn.Server):
    """Server that starts the workers once it serves, and stops only after the workers, so that no request is cut off."""

    def __init__(self, config: uvicorn.Config, services: Services, crew: Crew, stand_in: StandIn) -> None:
        super().__init__(config)
        self._services, self._crew, self._stand_in = services, crew, stand_in
        self._leaving: threading.Thread | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start serving, then start the workers on the public socket."""
        await super().startup(sockets)
        if self.started:
            self._loop = asyncio.get_running_loop()
            await self._stand_in.watch(self.server_state)
            self._crew.go()

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop in order on the first signal, at once on the second."""
        if self._leaving is not None:
            super().handle_exit(signal.SIGINT, frame)
            return
        say_stopping()
        end_in_time()
        self._services.announce_stop()
        self._leaving = threading.Thread(target=self._leave, args=(sig, frame), name="leave", daemon=True)
        self._leaving.start()

    def _leave(self, sig: int, frame: FrameType | None) -> None:
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._stand_in.end)
        self._crew.stop()
        super().handle_exit(sig, frame)
