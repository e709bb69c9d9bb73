"""The guard in front of everything: deny by default. It knows where a request comes from and who asks, before any route does; what
a role may do is declared by the routes (deps.need) and by the commands."""

from __future__ import annotations

import functools
import json
import logging
import re
from collections import OrderedDict

import anyio
import anyio.to_thread
from fastapi import APIRouter, FastAPI, params
from fastapi.routing import APIRoute, iter_route_contexts
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import cookie_parser
from starlette.responses import Response
from starlette.routing import compile_path
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from gss.api.deps import is_export, needs_of
from gss.api.errors import problem
from gss.api.guard.headers import HEADERS, STRICT_TRANSPORT
from gss.api.guard.perimeter import Caller, Perimeter, Refusal
from gss.domain.errors import GssError, NotPermitted, TooOften
from gss.operations.accounts.audit import Result
from gss.operations.accounts.identity import Who
from gss.operations.accounts.secrets import LONGEST, same
from gss.operations.clock import Monotonic, monotonic_s
from gss.wiring import Services

SAFE_METHODS = ("GET", "HEAD", "OPTIONS")
MARK = "X-GSS"
COOKIE = "gss_session"
MAX_BODY_BYTES = 80 << 20
"""Of a file that is handed in, for the routes that take one. It goes to the disk in pieces."""
WORDS_BYTES, MORE_WORDS_BYTES = 1 << 20, 2 << 20
"""Of everything else: it is parsed in one piece, and nothing else is answered meanwhile."""
MORE_WORDS = ("/api/campaigns/reprocess",)
"""A campaign names up to 100 000 frames."""
SMALL_BODY_BYTES = 64 << 10
GUARDED = ("/api", "/metrics")
OPEN = {
    ("GET", "/api/session"),
    ("POST", "/api/session"),
    ("POST", "/api/setup"),
    ("POST", "/api/password-links"),
    ("GET", "/api/health"),
}
"""What is answered to nobody in particular, besides the pages' own files and the documents."""
HEALTH = "/api/health"
ABORT = "/api/commands/abort"
UNKNOWN_S = 60.0
log = logging.getLogger("gss.api")


def install(app: FastAPI) -> None:
    """Put the guard in front, and refuse to start with a route that does not say what it needs."""
    services: Services = app.state.services
    app.add_middleware(Guard, services=services, door=Door(app))


def check_routes(router: APIRouter) -> None:
    """Every route that is no GET declares exactly one permission: what was forgotten must not be open."""
    for context in iter_route_contexts(router.routes):
        route = context.original_route
        if isinstance(route, APIRoute) and (route.methods or set()) - set(SAFE_METHODS) and len(needs_of(route)) != 1:
            raise RuntimeError(f"{route.path} declares {len(needs_of(route))} permissions, it must be one: deps.need")


