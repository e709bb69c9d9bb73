"""What routers ask for."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Path, Query, Request

from gss.wiring import Services


def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


LARGEST_ID = 2**31 - 1
RowId = Annotated[int, Path(ge=1, le=LARGEST_ID)]
"""Id in an address."""
ContactId = Annotated[int | None, Query(ge=1, le=LARGEST_ID)]
"""Optional filter by contact."""

App = Annotated[Services, Depends(_services)]
