"""Loopback only, same origin only, and a strict content policy, from the first day."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from urllib.parse import urlsplit

from fastapi import FastAPI, Request, Response

from gss.api.errors import problem
from gss.api.headers import HEADERS

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
MARK = "X-GSS"
MAX_BODY_BYTES = 80 << 20
LOCAL_NAMES = ("localhost", "127.0.0.1", "::1")


def install(app: FastAPI) -> None:
    """Refuse foreign hosts and origins and oversize bodies; add the headers to every answer."""

    @app.middleware("http")
    async def guard(request: Request, call_next: Callable[[Request], Awaitable[Response]]) -> Response:
        response = _refusal(request) or await call_next(request)
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response


def _host_name(address: str) -> str:
    """Host of an address; empty where it is none."""
    try:
        return urlsplit(address).hostname or ""
    except ValueError:
        return ""


def _refusal(request: Request) -> Response | None:
    host = _host_name(f"//{request.headers.get('host', '')}")
    if host not in LOCAL_NAMES:  # a foreign name that resolves to this machine (DNS rebinding)
        return problem(403, "unknown host name", "localhost or 127.0.0.1", host)
    origin = request.headers.get("origin")
    if origin is not None and (not _host_name(origin) or urlsplit(origin).netloc != request.headers.get("host")):
        return problem(403, "a page of another origin may not use this server", request.headers.get("host", ""), origin)
    if request.method not in SAFE_METHODS:
        if MARK not in request.headers:
            return problem(403, "a change needs the header X-GSS", "X-GSS: 1", hint="send the header X-GSS: 1")
        if "transfer-encoding" in request.headers:
            return problem(411, "the request does not say how long it is", "a Content-Length")
        length = request.headers.get("content-length", "0")
        if not length.isdigit() or int(length) > MAX_BODY_BYTES:
            return problem(413, "the request is too large", f"at most {MAX_BODY_BYTES >> 20} MiB", f"{length} bytes")
    return None
