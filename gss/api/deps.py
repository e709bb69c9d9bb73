"""What routers ask for."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import Depends, Header, Path, Query, Request
from pydantic import AfterValidator

from gss.api.schemas.base import LARGEST_ID
from gss.operations.commanding.authority import checked_user
from gss.wiring import Services


def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


def _user(app: Annotated[Services, Depends(_services)], x_gss_user: Annotated[str, Header()] = "") -> str:
    """Until there is signing in: a name in the header X-GSS-User, else the server's own."""
    return checked_user(x_gss_user or app.settings.user)


RowId = Annotated[int, Path(ge=1, le=LARGEST_ID)]
"""Id in an address."""
ContactId = Annotated[int | None, Query(ge=1, le=LARGEST_ID)]
"""Optional filter by contact."""

App = Annotated[Services, Depends(_services)]

User = Annotated[str, Depends(_user)]
"""Who asks."""


def _with_zone(value: datetime) -> datetime:
    """The moment in UTC; one without a zone is meant so."""
    try:
        return (value if value.tzinfo else value.replace(tzinfo=UTC)).astimezone(UTC)
    except OverflowError:
        raise ValueError("a moment that cannot be told in UTC") from None


Moment = Annotated[datetime, AfterValidator(_with_zone)]
"""A moment in a query."""
