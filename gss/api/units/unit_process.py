"""Process of one unit: owns its line and its data folder, and serves the front process on a private socket."""

from __future__ import annotations

import contextlib
import json
import logging
import signal
import sys
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gss import garbage

if TYPE_CHECKING:
    from gss.operations.line.simulated_sensor import SimulatedSensor
    from gss.settings import Settings

GRACE_S = 2
BACKLOG = 512


def reason_file(path: Path) -> Path:
    """Return the file in which a unit's process reports why it could not start. ``path``: path of its socket."""
    return path.with_suffix(".reason")


def serve_unit(settings_json: str, path: Path) -> None:
    """Serve until stopped. ``path``: path of the private socket. The settings are JSON and the imports are inside the
    function, so that the new process ignores Ctrl-C before it loads modules; the front process stops the units."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    garbage.collect_rarely()
    from gss.api.simulated import start_simulator
    from gss.api.workers.worker import stop_with_parent
    from gss.domain.errors import GssError
    from gss.operations.folder_lock import folder_lock
    from gss.settings import Settings
    from gss.store.engine import sole_server

    settings = Settings(**json.loads(settings_json))
    threading.Thread(target=stop_with_parent, name="parent", daemon=True).start()
    try:
        with contextlib.ExitStack() as stack:
            stack.enter_context(folder_lock(settings.data))
            stack.enter_context(sole_server(settings.database_url))
            sensor = stack.enter_context(start_simulator(settings)) if settings.simulator else None
            _serve(settings, path, sensor)
    except GssError as error:
        reason_file(path).write_text(str(error))
        logging.getLogger("gss.units").error("unit %s cannot start: %s", settings.data.name, error)
        sys.exit(1)


def _serve(settings: Settings, path: Path, sensor: SimulatedSensor | None) -> None:
    """Load and run the unit's server while its simulator starts."""
    import uvicorn

    from gss.api.app import create_app
    from gss.api.connections.log_throttle import throttle_logs
    from gss.api.stopping import StoppableServer, end_in_time
    from gss.api.workers.private_app import PrivateApp
    from gss.wiring.build import build

    throttle_logs()
    services = build(settings if sensor is None else settings.model_copy(update={"device": sensor.url()}))
    if sensor is not None:
        sensor.watch(partial(services.base.bus.record, "link", "warning"))
    app = create_app(services)

    def announce() -> None:
        end_in_time()
        services.announce_stop()

    path.unlink(missing_ok=True)  # left by a process that was killed
    reason_file(path).unlink(missing_ok=True)
    config = uvicorn.Config(
        PrivateApp(app, services, app.state.broadcaster),
        uds=str(path),
        log_level="warning",
        timeout_graceful_shutdown=GRACE_S,
        backlog=BACKLOG,
        server_header=False,
        proxy_headers=False,
    )
    garbage.collect_as_usual()
    StoppableServer(config, announce).run()
