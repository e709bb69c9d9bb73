"""How the server is reached: what uvicorn is told, and the address that is printed at the start."""

from __future__ import annotations

import contextlib
import os
from typing import Any

from gss.api.guard.perimeter import public_names
from gss.operations.accounts.users import SETUP_LASTS, Link
from gss.settings import Settings

PATIENT = "gss.api.patience:PatientHttp"


def uvicorn_options(settings: Settings) -> dict[str, Any]:
    """An end of patience, TLS, and nothing of X-Forwarded-*: uvicorn would believe any program of this machine, the perimeter knows
    whom to believe."""
    options: dict[str, Any] = {"http": PATIENT, "proxy_headers": False, "server_header": False}
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


def say_stopping() -> None:
    """At once, for whoever pressed Ctrl-C. Written past Python's own streams, which a signal may have interrupted."""
    with contextlib.suppress(OSError):
        os.write(2, "\nstopping …\n".encode())


def greeting(settings: Settings, port: int, link: Link | None) -> str:
    """The one line of the start: where to go; while there is no user yet, with the link that makes the first one."""
    address = address_of(settings, port)
    if link is None:
        return f"GSS is at {address}"
    minutes = int(SETUP_LASTS.total_seconds() // 60)
    return f"GSS has no user yet. Within {minutes} minutes make the first one at {address}/setup#{link.key}"
