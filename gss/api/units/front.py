"""Front process of a server with several units: serves accounts, pages and the fleet, and forwards requests to the
units."""

from __future__ import annotations

import socket
import tempfile
import threading
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import uvicorn

from gss.api.app import create_app
from gss.api.connections.admission import Connections
from gss.api.connections.limited_listener import LimitedListener
from gss.api.serving import uvicorn_options
from gss.api.stopping import StoppableServer, StopSignals, begin_stop
from gss.api.units.fleet import Fleet, process_name
from gss.api.units.unit_gateway import UnitGateway
from gss.api.units.unit_process import serve_unit
from gss.api.units.unit_spec import UnitSpec, unit_settings
from gss.api.workers.link_process import record
from gss.api.workers.supervisor import Supervisor
from gss.domain.errors import GssError
from gss.instruments.registry import Registry
from gss.operations.clock import monotonic_s
from gss.settings import Settings
from gss.wiring.services import Services

GRACE_S = 3


def serve_units(
    units: tuple[UnitSpec, ...],
    services: Services,
    settings: Settings,
    listener: socket.socket,
    connections: Connections,
    signals: StopSignals,
) -> None:
    """Serve until interrupted. ``services``: services of the front process, which has no line."""
    with tempfile.TemporaryDirectory(
        prefix="gss-"
    ) as folder:  # mode 0700; the path of a Unix socket has a length limit
        paths = {unit.name: Path(folder) / str(k) for k, unit in enumerate(units)}
        targets = {
            process_name(unit): partial(
                serve_unit, unit_settings(settings, unit, k).model_dump_json(), paths[unit.name]
            )
            for k, unit in enumerate(units)
        }
        packages = {process_name(unit): unit.instrument for unit in units}
        fault = partial(_package_fault, services.base.instruments, packages)
        supervisor = Supervisor(targets, partial(record, services.base.bus), fault)
        fleet = Fleet(units, paths, supervisor, services.heads.watch.take, monotonic_s)
        app = UnitGateway(create_app(services, fleet=fleet), fleet)

        def stop() -> None:
            begin_stop(services.announce_stop)
            # The units must stop at the same time as this server, because their event streams end only with their
            # processes.
            threading.Thread(target=supervisor.stop, name="stop units", daemon=True).start()

        options = uvicorn_options(settings, connections)
        config = uvicorn.Config(app, log_level="warning", timeout_graceful_shutdown=GRACE_S, **options)
        server = StoppableServer(config, stop)
        signals.attach(server)
        services.heads.watch.start()
        try:
            server.run(sockets=[LimitedListener(connections, listener.detach())])
        finally:
            supervisor.stop()


def _package_fault(instruments: Registry, packages: Mapping[str, str], name: str) -> str:
    """Return why the package of a unit is invalid, or "". ``packages``: instrument by process name."""
    try:
        instruments.get(packages[name])
    except GssError as error:
        return str(error)
    return ""
