"""Limits on the request body, checked from Content-Length before the body is read."""

from __future__ import annotations

from fastapi import params
from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope

from gss.api.errors import problem

MAX_BODY_BYTES = 80 << 20
"""Limit for routes that accept a file upload. Uploads are written to disk in chunks."""
MAX_JSON_BYTES, MAX_LARGE_JSON_BYTES = 1 << 20, 2 << 20
"""Limits for all other bodies, which are parsed in one step that blocks the event loop."""
LARGE_JSON_ROUTES = ("/api/campaigns/reprocess",)
"""Routes with the larger limit: a campaign lists up to 100 000 frames."""
MAX_OPEN_BODY_BYTES = 64 << 10
"""Limit for routes that need no sign-in."""


def ambiguous_length(headers: Headers) -> Response | None:
    """Return a 400 response that closes the connection if a request declares its length twice, else None. A proxy could
    assume a different end of the request, and treat the bytes after this end as the request of another user (RFC 9112
    §6.1)."""
    if "transfer-encoding" in headers and "content-length" in headers:
        return _closing(
            problem(400, "the request declares its length twice", "Content-Length without Transfer-Encoding")
        )
    return None


def _closing(response: Response) -> Response:
    """Close the connection after the response, because the remainder of the request is not read."""
    response.headers["Connection"] = "close"
    return response


def bad_body(headers: Headers, limit_bytes: int) -> Response | None:
    """Return a 411 response if the length is not declared, a 413 response if it exceeds ``limit_bytes``, else None."""
    if "transfer-encoding" in headers:
        return _closing(problem(411, "the request has no Content-Length", "a Content-Length"))
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit()) or int(length[:20]) > limit_bytes:
        return problem(413, "the request is too large", f"at most {limit_bytes >> 10} KiB", f"{length[:40]} bytes")
    return None


def max_body_bytes(route: APIRoute | None, scope: Scope, headers: Headers) -> int:
    """Return the body limit of a route in bytes. ``route``: None if no route matches."""
    form = headers.get("content-type", "").lower().startswith("multipart/form-data")
    if route is not None and form and _accepts_file(route):
        return MAX_BODY_BYTES
    return MAX_LARGE_JSON_BYTES if scope["path"] in LARGE_JSON_ROUTES else MAX_JSON_BYTES


def _accepts_file(route: APIRoute) -> bool:
    return any(isinstance(part.field_info, params.Form) for part in route.dependant.body_params)