class Guard:
    """Middleware: host, origin, size, identity, CSRF; then the route; then the record."""

    def __init__(self, app: ASGIApp, services: Services, door: Door) -> None:
        self._app, self._services, self._door = app, services, door
        self._perimeter = Perimeter(services.settings)
        self._strangers = Strangers(monotonic_s)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer, or say why not."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif scope["type"] == "http":
            await self._http(scope, receive, send)
        else:  # there is no WebSocket here; whoever adds one must come past this line
            await send({"type": "websocket.close", "code": 1008})

    async def _http(self, scope: Scope, receive: Receive, send: Send) -> None:
        state = scope["state"] = dict(scope.get("state") or {})
        state |= {"guarded": True, "who": None, "secure": self._perimeter.secure, "address": "", "detail": ""}
        answer = Answer(send, self._perimeter.secure, private=is_guarded(scope))
        try:
            refusal = await self._admit(scope, Headers(scope=scope))
            if refusal is not None and not state["detail"]:
                state["detail"] = json.loads(bytes(refusal.body))["message"]
            await (self._app if refusal is None else refusal)(scope, receive, answer)
        except BaseException:
            answer.status = answer.status or 500
            raise
        finally:
            with anyio.CancelScope(shield=True):
                await self._put_on_record(scope, answer.status or 499)

    # --- before ---------------------------------------------------------------------------------------------------

    async def _admit(self, scope: Scope, headers: Headers) -> Response | None:
        """The refusal, or None when the route may answer."""
        caller = self._perimeter.caller(scope, headers)
        if isinstance(caller, Refusal) and (scope["method"], scope["path"]) == ("GET", HEALTH):
            caller = Caller(str((scope.get("client") or ("-",))[0]), headers.get("host", ""), self._perimeter.secure)
        if isinstance(caller, Refusal):
            return _refused(scope, caller)
        scope["state"]["address"] = caller.address
        foreign = self._perimeter.refusal(caller, headers, data=is_guarded(scope))
        if foreign is not None:
            return _refused(scope, foreign)
        changing = scope["method"] not in SAFE_METHODS
        if changing and (bad := _bad_body(headers, SMALL_BODY_BYTES if is_open(scope) else MAX_BODY_BYTES)) is not None:
            return bad
        refusal = await self._identify(scope, headers, changing=changing)
        return refusal if refusal is not None or not changing or is_open(scope) else self._unread(scope, headers)

    def _unread(self, scope: Scope, headers: Headers) -> Response | None:
        """What can be told before the body is read: whether they may, and whether it can be right at that length."""
        route, who = self._door.route(scope), scope["state"]["who"]
        if route is None:
            return _bad_body(headers, WORDS_BYTES)
        try:
            for need in needs_of(route):
                who.require(need.permission)
        except NotPermitted as error:
            scope["route"] = route  # for the record
            return problem(403, error.message, error.expected, error.got, error.hint)
        filed = takes_file(route) and headers.get("content-type", "").lower().startswith("multipart/form-data")
        words = MORE_WORDS_BYTES if scope["path"] in MORE_WORDS else WORDS_BYTES
        return _bad_body(headers, MAX_BODY_BYTES if filed else words)

    async def _identify(self, scope: Scope, headers: Headers, *, changing: bool) -> Response | None:
        if not is_guarded(scope):
            return None if not changing else problem(405, "pages are only read", "GET", scope["method"])
        token, cookie = bearer(headers), session_key(headers)
        try:
            who = await self._known(token, cookie, scope) if token or cookie else None
        except TooOften as error:
            return problem(429, error.message, error.expected, hint=error.hint, retry_after_s=error.retry_after_s)
        except GssError as error:
            return problem(503, error.message, error.expected, error.got, error.hint)
        scope["state"]["who"] = who
        if is_open(scope):
            if changing and MARK.lower() not in headers:
                return problem(403, "a change needs the header X-GSS", "X-GSS: 1", hint="send the header X-GSS: 1")
            return None
        if who is None:
            return _nobody(bool(token), bool(cookie))
        if changing and who.kind == "session" and not same(headers.get(MARK, ""), who.csrf):
            return problem(
                403,
                "a change needs the session's own mark",
                "X-GSS: the value csrf of GET /api/session",
                hint="reload the page; programs use a token: Authorization: Bearer gss_…",
            )
        return None

    async def _known(self, token: str, cookie: str, scope: Scope) -> Who | None:
        """A token stands before a cookie: nobody but a program sends one."""
        accounts, address = self._services.accounts, scope["state"]["address"]
        if token:
            known = accounts.remembered("token", token)
            return known or await anyio.to_thread.run_sync(accounts.who_has_token, token, address)
        # Asking how long the session lasts does not make it last longer, and ABORT waits for no write.
        touch = not is_open(scope) and scope["path"] != ABORT
        known = accounts.remembered("session", cookie)
        return known or await anyio.to_thread.run_sync(functools.partial(accounts.who_has_cookie, cookie, touch=touch))

    # --- after ----------------------------------------------------------------------------------------------------

    async def _put_on_record(self, scope: Scope, status: int) -> None:
        """One row for each change, export, and denial. That it cannot be written must not undo what was done: it is in the log."""
        if scope.get("gss.forwarded"):
            return
        route = scope.get("route")
        needs = needs_of(route)
        denied = status in (401, 403, 429)
        changed = scope["method"] not in SAFE_METHODS and is_guarded(scope) and any(need.changes for need in needs)
        if not (denied or changed or is_export(route)):
            return
        state = scope["state"]
        who: Who | None = state["who"]
        action = (
            f"{route.endpoint.__module__.rsplit('.', 1)[-1]}.{route.name}" if isinstance(route, APIRoute) else "door"
        )
        detail = state["detail"]
        if denied and who is None:
            more = None if status == 429 else self._strangers.seen(f"{state['address']} {action}")
            if more is None:
                return
            detail = f"{detail}; {more} more like this were not written" if more else detail
        name = state.get("named") or (who.name if who else "nobody")
        result: Result = "denied" if denied else "done" if status < 400 else "failed"
        target = f"{scope['method']} {scope['path'].removeprefix('/api')}"
        record = functools.partial(
            self._services.audit.record,
            name,
            action,
            target,
            result,
            detail,
            role=who.role if who else "",
            address=state["address"],
        )
        try:
            await anyio.to_thread.run_sync(record)
        except Exception:
            log.exception("the audit record could not be written: %s %s %s by %s", action, target, result, name)


