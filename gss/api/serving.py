"""uvicorn's options, the connection limits, and the address printed at startup."""

from __future__ import annotations

import ctypes
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
"""Length of the accept queue. If the queue is full, a client retries after one second, which is too late for ABORT."""

M_MMAP_THRESHOLD, M_ARENA_MAX = -3, -8
"""Options of glibc's ``mallopt``."""
LARGE_BYTES, ARENAS = 128 << 10, 2


def open_connections(settings: Settings) -> Connections:
    """Raise the open-file limit, throttle the logs, limit the unused memory of this process, and return its connection
    counter."""
    throttle_logs()
    _return_freed_memory()
    descriptors = raise_descriptor_limit()
    limits = ConnectionLimits.within(settings.connections_most, descriptors, behind_proxy=settings.behind_proxy)
    return Connections(limits)


def _return_freed_memory() -> None:
    """Let glibc return every freed block of at least LARGE_BYTES to the operating system. Otherwise glibc raises this limit
    to the size of the largest freed array, and keeps 15 MB after frames of five cameras were solved."""
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(M_MMAP_THRESHOLD, LARGE_BYTES)
        library.mallopt(M_ARENA_MAX, ARENAS)


def uvicorn_options(settings: Settings, connections: Connections, timeouts: HttpTimeouts = TIMEOUTS) -> dict[str, Any]:
    """Return uvicorn's options: limited connections, TLS, no WebSocket. X-Forwarded-* is disabled because uvicorn would
    trust any local program. The perimeter checks for trusted proxies."""
    options: dict[str, Any] = {
        "http": functools.partial(TimedHttp, connections=connections, timeouts=timeouts),
        "loop": "asyncio",  # this event loop calls accept of the LimitedListener
        "ws": "none",
        "backlog": BACKLOG,
        "proxy_headers": False,
        "server_header": False,
    }
    if settings.tls_certificate:
        options |= {"ssl_certfile": settings.tls_certificate, "ssl_keyfile": settings.tls_key}
    return options


def address_of(settings: Settings, port: int) -> str:
    """Return the URL to open in a browser."""
    names = public_names(settings)
    if settings.behind_proxy:
        return f"https://{names[0]}"
    host = names[0] if settings.tls_certificate and names else settings.host
    host = f"[{host}]" if ":" in host else host
    return f"{'https' if settings.tls_certificate else 'http'}://{host}:{port}"


def greeting(settings: Settings, port: int, link: Link | None) -> str:
    """Return the startup message: the server's URL, or the setup link if no user exists."""
    address = address_of(settings, port)
    if link is None:
        return f"GSS is at {address}"
    minutes = int(SETUP_LASTS.total_seconds() // 60)
    return f"No user exists yet. Create the first one within {minutes} minutes at {address}/setup#{link.key}"
