"""Sign-in, sign-out, the first admin, and passwords."""

from __future__ import annotations

import asyncio
import dataclasses
import functools
from collections.abc import Awaitable, Callable
from typing import Any

from fastapi import Request, Response

from gss.api.api_router import api_router
from gss.api.deps import NO_SIGN_IN, App, CurrentUser, need, who_of
from gss.api.guard.credentials import COOKIE, DEVICE_COOKIE, device_key, session_key
from gss.api.schemas.accounts import (
    LinkCheckBody,
    PasswordBody,
    PasswordLinkBody,
    SessionOut,
    SetUpBody,
    SignInBody,
    StartPageBody,
)
from gss.domain.errors import BadInput, Conflict
from gss.operations.accounts import identity
from gss.operations.accounts.attempts import BY_ADDRESS, Brake
from gss.operations.accounts.permissions import START_PAGES
from gss.operations.accounts.sign_in import DEVICE_LASTS, NewSession
from gss.operations.requests import names_row
from gss.wiring.services import Services

router = api_router("session")
OPEN = need(NO_SIGN_IN)
SELF = need("view")


def password_route(route: Callable[..., SessionOut]) -> Callable[..., Awaitable[SessionOut]]:
    """Decorate a route that hashes a password. The route then runs in the password queue instead of the request thread
    pool."""

    @functools.wraps(route)
    async def queued(**arguments: Any) -> SessionOut:
        services: Services = arguments["app"]
        return await asyncio.wrap_future(
            services.accounts.accounts.passwords.turns.take(functools.partial(route, **arguments))
        )

    return queued


@router.get("/session", dependencies=[OPEN])
def read_session(app: App, request: Request) -> SessionOut:
    """Current session. The request does not extend the session."""
    caller = who_of(request.scope)
    if caller is None:
        needed = app.accounts.accounts.users.set_up_needed()
        return SessionOut(signed_in=False, set_up_needed=needed, several_units=_several(app))
    return _session_out(app, caller)


@router.post("/session", dependencies=[OPEN])
@password_route
def sign_in(app: App, request: Request, response: Response, body: SignInBody) -> SessionOut:
    """Sign in with a name and a password."""
    account = app.accounts.accounts.users.named(body.name)
    # The typed name is not stored, because it can be a password.
    request.state.named = account.name if account else "unknown name"
    address, agent = _from(request)
    opened = app.accounts.accounts.sessions.sign_in(
        body.name,
        body.password,
        address=address,
        agent=agent,
        old_key=session_key(request.headers),
        device=device_key(request.headers),
    )
    return _open(app, request, response, opened)


@router.delete("/session", status_code=204, dependencies=[SELF])
def sign_out(app: App, request: Request, response: Response) -> None:
    """End this session."""
    app.accounts.accounts.sessions.sign_out(session_key(request.headers))
    response.delete_cookie(COOKIE, httponly=True, samesite="strict", secure=request.state.secure)


@router.put("/session/password", dependencies=[SELF])
@password_route
def change_password(
    app: App, request: Request, response: Response, caller: CurrentUser, body: PasswordBody
) -> SessionOut:
    """Change the caller's password. All sessions of this user end; this browser gets a new one."""
    if caller.kind != "session" or caller.user_id is None:
        raise Conflict("tokens have no password", hint="sign in")
    address, agent = _from(request)
    verified_hash = app.accounts.accounts.sessions.check_password(caller, body.old)
    user = app.accounts.accounts.users.set_password(caller.user_id, body.new, verified_hash)
    return _open(app, request, response, app.accounts.accounts.sessions.begin(user, address=address, agent=agent))


@router.put("/session/start-page", dependencies=[SELF])
def choose_start_page(app: App, caller: CurrentUser, body: StartPageBody) -> SessionOut:
    """Choose the page that opens after sign-in. With several units it cannot name a record, such as /frames/12, because
    the record belongs to one unit."""
    if _several(app) and names_row(body.path):
        raise BadInput(
            "A start page applies to all units and cannot name a record of one unit",
            expected="a page without the number of a record, such as /frames",
            got=body.path[:80],
            hint="choose the page that lists the record",
        )
    if caller.kind != "session" or caller.user_id is None:
        raise Conflict("tokens have no start page", hint="sign in")
    app.accounts.accounts.users.set_start_page(caller.user_id, body.path)
    return _session_out(app, dataclasses.replace(caller, start_page=body.path))


@router.post("/setup", dependencies=[OPEN])
@password_route
def set_up(app: App, request: Request, response: Response, body: SetUpBody) -> SessionOut:
    """Create the first admin, with the link that the server printed at startup."""
    brake = _brake(app, request)
    user = app.accounts.accounts.users.set_up(body.token, body.name, body.password)
    app.accounts.accounts.attempts.passed(brake)
    request.state.named = user.name
    address, agent = _from(request)
    return _open(app, request, response, app.accounts.accounts.sessions.begin(user, address=address, agent=agent))


@router.post("/password-links", dependencies=[OPEN])
@password_route
def use_password_link(app: App, request: Request, response: Response, body: PasswordLinkBody) -> SessionOut:
    """Set a password with a one-time link."""
    brake = _brake(app, request)
    user = app.accounts.accounts.users.set_password_by_link(body.token, body.password)
    app.accounts.accounts.attempts.passed(brake)
    request.state.named = user.name
    address, agent = _from(request)
    return _open(app, request, response, app.accounts.accounts.sessions.begin(user, address=address, agent=agent))


@router.post("/password-links/check", status_code=204, dependencies=[need(NO_SIGN_IN, changes=False)])
def check_link(app: App, request: Request, body: LinkCheckBody) -> None:
    """Check whether a one-time link is still valid, without using it up. Errors and rate limit are the same as for
    using the link."""
    brake = _brake(app, request)
    app.accounts.accounts.users.check_link(body.kind, body.token)
    app.accounts.accounts.attempts.passed(brake)


def _brake(app: Services, request: Request) -> list[tuple[str, Brake]]:
    keys = [(f"link {request.state.address}", BY_ADDRESS)]
    app.accounts.accounts.attempts.begin(keys)
    return keys


def _from(request: Request) -> tuple[str, str]:
    return request.state.address, request.headers.get("user-agent", "")


def _open(app: Services, request: Request, response: Response, opened: NewSession) -> SessionOut:
    """Store the session key and the device key in two cookies that scripts cannot read and that browsers do not send
    with cross-site requests. The device key is sent to this route only."""
    secure, lasts_s = request.state.secure, int(DEVICE_LASTS.total_seconds())
    response.set_cookie(COOKIE, opened.key, httponly=True, samesite="strict", secure=secure, path="/")
    response.set_cookie(
        DEVICE_COOKIE,
        opened.device,
        max_age=lasts_s,
        httponly=True,
        samesite="strict",
        secure=secure,
        path="/api/session",
    )
    return _session_out(app, opened.caller)


def _session_out(app: Services, caller: identity.CallerIdentity) -> SessionOut:
    return SessionOut(
        signed_in=True,
        name=caller.name,
        role=caller.role,
        permissions=sorted(caller.permissions),
        csrf=caller.csrf,
        expires=caller.expires,
        start_page=caller.start_page,
        role_start_page=START_PAGES.get(caller.role, ""),
        several_units=_several(app),
    )


def _several(app: Services) -> bool:
    return bool(app.base.settings.units)
