"""The link process behind API workers: owns the line, serves a private socket and supervises the workers."""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import tempfile
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType

import uvicorn
from fastapi import FastAPI

from gss.api.connections.admission import Connections
from gss.api.serving import uvicorn_options
from gss.api.stopping import StopSignals, begin_stop
from gss.api.workers.fallback_server import FallbackServer
from gss.api.workers.private_app import PrivateApp
from gss.api.workers.supervisor import Supervisor, no_obstacle
from gss.api.workers.worker import serve_worker
from gss.domain.errors import GssError
from gss.operations.events import EventBus
from gss.settings import Settings
from gss.wiring.services import Services

log = logging.getLogger("gss.workers")
GRACE_S = 3
PRIVATE_BACKLOG = 512
NAME = "link"


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
    # mode 0700; the path of a Unix socket has a length limit
    with tempfile.TemporaryDirectory(prefix="gss-") as folder:
        path = Path(folder) / NAME
        worker = partial(serve_worker, settings.model_dump_json(), NAME, path, listener)
        targets = {f"API worker {k + 1}": worker for k in range(settings.workers)}
        supervisor = Supervisor(targets, partial(record, services.base.bus), no_obstacle)
        fallback_server = FallbackServer(app, listener, connections, uvicorn_options(settings, connections))
        config = uvicorn.Config(
            PrivateApp(app, services, app.state.broadcaster, fallback_server.worker),
            uds=str(path),
            log_level="warning",
            timeout_graceful_shutdown=GRACE_S,
            backlog=PRIVATE_BACKLOG,
            server_header=False,
            proxy_headers=False,
        )
        server = LinkServer(config, services.announce_stop, supervisor, fallback_server)
        signals.attach(server)
        try:
            supervisor.start()
            server.run()
        finally:
            supervisor.stop()


def record(bus: EventBus, text: str) -> None:
    """Record the end of a process as an event; write it to the log if the store is down."""
    try:
        bus.record("server", "warning", text)
    except GssError:  # the store is down; supervision must continue without the record
        log.exception("not recorded: %s", text)


class LinkServer(uvicorn.Server):
    """Server that stops only after the workers, so that no request is aborted."""

    def __init__(
        self,
        config: uvicorn.Config,
        on_stop: Callable[[], None],
        supervisor: Supervisor,
        fallback_server: FallbackServer,
    ) -> None:
        super().__init__(config)
        self._on_stop, self._supervisor, self._fallback_server = on_stop, supervisor, fallback_server
        self._stop_thread: threading.Thread | None = None

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start serving on the private socket, and on the public socket while no worker is running."""
        await super().startup(sockets)
        if self.started:
            os.chmod(str(self.config.uds), 0o600)
            self._loop = asyncio.get_running_loop()
            self._fallback_task = self._loop.create_task(self._fallback_server.run(self.server_state))

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Stop gracefully on the first signal, immediately on the second."""
        if self._stop_thread is not None:
            super().handle_exit(signal.SIGINT, frame)
            return
        begin_stop(self._on_stop)
        self._stop_thread = threading.Thread(target=self._stop, args=(sig, frame), name="leave", daemon=True)
        self._stop_thread.start()

    def _stop(self, sig: int, frame: FrameType | None) -> None:
        if self.started:
            self._loop.call_soon_threadsafe(self._fallback_task.cancel)
        self._supervisor.stop()
        super().handle_exit(sig, frame)