class Answer:
    """Passes an answer on with our headers, and remembers its status."""

    def __init__(self, send: Send, secure: bool, *, private: bool) -> None:
        self._send, self._secure, self._private = send, secure, private
        self.status = 0

    async def __call__(self, message: Message) -> None:
        """Send on."""
        if message["type"] == "http.response.start":
            self.status = message["status"]
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                headers.setdefault(name, value)
            if self._secure:
                headers.setdefault(*STRICT_TRANSPORT)
            if self._private:
                headers.setdefault("Cache-Control", "no-store")
        await self._send(message)


class Door:
    """Which route a request is for, before the framework asks."""

    def __init__(self, app: FastAPI) -> None:
        self._app = app
        self._routes: list[tuple[set[str], re.Pattern[str], APIRoute]] = []

    def route(self, scope: Scope) -> APIRoute | None:
        """The route that will answer; None where there is none."""
        if not self._routes:  # the routes come after the guard
            found = [(c.original_route, c.path or "") for c in iter_route_contexts(self._app.routes)]
            self._routes = [
                (route.methods or set(), compile_path(path)[0], route)
                for route, path in found
                if isinstance(route, APIRoute)
            ]
        fitting = (
            route for methods, path, route in self._routes if scope["method"] in methods and path.match(scope["path"])
        )
        return next(fitting, None)


class Strangers:
    """Denials of people who are not signed in: one row a minute for each address and thing, with a count of the others; none for
    those whom a brake stopped. Anybody who can reach the port could fill the disk otherwise."""

    MOST = 2000

    def __init__(self, monotonic_s: Monotonic) -> None:
        self._now_s = monotonic_s
        self._seen: OrderedDict[str, tuple[float, int]] = OrderedDict()

    def seen(self, key: str) -> int | None:
        """How many went unwritten since the last row; None where this one need not be written."""
        at_s, skipped = self._seen.pop(key, (-UNKNOWN_S, 0))
        fresh = self._now_s() - at_s >= UNKNOWN_S
        self._seen[key] = (self._now_s(), 0) if fresh else (at_s, skipped + 1)
        while len(self._seen) > self.MOST:
            self._seen.popitem(last=False)
        return skipped if fresh else None


def is_guarded(scope: Scope) -> bool:
    """Is it data, not a page's own file?"""
    path: str = scope["path"]
    return any(path == root or path.startswith(f"{root}/") for root in GUARDED)


def is_open(scope: Scope) -> bool:
    """Is it answered to nobody in particular?"""
    return (scope["method"], scope["path"]) in OPEN


def takes_file(route: APIRoute) -> bool:
    """Can a file be handed in there?"""
    return any(isinstance(part.field_info, params.Form) for part in route.dependant.body_params)


def session_key(headers: Headers) -> str:
    """The key in the session's cookie; "" where there is none."""
    key = cookie_parser(headers.get("cookie", "")).get(COOKIE, "")
    return key if len(key) <= LONGEST else ""


def bearer(headers: Headers) -> str:
    """The token of a program; "" where there is none."""
    kind, _, key = headers.get("authorization", "").partition(" ")
    return key.strip()[: LONGEST + 1] if kind.lower() == "bearer" else ""


def _bad_body(headers: Headers, most: int) -> Response | None:
    if "transfer-encoding" in headers:
        return problem(411, "the request does not say how long it is", "a Content-Length")
    length = headers.get("content-length", "0")
    if not (length.isascii() and length.isdigit()) or int(length[:20]) > most:
        return problem(413, "the request is too large", f"at most {most >> 10} KiB", f"{length[:40]} bytes")
    return None


def _refused(scope: Scope, refusal: Refusal) -> Response:
    scope["state"]["detail"] = f"{refusal.message}: {refusal.got}"
    return problem(403, refusal.message, refusal.expected, refusal.got)


def _nobody(token: bool, cookie: bool) -> Response:
    if token:
        return problem(401, "this token is worth nothing", "one that lives", hint="ask an admin for another one")
    if cookie:
        return problem(401, "the session has ended", hint="sign in again")
    return problem(401, "nobody is signed in", hint="sign in; programs send Authorization: Bearer gss_…")
