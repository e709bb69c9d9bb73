"""Identify the caller from the request's credential: an API token, or a session cookie with its CSRF value."""

from __future__ import annotations

import functools

import anyio.to_thread
from starlette.datastructures import Headers
from starlette.requests import cookie_parser
from starlette.responses import Response
from starlette.types import Scope

from gss.api.errors import problem
from gss.api.guard.route_table import is_change, is_open
from gss.api.urgent import ABORT, run_lookup
from gss.domain.errors import GssError, RateLimited
from gss.operations.accounts.accounts import STORE_DOWN_S, AccountService
from gss.operations.accounts.identity import CallerIdentity
from gss.operations.accounts.secrets import LONGEST, same

MARK = "X-GSS"
COOKIE = "gss_session"
DEVICE_COOKIE = "gss_device"


class Authenticator:
    """Identifies users and programs by their credentials."""

    def __init__(self, accounts: AccountService) -> None:
        self._accounts = accounts

    async def identify(self, scope: Scope, headers: Headers) -> Response | None:
        """Attach the caller's identity to the request. Return a 401 or 403 response if authentication is required and
        missing, or if the CSRF check fails; a 429 or 503 response if the lookup fails; else None."""
        token, cookie = bearer(headers), session_key(headers)
        try:
            caller = await self._caller(token, cookie, scope) if token or cookie else None
        except RateLimited as error:
            return problem(429, error.message, error.expected, hint=error.hint, retry_after_s=error.retry_after_s)
        except GssError as error:
            return problem(503, error.message, error.expected, error.got, error.hint)
        scope["state"]["who"] = caller
        if is_open(scope):
            if is_change(scope) and MARK.lower() not in headers:
                return problem(403, "the header X-GSS is missing", "X-GSS: 1", hint="send the header X-GSS: 1")
            return None
        if caller is None:
            return _unauthenticated(bool(token), bool(cookie))
        if is_change(scope) and caller.kind == "session" and not same(headers.get(MARK, ""), caller.csrf):
            return problem(
                403,
                "the CSRF token is missing or wrong",
                "X-GSS: the value csrf of GET /api/session",
                hint="reload the page; programs use a token: Authorization: Bearer gss_…",
            )
        return None

    async def _caller(self, token: str, cookie: str, scope: Scope) -> CallerIdentity | None:
        """Return the identity for the token or, without a token, for the cookie. For ABORT nothing is written, and the
        identity as last read is used if the database does not respond, because ABORT must not wait for the database."""
        urgent = scope["path"] == ABORT
        last_read = functools.partial(self._accounts.remembered, "token" if token else "session", token or cookie)
        remembered = last_read()
        if remembered is not None:
            return remembered
        if token:
            lookup = functools.partial(self._accounts.token_caller, token, scope["state"]["address"], touch=not urgent)
        else:
            # A request for the session's remaining time must not extend it.
            touch = not is_open(scope) and not urgent
            lookup = functools.partial(self._accounts.session_caller, cookie, touch=touch)
        if not urgent:
            return await anyio.to_thread.run_sync(lookup)
        return await run_lookup(lookup, functools.partial(last_read, STORE_DOWN_S))


def session_key(headers: Headers) -> str:
    """Return the session key from the cookie; "" if there is none."""
    return _cookie(headers, COOKIE)


def device_key(headers: Headers) -> str:
    """Return the device key from the cookie; "" if there is none."""
    return _cookie(headers, DEVICE_COOKIE)


def _cookie(headers: Headers, name: str) -> str:
    key = cookie_parser(headers.get("cookie", "")).get(name, "")
    return key if len(key) <= LONGEST else ""


def bearer(headers: Headers) -> str:
    """Return the bearer token; "" if there is none."""
    kind, _, key = headers.get("authorization", "").partition(" ")
    return key.strip()[: LONGEST + 1] if kind.lower() == "bearer" else ""


def _unauthenticated(token: bool, cookie: bool) -> Response:
    if token:
        return problem(401, "invalid token", "an active token", hint="ask an admin for a new token")
    if cookie:
        return problem(401, "the session has ended", hint="sign in again")
    return problem(401, "not signed in", hint="sign in. Programs send Authorization: Bearer gss_…")
