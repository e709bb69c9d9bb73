"""API worker process: accepts on the shared socket, handles requests from the database, and forwards other requests to
the link process."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import socket
import threading
from pathlib import Path

from gss import garbage

STOP_WITHIN_S = 5.0
GRACE_S = 3


def serve_worker(settings_json: str, name: str, path: Path, listener: socket.socket) -> None:
    """Serve until stopped. ``name``, ``path``: the link process and its socket. The settings are JSON and the imports
    are inside the function, so that the new process ignores Ctrl-C before it loads modules; the link process stops the
    workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    garbage.collect_rarely()
    import uvicorn

    from gss.api.app import create_app
    from gss.api.connections.limited_listener import LimitedListener
    from gss.api.serving import open_connections, uvicorn_options
    from gss.api.stopping import StoppableServer
    from gss.api.workers.link_client import LinkProcessClient
    from gss.settings import Settings
    from gss.wiring.build import build

    settings = Settings(**json.loads(settings_json))
    app = create_app(build(settings, ready=True), behind=LinkProcessClient(name, path))
    connections = open_connections(settings)

    options = uvicorn_options(settings, connections)
    config = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=GRACE_S, **options)
    threading.Thread(target=stop_with_parent, name="parent", daemon=True).start()
    garbage.collect_as_usual()
    StoppableServer(config, app.state.broadcaster.close).run(sockets=[LimitedListener(connections, listener.detach())])


def stop_with_parent() -> None:
    """Stop when the parent process ends for any reason, to free the port and the data folder."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
    threading.Timer(STOP_WITHIN_S, os._exit, (1,)).start()
    os.kill(os.getpid(), signal.SIGTERM)
