"""What routers ask for."""

from __future__ import annotations

from typing import Annotated

from fastapi import Depends, Request

from gss.wiring import Services


def _services(request: Request) -> Services:
    services: Services = request.app.state.services
    return services


App = Annotated[Services, Depends(_services)]
