"""``gss serve``: run the server, optionally with a simulated sensor."""

from __future__ import annotations

import argparse
import contextlib
import socket
import sys
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from gss.api.units.unit_spec import UnitSpec
    from gss.cli import Commands
    from gss.operations.line.simulated_sensor import SimulatedSensor
    from gss.settings import Settings


def register(subparsers: Commands) -> None:
    """Add the command."""
    parser = subparsers.add_parser("serve")
    parser.add_argument(
        "--host", help="address to listen on; an address other than loopback needs TLS or a proxy (GSS_HOST)"
    )
    parser.add_argument("--port", type=int, help="port of the console; 0 selects a free port (GSS_PORT)")
    parser.add_argument("--data", help="folder of database, frames and captures (GSS_DATA)")
    parser.add_argument(
        "--device",
        help="port of the sensor: a tty, or a socket://, rfc2217://, udp://, zmq:// or can:// URL (GSS_DEVICE)",
    )
    parser.add_argument("--simulator", metavar="PROFILE", help="start a simulated sensor and open it (GSS_SIMULATOR)")
    parser.add_argument(
        "--workers", type=int, help="API worker processes beside the process that owns the line (GSS_WORKERS)"
    )
    parser.add_argument(
        "--unit",
        action="append",
        metavar="NAME=INSTRUMENT@ADDRESS",
        help="serve several units, one process each; repeat it for each unit; the address simulator starts a simulated sensor "
        "(GSS_UNITS)",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Serve until interrupted."""
    from gss.cli.lean_numpy import hide_build_tools

    hide_build_tools()
    from gss.api.guard.perimeter import check_exposure
    from gss.api.simulated import start_simulator
    from gss.operations.folder_lock import folder_lock, private_files
    from gss.settings import Settings
    from gss.store.engine import sole_server

    names = ("host", "port", "data", "device", "simulator", "workers")
    overrides = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    if arguments.unit:
        overrides["units"] = ",".join(arguments.unit)
    settings = Settings(**overrides)
    check_exposure(settings)
    units = _units(settings)
    workers = f" with API workers ({settings.workers})" if settings.workers else ""
    print(f"starting{workers} …", file=sys.stderr, flush=True)
    with contextlib.ExitStack() as stack:
        stack.enter_context(private_files())
        stack.enter_context(folder_lock(settings.data))
        stack.enter_context(sole_server(settings.database_url))
        listener = stack.enter_context(_listen(settings.host, settings.port))
        sensor = None
        if settings.simulator:
            sensor = stack.enter_context(start_simulator(settings))
        _serve(listener, settings, sensor, units)
    return 0


def _units(settings: Settings) -> tuple[UnitSpec, ...]:
    """Return the units of the settings; () for a server with a single unnamed unit."""
    if not settings.units:
        return ()
    from gss.api.units.unit_spec import check_combination, parse_units
    from gss.instruments.registry import Registry

    check_combination(settings)
    return parse_units(settings.units, Registry(settings.instruments_folder))


def _serve(
    listener: socket.socket, settings: Settings, sensor: SimulatedSensor | None, units: tuple[UnitSpec, ...]
) -> None:
    """Load and run the server. The imports are inside the function because they take seconds. The simulator starts
    during this time."""
    import uvicorn

    from gss import garbage
    from gss.api.app import create_app
    from gss.api.connections.limited_listener import LimitedListener
    from gss.api.serving import greeting, open_connections, uvicorn_options
    from gss.api.stopping import StoppableServer, StopSignals, begin_stop
    from gss.wiring.build import build

    connections = open_connections(settings)
    services = build(settings if sensor is None else settings.model_copy(update={"device": sensor.url()}))
    if sensor is not None:
        sensor.watch(partial(services.base.bus.record, "link", "warning"))
        services.frames.frames.warm(settings.simulator)

    app = create_app(services) if not units else None
    garbage.collect_as_usual()
    port, signals = listener.getsockname()[1], StopSignals()
    print(greeting(settings, port, services.accounts.accounts.users.set_up_link()), flush=True)
    if app is None:
        from gss.api.units.front import serve_units

        serve_units(units, services, settings, listener, connections, signals)
        return
    if settings.workers:
        from gss.api.workers.link_process import serve_behind_workers

        serve_behind_workers(app, services, settings, listener, connections, signals)
        return

    config = uvicorn.Config(
        app, log_level="warning", timeout_graceful_shutdown=3, **uvicorn_options(settings, connections)
    )
    server = StoppableServer(config, partial(begin_stop, services.announce_stop))
    signals.attach(server)
    server.run(sockets=[LimitedListener(connections, listener.detach())])


def _listen(host: str, port: int) -> socket.socket:
    from gss.api.connections.limited_listener import prefer_requests
    from gss.domain.errors import Conflict

    listener = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        prefer_requests(listener)
        listener.listen(128)  # the operating system queues connections from now on
    except OSError as error:
        listener.close()
        raise Conflict(
            f"port {port} cannot be used", got=str(error), hint="choose another --port, or 0 for a free one"
        ) from None
    return listener
