"""The units of this server."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from fastapi import Path, Request

from gss.api.api_router import api_router
from gss.api.deps import AuditNote, User, need
from gss.api.schemas.fleet import FleetOut, FleetUnitOut
from gss.domain.errors import NotFound

if TYPE_CHECKING:  # the module loads the HTTP client, which a server with one unit does not need
    from gss.api.units.fleet import Fleet, UnitState

router = api_router("fleet")
UnitName = Annotated[str, Path(min_length=1, max_length=24)]
CURRENT_WITHIN_S = 5.0
"""Maximum age of a current state. A unit reports once per second."""


@router.get("/fleet")
def list_units(request: Request) -> FleetOut:
    """State of every unit, with its age."""
    fleet: Fleet | None = request.app.state.fleet
    return FleetOut(units=[_unit(state) for state in fleet.states()] if fleet else [])


@router.post("/fleet/units/{name}/restart", status_code=204, dependencies=[need("link.open")])
def restart_unit(request: Request, name: UnitName, user: User, audit_note: AuditNote) -> None:
    """Restart the process of a unit, for example after the driver of its instrument hangs. The other units continue."""
    audit_note(name)
    fleet: Fleet | None = request.app.state.fleet
    if fleet is None:
        raise NotFound("this server has no units", hint="restart the server")
    fleet.restart(name, user)


def _unit(state: UnitState) -> FleetUnitOut:
    process, age_s = state.process, state.age_s
    current = state.reports and age_s is not None and age_s < CURRENT_WITHIN_S
    return FleetUnitOut(
        name=state.spec.name,
        instrument=state.spec.instrument,
        address=state.spec.address,
        process="ended" if process.pid is None else "running" if current else "starting",
        restarts=process.restarts,
        last_end=process.last_end,
        reason=state.reason,
        process_age_s=state.process_age_s,
        link=state.link,
        age_s=age_s,
        current=current,
    )
