"""Limits on the request body, checked from Content-Length before the body is read."""

from __future__ import annotations

from fastapi import params
from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope

from gss.api.errors import problem

MAX_BODY_BYTES = 80 << 20
"""Limit for routes that accept a file upload; uploads are written to disk in chunks."""
WORDS_BYTES, MORE_WORDS_BYTES = 1 << 20, 2 << 20
"""Limits for all other bodies: they are parsed in one step, which blocks the event loop."""
MORE_WORDS = ("/api/campaigns/reprocess",)
"""Routes with the larger limit: a campaign lists up to 100 000 frames."""
SMALL_BODY_BYTES = 64 << 10
"""Limit for routes open without sign-in."""


def ambiguous_length(headers: Headers) -> Response | None:
    """Return a 400 response if a request declares its length twice, else None. A proxy could see another end of the request, and
    take what follows for a request of another user (RFC 9112 §6.1); the connection is closed."""
    if "transfer-encoding" in headers and "content-length" in headers:
        return _closing(
            problem(400, "the request declares its length twice", "Content-Length without Transfer-Encoding")
        )
    return None


def _closing(response: Response) -> Response:
    """Close the connection after a response, because the rest of the request is not read."""
    response.headers["Connection"] = "close"
    return response


def bad_body(headers: Headers, most_bytes: int) -> Response | None:
    """Return a 411 response if the length is not declared, a 413 response if it exceeds ``most_bytes``, else None."""
    if "transfer-encoding" in headers:
        return _closing(problem(411, "the request has no Content-Length", "a Content-Length"))
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit()) or int(length[:20]) > most_bytes:
        return problem(413, "the request is too large", f"at most {most_bytes >> 10} KiB", f"{length[:40]} bytes")
    return None


def most_bytes(route: APIRoute | None, scope: Scope, headers: Headers) -> int:
    """Return the body limit of a route in bytes. ``route``: None if no route matches."""
    form = headers.get("content-type", "").lower().startswith("multipart/form-data")
    if route is not None and form and _takes_file(route):
        return MAX_BODY_BYTES
    return MORE_WORDS_BYTES if scope["path"] in MORE_WORDS else WORDS_BYTES


def _takes_file(route: APIRoute) -> bool:
    return any(isinstance(part.field_info, params.Form) for part in route.dependant.body_params)
