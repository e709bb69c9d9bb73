"""What routers ask for."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Request
from fastapi.routing import APIRoute
from pydantic import AfterValidator
from starlette.types import Scope

from gss.api.schemas.base import LARGEST_ID
from gss.domain.errors import NotSignedIn
from gss.operations.accounts import identity
from gss.operations.accounts.permissions import VIEW, require
from gss.wiring import Services

# --- who asks -----------------------------------------------------------------------------------------------------


def who_of(scope: Scope) -> identity.Who | None:
    """The identity that the guard proved for this request."""
    found: identity.Who | None = scope.get("state", {}).get("who")
    return found


def identity_still_valid(services: Services, who: identity.Who) -> str:
    """Why whoever asked may no longer be answered; "" while they may. Reads the database: for streams, every few seconds."""
    return services.accounts.why_over(who)


def _signed_in(request: Request) -> identity.Who:
    who = who_of(request.scope)
    if who is None:
        raise NotSignedIn("nobody is signed in", hint="sign in, or send Authorization: Bearer gss_…")
    return who


# What takes no time is asked on the event loop: the threads may all be busy, and ABORT must not wait for one.
async def _who(request: Request) -> identity.Who:
    return _signed_in(request)


Who = Annotated[identity.Who, Depends(_who)]
"""Who asks, with role and permissions."""


async def _user(who: Who) -> str:
    return who.name


User = Annotated[str, Depends(_user)]
"""Name of who asks."""


async def _deed(request: Request) -> Callable[..., None]:
    def tell(*words: object) -> None:
        request.state.detail = " ".join(str(word) for word in words if word not in ("", None))

    return tell


Deed = Annotated[Callable[..., None], Depends(_deed)]
"""Tells the audit record what exactly is asked for, before it is tried. Chosen words only: never a password, key or link."""


# --- what it needs ------------------------------------------------------------------------------------------------


class Need:
    """What a route declares: a permission, some with | between, ``command`` for any command's, or ``nobody`` for what is open
    before signing in. ``changes``: is it on the record when it was done?"""

    def __init__(self, permission: str, changes: bool) -> None:
        self.permission, self.changes = permission, changes

    async def __call__(self, request: Request) -> None:
        if self.permission != NOBODY:
            who = _signed_in(request)
            require(who.permissions, self.permission, who.role)


class Export:
    """Marks a GET that gives a file away: it is on the record."""

    async def __call__(self) -> None:
        """Nothing to check: the permission to see is the permission to keep."""


NOBODY = "nobody"
EXPORT = Depends(Export())


def need(permission: str, *, changes: bool = True) -> Any:
    """For ``dependencies=[need("frames.import")]``. Every route that is no GET declares exactly one."""
    return Depends(Need(permission, changes))


def needs_of(route: object) -> list[Need]:
    """What a route declares."""
    return [mark for mark in _marks(route) if isinstance(mark, Need)]


def is_export(route: object) -> bool:
    """Does it give a file away?"""
    return any(isinstance(mark, Export) for mark in _marks(route))


def _marks(route: object) -> list[object]:
    return [d.dependency for d in route.dependencies] if isinstance(route, APIRoute) else []


async def view_by_default(request: Request) -> None:
    """A route that declares nothing needs the permission to look."""
    if not needs_of(request.scope.get("route")):
        who = _signed_in(request)
        require(who.permissions, VIEW, who.role)


# --- what is asked for --------------------------------------------------------------------------------------------


async def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


RowId = Annotated[int, Path(ge=1, le=LARGEST_ID)]
"""Id in an address."""
ContactId = Annotated[int | None, Query(ge=1, le=LARGEST_ID)]
"""Optional filter by contact."""

App = Annotated[Services, Depends(_services)]


def _with_zone(value: datetime) -> datetime:
    """The moment in UTC; one without a zone is meant so."""
    try:
        return (value if value.tzinfo else value.replace(tzinfo=UTC)).astimezone(UTC)
    except OverflowError:
        raise ValueError("a moment that cannot be told in UTC") from None


Moment = Annotated[datetime, AfterValidator(_with_zone)]
"""A moment in a query."""
