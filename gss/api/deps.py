"""FastAPI dependencies shared by the routers."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Request
from fastapi.routing import APIRoute
from pydantic import AfterValidator
from starlette.types import Scope

from gss.api.schemas.base import MAX_ID
from gss.domain.errors import NotSignedIn
from gss.operations.accounts import identity
from gss.operations.accounts.permissions import require
from gss.wiring.services import Services

# --- caller -------------------------------------------------------------------------------------------------------


def who_of(scope: Scope) -> identity.CallerIdentity | None:
    """Return the identity that the guard verified for this request; None if there is none."""
    caller: identity.CallerIdentity | None = scope.get("state", {}).get("who")
    return caller


def identity_still_valid(services: Services, caller: identity.CallerIdentity) -> str:
    """Return the reason why the caller's identity is no longer valid, or "" if it still is. Reads the database; streams
    call it every few seconds."""
    return services.accounts.accounts.ended_reason(caller)


def _signed_in(request: Request) -> identity.CallerIdentity:
    caller = who_of(request.scope)
    if caller is None:
        raise NotSignedIn("not signed in", hint="sign in, or send Authorization: Bearer gss_…")
    return caller


# These dependencies run on the event loop, because the thread pool can be full and ABORT must not wait for a thread.
async def _who(request: Request) -> identity.CallerIdentity:
    return _signed_in(request)


CurrentUser = Annotated[identity.CallerIdentity, Depends(_who)]
"""The caller, with role and permissions."""


async def _user(caller: CurrentUser) -> str:
    return caller.name


User = Annotated[str, Depends(_user)]
"""Name of the caller."""


async def _audit_note(request: Request) -> Callable[..., None]:
    def set_detail(*parts: object) -> None:
        request.state.detail = " ".join(text for text in (str(word) for word in parts if word is not None) if text)

    return set_detail


AuditNote = Annotated[Callable[..., None], Depends(_audit_note)]
"""Function that sets the audit detail of this request before it is carried out. Never pass it a password, key or
link."""


# --- permissions --------------------------------------------------------------------------------------------------


class Need:
    """Permission that a route declares: one permission, alternatives joined by |, ``command`` for any command
    permission, or ``NO_SIGN_IN`` for routes that need no sign-in. ``changes``: True if requests are written to the
    audit log."""

    def __init__(self, permission: str, changes: bool) -> None:
        self.permission, self.changes = permission, changes

    async def __call__(self, request: Request) -> None:
        if self.permission != NO_SIGN_IN:
            caller = _signed_in(request)
            require(caller.permissions, self.permission, caller.role)


class Export:
    """Mark of a GET route that exports a file. Every request to such a route is written to the audit log."""

    async def __call__(self) -> None:
        """Check nothing, because the view permission also covers exports."""


NO_SIGN_IN = "no_sign_in"
EXPORT = Depends(Export())


def need(permission: str, *, changes: bool = True) -> Any:
    """Return the dependency for ``dependencies=[need("frames.import")]``. Every route with a method other than GET
    declares exactly one."""
    return Depends(Need(permission, changes))


def needs_of(route: object) -> list[Need]:
    """Return the permissions that a route declares."""
    return [mark for mark in _marks(route) if isinstance(mark, Need)]


def is_export(route: object) -> bool:
    """True if the route exports a file."""
    return any(isinstance(mark, Export) for mark in _marks(route))


def _marks(route: object) -> list[object]:
    return [d.dependency for d in route.dependencies] if isinstance(route, APIRoute) else []


# --- parameters ---------------------------------------------------------------------------------------------------


async def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


RowId = Annotated[int, Path(ge=1, le=MAX_ID)]
"""Row id in a path."""
ContactId = Annotated[int | None, Query(ge=1, le=MAX_ID)]
"""Optional filter by contact."""

App = Annotated[Services, Depends(_services)]


def _with_zone(value: datetime) -> datetime:
    """Return the time in UTC; a time without a zone is interpreted as UTC."""
    try:
        return (value if value.tzinfo else value.replace(tzinfo=UTC)).astimezone(UTC)
    except OverflowError:
        raise ValueError("the time cannot be converted to UTC") from None


QueryTime = Annotated[datetime, AfterValidator(_with_zone)]
"""A time in a query."""
