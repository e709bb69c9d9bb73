"""Guard in front of all routes, which denies by default. It checks origin and identity before any route runs. Routes
(deps.need) and commands declare the permission that they need."""

from __future__ import annotations

import functools
import json

import anyio
from fastapi import FastAPI
from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from gss.api.connections.admission import Connection
from gss.api.deps import needs_of
from gss.api.errors import problem
from gss.api.guard.audit_log import AuditRecorder
from gss.api.guard.bodies import MAX_BODY_BYTES, MAX_OPEN_BODY_BYTES, ambiguous_length, bad_body, max_body_bytes
from gss.api.guard.credentials import Authenticator
from gss.api.guard.headers import HeaderWriter
from gss.api.guard.perimeter import Caller, Perimeter, Refusal
from gss.api.guard.route_table import RouteTable, is_change, is_guarded, is_health, is_open
from gss.domain.errors import NotPermitted
from gss.operations.accounts.permissions import VIEW
from gss.operations.clock import monotonic_s, utc_now
from gss.wiring.services import Services


def install(app: FastAPI) -> None:
    """Add the guard to the application."""
    services: Services = app.state.services
    app.add_middleware(Guard, services=services, routes=RouteTable(app))


class Guard:
    """Middleware: host, origin, size, identity, CSRF and permission, then the route, then the audit row."""

    def __init__(self, app: ASGIApp, services: Services, routes: RouteTable) -> None:
        self._app, self._routes = app, routes
        self._perimeter = Perimeter(services.base.settings)
        self._keys = Authenticator(services.accounts.accounts)
        self._record = AuditRecorder(services.accounts.audit, services.accounts.intents, utc_now, monotonic_s)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle a request or return the reason for rejecting it."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await self._http(scope, receive, send)
        else:  # no route uses WebSockets; a future WebSocket route must pass this guard
            await send({"type": "websocket.close", "code": 1008})

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        state = scope["state"] = dict(scope.get("state") or {})
        state |= {"who": None, "secure": self._perimeter.secure, "address": "", "detail": ""}
        response_writer = HeaderWriter(send, self._perimeter.secure, private=is_guarded(scope))
        try:
            refusal = await self._admit(scope, Headers(scope=scope))
            if refusal is not None and not state["detail"]:
                state["detail"] = json.loads(bytes(refusal.body))["message"]
            if refusal is not None:
                await refusal(scope, receive, response_writer)
            else:
                work = functools.partial(self._app, scope, receive, response_writer)
                await self._record.run(scope, self._routes.route(scope), work)
        except BaseException:  # cancelled requests are recorded too, then the exception propagates
            response_writer.status = response_writer.status or 500
            raise
        finally:
            with anyio.CancelScope(shield=True):
                await self._record.put(scope, response_writer.status or 499)

    async def _admit(self, scope: Scope, headers: Headers) -> Response | None:
        """Return the refusal, or None if the route can handle the request."""
        foreign = self._foreign(scope, headers)
        if foreign is not None:
            scope["state"]["detail"] = f"{foreign.message}: {foreign.got}"
            return problem(403, foreign.message, foreign.expected, foreign.got)
        if (ambiguous := ambiguous_length(headers)) is not None:
            return ambiguous
        changing, limit_bytes = is_change(scope), MAX_OPEN_BODY_BYTES if is_open(scope) else MAX_BODY_BYTES
        if changing and (bad := bad_body(headers, limit_bytes)) is not None:
            return bad
        if not is_guarded(scope):
            return problem(405, "pages support GET and HEAD only", "GET", scope["method"]) if changing else None
        refusal = await self._keys.identify(scope, headers)
        connection: Connection | None = scope["state"].get("connection")
        if connection is not None and scope["state"]["who"] is not None:
            connection.mark_authenticated()
        return refusal if refusal is not None or is_open(scope) else self._check_unread(scope, headers)

    def _foreign(self, scope: Scope, headers: Headers) -> Refusal | None:
        """Return the refusal if host or origin is not allowed, else None."""
        caller = self._perimeter.caller(scope, headers)
        if isinstance(caller, Refusal) and is_health(scope):
            caller = Caller(str((scope.get("client") or ("-",))[0]), headers.get("host", ""), self._perimeter.secure)
        if isinstance(caller, Refusal):
            return caller
        scope["state"]["address"] = caller.address
        return self._perimeter.refusal(caller, headers, data=is_guarded(scope))

    def _check_unread(self, scope: Scope, headers: Headers) -> Response | None:
        """Check permission and length before the body is read. Routes without a declared permission require
        ``view``."""
        route = self._routes.route(scope)
        try:
            for permission in [need.permission for need in needs_of(route)] or [VIEW]:
                scope["state"]["who"].require(permission)
        except NotPermitted as error:
            scope["route"] = route  # for the audit row
            return problem(403, error.message, error.expected, error.got, error.hint)
        return bad_body(headers, max_body_bytes(route, scope, headers)) if is_change(scope) else None
