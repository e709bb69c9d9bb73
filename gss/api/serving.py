"""How the server is reached: uvicorn's options, the limits on connections, and the address that is printed at the start."""

from __future__ import annotations

import functools
from typing import Any

from gss.api.connections.admission import ConnectionLimits, Connections
from gss.api.connections.limited_listener import raise_descriptor_limit
from gss.api.connections.log_throttle import throttle_logs
from gss.api.connections.timed_http import HttpTimeouts, TimedHttp
from gss.api.guard.perimeter import public_names
from gss.operations.accounts.users import SETUP_LASTS, Link
from gss.settings import Settings

TIMEOUTS = HttpTimeouts()
BACKLOG = 1024
"""Connections that wait to be accepted. A client that finds no place tries again a second later: too late for ABORT in a burst."""


def open_connections(settings: Settings) -> Connections:
    """Raise the limit of open files and count this process's connections; its logs are throttled from now on."""
    throttle_logs()
    descriptors = raise_descriptor_limit()
    limits = ConnectionLimits.within(settings.connections_most, descriptors, behind_proxy=settings.behind_proxy)
    return Connections(limits)


def uvicorn_options(settings: Settings, connections: Connections, timeouts: HttpTimeouts = TIMEOUTS) -> dict[str, Any]:
    """Limited connections, TLS, no WebSocket, and no X-Forwarded-*: uvicorn would believe any program of this machine, the
    perimeter knows which proxy to believe."""
    options: dict[str, Any] = {
        "http": functools.partial(TimedHttp, connections=connections, timeouts=timeouts),
        "loop": "asyncio",  # it accepts through our listener
        "ws": "none",
        "backlog": BACKLOG,
        "proxy_headers": False,
        "server_header": False,
    }
    if settings.tls_certificate:
        options |= {"ssl_certfile": settings.tls_certificate, "ssl_keyfile": settings.tls_key}
    return options


def address_of(settings: Settings, port: int) -> str:
    """What a browser is given."""
    names = public_names(settings)
    if settings.behind_proxy:
        return f"https://{names[0]}"
    host = names[0] if settings.tls_certificate and names else settings.host
    host = f"[{host}]" if ":" in host else host
    return f"{'https' if settings.tls_certificate else 'http'}://{host}:{port}"


def greeting(settings: Settings, port: int, link: Link | None) -> str:
    """The one line of the start: where to go; while there is no user yet, with the link that makes the first one."""
    address = address_of(settings, port)
    if link is None:
        return f"GSS is at {address}"
    minutes = int(SETUP_LASTS.total_seconds() // 60)
    return f"GSS has no user yet. Within {minutes} minutes make the first one at {address}/setup#{link.key}"
