"""The spacecraft's orbit, ground stations and coming passes."""

from __future__ import annotations

import math
from typing import Annotated

from fastapi import Query
from fastapi.responses import JSONResponse, PlainTextResponse, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, ContactId, RowId, User, need
from gss.api.schemas.passes import OrbitIn, PassesOut, SpacecraftOut, StationIn, StationOut
from gss.operations.passes.orbit_export import MAX_OEM_DAYS, oem_file, omm_fields
from gss.operations.passes.pass_calendar import calendar
from gss.operations.passes.pass_table import MAX_DAYS
from gss.orbit.station import GroundStation

router = api_router("passes")
Days = Annotated[float, Query(gt=0, le=MAX_DAYS, allow_inf_nan=False)]
OemDays = Annotated[float, Query(gt=0, le=MAX_OEM_DAYS, allow_inf_nan=False)]


@router.get("/spacecraft")
def read_spacecraft(app: App) -> SpacecraftOut:
    """Spacecraft with its active orbit, the age and source of the orbit, and earlier orbits."""
    return present.passes.spacecraft(app.passes.spacecraft.current(), app.passes.spacecraft.history())


@router.put("/spacecraft", dependencies=[need("passes")])
def set_orbit(app: App, body: OrbitIn, user: User, audit_note: AuditNote) -> SpacecraftOut:
    """Import an orbit (TLE, OMM or OEM) and make it the active orbit. Earlier orbits are kept."""
    previous = app.passes.spacecraft.history(1)
    old = f"from epoch {previous[0].epoch:%Y-%m-%dT%H:%M}" if previous else "first orbit"
    audit_note(old, f"to {' '.join(body.text.split())[:160]}", f"source {body.source}" if body.source else "")
    current, _ = app.passes.spacecraft.set(body.text, name=body.name, source=body.source.strip(), user=user)
    return present.passes.spacecraft(current, app.passes.spacecraft.history())


@router.get("/spacecraft/omm.json", dependencies=[EXPORT])
def export_omm(app: App) -> JSONResponse:
    """Export the active elements as a CCSDS OMM in JSON."""
    return JSONResponse(omm_fields(app.passes.spacecraft.require()), headers=_file("orbit-omm.json"))


@router.get("/spacecraft/orbit.oem", dependencies=[EXPORT], response_class=PlainTextResponse)
def export_oem(app: App, days: OemDays = 3.0) -> Response:
    """Export positions and velocities from now as a CCSDS OEM in KVN: ICRF, UTC, a state each minute."""
    text = "".join(oem_file(app.passes.spacecraft.require(), app.base.clock.now(), days))
    return PlainTextResponse(text, headers=_file("orbit.oem"))


@router.get("/stations")
def list_stations(app: App) -> list[StationOut]:
    """Ground stations, sorted by name."""
    return [present.passes.station(row) for row in app.passes.stations.list_all()]


@router.post("/stations", status_code=201, dependencies=[need("passes")])
def create_station(app: App, body: StationIn, user: User, audit_note: AuditNote) -> StationOut:
    """Store a ground station."""
    audit_note(described(body))
    row = app.passes.stations.create(station_of(body), body.line_url, body.line_baud, body.note, user=user)
    return present.passes.station(row)


@router.put("/stations/{station_id}", dependencies=[need("passes")])
def change_station(app: App, station_id: RowId, body: StationIn, user: User, audit_note: AuditNote) -> StationOut:
    """Replace all values of a ground station."""
    old = present.passes.station(app.passes.stations.get(station_id))
    audit_note(f"from {described(old)} to {described(body)}")
    row = app.passes.stations.change(station_id, station_of(body), body.line_url, body.line_baud, body.note, user=user)
    return present.passes.station(row)


@router.delete("/stations/{station_id}", status_code=204, dependencies=[need("passes")])
def delete_station(app: App, station_id: RowId, user: User, audit_note: AuditNote) -> None:
    """Delete a ground station."""
    audit_note(described(present.passes.station(app.passes.stations.get(station_id))))
    app.passes.stations.delete(station_id, user=user)


@router.get("/passes")
def list_passes(app: App, days: Days = 3.0, station: ContactId = None) -> PassesOut:
    """Current passes and passes of the coming days, sorted by rise time. ``station``: include only this station."""
    return present.passes.passes(app.passes.table.upcoming(days, station))


class CalendarResponse(Response):
    """An iCalendar file."""

    media_type = "text/calendar"


@router.get("/passes/calendar.ics", dependencies=[EXPORT], response_class=CalendarResponse)
def export_calendar(app: App, days: Days = 7.0, station: ContactId = None) -> Response:
    """Export the coming passes as an iCalendar file."""
    text = calendar(app.passes.table.upcoming(days, station))
    return CalendarResponse(text.encode(), headers=_file("passes.ics"))


def station_of(body: StationIn) -> GroundStation:
    """Return the station of a request."""
    return GroundStation(
        body.name,
        math.radians(body.latitude_deg),
        math.radians(body.longitude_deg),
        body.height_m,
        math.radians(body.min_elevation_deg),
        tuple((math.radians(p.azimuth_deg), math.radians(p.elevation_deg)) for p in body.mask),
    )


def described(body: StationIn | StationOut) -> str:
    """Return the values of a station as text for the audit log."""
    place = f"{body.latitude_deg:g}° {body.longitude_deg:g}° {body.height_m:g} m"
    line = " ".join(str(part) for part in (body.line_url, body.line_baud or "") if part)
    return f"{body.name} at {place}, above {body.min_elevation_deg:g}°, mask of {len(body.mask)} points {line}".strip()


def _file(name: str) -> dict[str, str]:
    return {"Content-Disposition": f"attachment; filename={name}"}
