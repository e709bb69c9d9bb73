"""An API worker process: accepts on the shared socket, answers from the database, forwards the rest to the link process.

Started by :mod:`gss.api.workers.crew` as ``python -m gss.api.workers.worker``. Standard input brings one line of JSON when the link
process is ready, and its end is the end of the link process: then the worker ends too.
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
    """Load, wait for the word, serve until told to stop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to the link process, which ends us in order
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
        """Ends the event streams as soon as a signal comes."""

        def handle_exit(self, sig: int, frame: FrameType | None) -> None:
            app.state.fanout.close()
            super().handle_exit(sig, frame)

    options = uvicorn_options(order.settings, connections)
    config = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=GRACE_S, **options)
    threading.Thread(target=_end_with_parent, name="parent", daemon=True).start()
    with contextlib.suppress(KeyboardInterrupt):
        Server(config).run(sockets=[listener])


def _end_with_parent() -> None:
    """The link process is gone however it ended: stop at once, so that the port and the data folder are free."""
    sys.stdin.read()
    threading.Timer(END_WITHIN_S, os._exit, (1,)).start()
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    main()
