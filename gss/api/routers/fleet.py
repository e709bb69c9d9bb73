"""The units of this server."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fastapi import Request

from gss.api.api_router import api_router
from gss.api.schemas.fleet import FleetOut, FleetUnitOut

if TYPE_CHECKING:  # the module loads the HTTP client, which a server with one unit does not need
    from gss.api.units.fleet import Fleet, UnitState

router = api_router("fleet")
CURRENT_WITHIN_S = 5.0
"""Maximum age of a current state. A unit reports once per second."""


@router.get("/fleet")
def list_units(request: Request) -> FleetOut:
    """State of every unit, with its age."""
    fleet: Fleet | None = request.app.state.fleet
    return FleetOut(units=[_unit(state) for state in fleet.states()] if fleet else [])


def _unit(state: UnitState) -> FleetUnitOut:
    process, age_s = state.process, state.age_s
    current = process.pid is not None and age_s is not None and age_s < CURRENT_WITHIN_S
    return FleetUnitOut(
        name=state.spec.name,
        instrument=state.spec.instrument,
        address=state.spec.address,
        process="ended" if process.pid is None else "running" if current else "starting",
        restarts=process.restarts,
        last_end=process.last_end,
        reason=state.reason,
        link=state.link,
        age_s=age_s,
        current=current,
    )
