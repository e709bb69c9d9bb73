"""How large a request may be: told by its length, before it is read."""

from __future__ import annotations

from fastapi import params
from fastapi.routing import APIRoute
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Scope

from gss.api.errors import problem

MAX_BODY_BYTES = 80 << 20
"""Of a file that is handed in, for the routes that take one. It goes to the disk in pieces."""
WORDS_BYTES, MORE_WORDS_BYTES = 1 << 20, 2 << 20
"""Of everything else: it is parsed in one piece, and nothing else is answered meanwhile."""
MORE_WORDS = ("/api/campaigns/reprocess",)
"""A campaign names up to 100 000 frames."""
SMALL_BODY_BYTES = 64 << 10
"""Of what nobody in particular may send."""


def bad_body(headers: Headers, most_bytes: int) -> Response | None:
    """The refusal of a body of more bytes, or of nobody knows how many; None where it may be read."""
    if "transfer-encoding" in headers:
        return problem(411, "the request does not say how long it is", "a Content-Length")
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit()) or int(length[:20]) > most_bytes:
        return problem(413, "the request is too large", f"at most {most_bytes >> 10} KiB", f"{length[:40]} bytes")
    return None


def most_bytes(route: APIRoute | None, scope: Scope, headers: Headers) -> int:
    """How many a route can have a use for; None is a route that is not there."""
    form = headers.get("content-type", "").lower().startswith("multipart/form-data")
    if route is not None and form and _takes_file(route):
        return MAX_BODY_BYTES
    return MORE_WORDS_BYTES if scope["path"] in MORE_WORDS else WORDS_BYTES


def _takes_file(route: APIRoute) -> bool:
    return any(isinstance(part.field_info, params.Form) for part in route.dependant.body_params)
