"""Handle requests below ``/units/NAME``: forward data requests to the unit's process, and handle all others in the
front process."""

from __future__ import annotations

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gss.api.errors import problem
from gss.api.guard.bodies import MAX_BODY_BYTES, bad_body
from gss.api.guard.route_table import GUARDED, is_open
from gss.api.units.fleet import NO_UNIT, Fleet

UNITS = "/units/"
SHARED = (
    "/api/session",
    "/api/setup",
    "/api/password-links",
    "/api/users",
    "/api/sessions",
    "/api/tokens",
    "/api/fleet",
)
"""Routes that the front process handles: accounts, which all units share, and the fleet."""


class UnitGateway:
    """Outermost application of the front process. The unit's guard checks forwarded requests with the shared
    accounts."""

    def __init__(self, app: ASGIApp, fleet: Fleet) -> None:
        self._app, self._fleet = app, fleet

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http" or not scope["path"].startswith(UNITS):
            await self._app(scope, receive, send)
            return
        name, _, inner_path = scope["path"].removeprefix(UNITS).partition("/")
        inner = {**scope, "path": f"/{inner_path}", "raw_path": _inner(scope, name)}
        if not _is_below(inner["path"], GUARDED) or _is_below(inner["path"], SHARED):
            await self._app(inner, receive, send)
        else:
            await self._forward(name, inner, receive, send)

    async def _forward(self, name: str, scope: Scope, receive: Receive, send: Send) -> None:
        client = self._fleet.client(name)
        if client is None:
            expected = f"one of {', '.join(self._fleet.names)}"
            await problem(404, NO_UNIT, expected, name[:80])(scope, receive, send)
            return
        too_large = bad_body(Headers(scope=scope), MAX_BODY_BYTES)
        if too_large is not None:
            await too_large(scope, receive, send)
            return
        connection = scope.get("state", {}).get("connection")

        async def send_and_mark(message: Message) -> None:
            is_authenticated = (
                message["type"] == "http.response.start" and message["status"] < 400 and not is_open(scope)
            )
            if connection is not None and is_authenticated:
                connection.mark_authenticated()
            await send(message)

        await client.forward(scope, receive, send_and_mark)


def _inner(scope: Scope, name: str) -> bytes:
    """Return the raw path of the request without the prefix of the unit."""
    raw: bytes = scope.get("raw_path") or scope["path"].encode()
    return raw[len(UNITS) + raw[len(UNITS) :].find(b"/") :] if b"/" in raw[len(UNITS) :] else b"/"


def _is_below(path: str, roots: tuple[str, ...]) -> bool:
    return any(path == root or path.startswith(f"{root}/") for root in roots)
