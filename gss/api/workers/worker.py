"""API worker process: accepts on the shared socket, answers from the database, forwards other requests to the link process.

Started by :mod:`gss.api.workers.crew` as ``python -m gss.api.workers.worker``. Standard input delivers one line of JSON
when the link process is ready; end of file means that the link process has ended, and the worker then stops too.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from pathlib import Path
from types import FrameType

END_WITHIN_S = 5.0
GRACE_S = 3


def main() -> None:
    """Load, wait for the start parameters, serve until stopped."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the link process, which stops the workers in order
    import uvicorn

    from gss.api.app import create_app
    from gss.api.connections.limited_listener import LimitedListener
    from gss.api.serving import open_connections, uvicorn_options
    from gss.api.workers.crew import Order
    from gss.wiring import build

    told = sys.stdin.readline()
    if not told:
        return
    order = Order.from_json(told)
    services = build(order.settings, ready=True)
    app = create_app(services, behind=Path(order.link))
    connections = open_connections(order.settings)
    listener = LimitedListener(connections, order.listener)

    class Server(uvicorn.Server):
        """Ends the event streams as soon as a signal arrives."""

        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            app.state.fanout.close()
            super().handle_exit(sig, frame)

    options = uvicorn_options(order.settings, connections)
    config = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=GRACE_S, **options)
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        Server(config).run(sockets=[listener])


def _end_with_parent() -> None:
    """Stop when the link process ends, however it ended, to free the port and the data folder."""
    sys.stdin.read()
    threading.Timer(END_WITHIN_S, os._exit, (1,)).start()
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    main()
