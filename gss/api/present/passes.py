"""Orbit, ground stations and passes as responses."""

from __future__ import annotations

import math
from collections.abc import Sequence

from gss.api.schemas.passes import (
    MaskPointOut,
    OrbitOut,
    PassesOut,
    PassOut,
    PlanItemOut,
    PlanOut,
    SpacecraftOut,
    StationOut,
    TrackPointOut,
)
from gss.operations.passes.pass_table import ComingPass, PassTable
from gss.operations.passes.plans import items_of
from gss.operations.passes.spacecraft import CurrentOrbit
from gss.orbit.passes import TrackPoint
from gss.store.models import OrbitSet, PassPlan, Station

NO_ORBIT = "No orbit was imported. Import a TLE, an OMM or an OEM."


def orbit(row: OrbitSet) -> OrbitOut:
    """Return an imported orbit without the states of an ephemeris."""
    return OrbitOut.model_validate(
        {name: getattr(row, name) for name in OrbitOut.model_fields if name != "lines"}
        | {"lines": row.text if row.kind == "tle" else ""}
    )


def spacecraft(current: CurrentOrbit | None, history: Sequence[OrbitSet] = ()) -> SpacecraftOut:
    """Return the spacecraft with its active orbit."""
    return SpacecraftOut(
        name=current.row.spacecraft if current else "",
        orbit=orbit(current.row) if current else None,
        start=current.orbit.start if current else None,
        end=current.orbit.end if current else None,
        age_days=current.age_days if current else None,
        state=current.state if current else "never",
        advice=current.advice if current else NO_ORBIT,
        plannable=bool(current and current.plannable),
        history=[orbit(row) for row in history],
    )


def station(row: Station) -> StationOut:
    """Return a ground station, in degrees."""
    return StationOut(
        id=row.id,
        name=row.name,
        latitude_deg=_degrees(row.latitude_rad),
        longitude_deg=_degrees(row.longitude_rad),
        height_m=row.height_m,
        min_elevation_deg=_degrees(row.min_elevation_rad),
        mask=[MaskPointOut(azimuth_deg=_degrees(a), elevation_deg=_degrees(e)) for a, e in row.mask],
        line_url=row.line_url,
        line_baud=row.line_baud,
        note=row.note,
        user=row.user,
        changed=row.changed,
    )


def passes(table: PassTable) -> PassesOut:
    """Return a table of passes."""
    warnings = [table.current.advice] if table.current and table.current.state != "ok" else []
    flat = [row.name for row in table.stations if not row.mask]
    if flat:
        warnings.append(f"No horizon mask is set for {', '.join(flat)}: the horizon is assumed to be flat.")
    return PassesOut(
        spacecraft=spacecraft(table.current),
        start=table.start,
        days=table.days,
        problem=table.problem,
        warnings=warnings,
        passes=[one(entry, table.passes) for entry in table.passes],
    )


def one(coming: ComingPass, others: Sequence[ComingPass] = ()) -> PassOut:
    """Return a pass in degrees. ``others``: passes that may overlap it."""
    at = coming.at
    return PassOut(
        station_id=coming.station.id,
        station=coming.station.name,
        rise=at.rise,
        culmination=at.culmination,
        set=at.set,
        duration_s=at.duration_s,
        max_elevation_deg=_degrees(at.max_elevation_rad),
        rise_azimuth_deg=_degrees(at.rise_azimuth_rad),
        culmination_azimuth_deg=_degrees(at.culmination_azimuth_rad),
        set_azimuth_deg=_degrees(at.set_azimuth_rad),
        sun_elevation_deg=_degrees(at.sun_elevation_rad),
        sunlit_share=at.sunlit_share,
        begins_before=at.begins_before,
        ends_after=at.ends_after,
        content_bytes=coming.budget.content_bytes(at.duration_s),
        content_share=coming.budget.share,
        downloads=coming.budget.downloads,
        overlaps=[o.station.name for o in others if o is not coming and o.at.rise < at.set and at.rise < o.at.set],
        track=[_point(point) for point in at.track],
    )


def plan(row: PassPlan, problems: Sequence[str] = (), confirm: Sequence[str] = ()) -> PlanOut:
    """Return a pass plan. ``problems`` and ``confirm``: set for a draft only."""
    items = items_of(row)
    columns = {name: getattr(row, name) for name in PlanOut.model_fields if hasattr(row, name)}
    return PlanOut.model_validate(
        columns
        | {
            "items": [PlanItemOut.model_validate(item) for item in items],
            "planned_s": sum(item.estimated_s for item in items),
            "pass_s": (row.set - row.rise).total_seconds(),
            "problems": list(problems),
            "confirm": list(confirm),
        }
    )


def _point(point: TrackPoint) -> TrackPointOut:
    return TrackPointOut(
        at=point.at,
        azimuth_deg=_degrees(point.azimuth_rad),
        elevation_deg=_degrees(point.elevation_rad),
        range_km=round(point.range_km, 1),
        sunlit=point.sunlit,
    )


def _degrees(value_rad: float) -> float:
    """Return degrees, rounded to 3.6 milliarcseconds so that an entered value is shown unchanged."""
    return round(math.degrees(value_rad), 6)
