"""Current and stored telemetry."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Query
from fastapi.responses import StreamingResponse

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, ContactId, QueryTime
from gss.api.schemas.base import MAX_ID
from gss.api.schemas.telemetry import CycleOut, HistoryOut, LatestOut, PacketOut
from gss.operations.telemetry.telemetry_export import FORMATS, export

router = api_router("telemetry", "/telemetry")


Fields = Annotated[list[str], Query(min_length=1, max_length=20)]
ExportFields = Annotated[list[str], Query(min_length=1, max_length=200)]


@router.get("/latest")
def latest(app: App) -> LatestOut:
    """Latest value and state of every field."""
    return present.telemetry.latest(app.telemetry.telemetry.values())


@router.get("/history")
def history(
    app: App,
    name: Fields,
    start: QueryTime,
    end: QueryTime,
    points: Annotated[int, Query(ge=10, le=20000)] = 600,
) -> HistoryOut:
    """History of several fields (``name`` or ``packet.name``) over one time range, thinned without loss of extremes."""
    series = app.telemetry.telemetry.archive.history(name, start, end, points)
    return HistoryOut(start=start, end=end, series=[present.telemetry.series(s) for s in series])


@router.get("/packets")
def packets(
    app: App,
    packet: Annotated[str | None, Query(max_length=60)] = None,
    start: QueryTime | None = None,
    end: QueryTime | None = None,
    contact: ContactId = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    before_id: Annotated[int | None, Query(ge=1, le=MAX_ID)] = None,
    after_id: Annotated[int | None, Query(ge=0, le=MAX_ID)] = None,
) -> list[PacketOut]:
    """Stored packets, newest first, in pages. With ``after_id``, packets with a larger id, oldest first, so that a
    program that stores the last id receives every packet."""
    rows = app.telemetry.telemetry.archive.packets(packet, start, end, limit, before_id, contact, after_id)
    return [present.telemetry.packet(row) for row in rows]


@router.get("/export", response_class=StreamingResponse, dependencies=[EXPORT])
def export_telemetry(
    app: App,
    field: ExportFields,
    start: QueryTime,
    end: QueryTime,
    format: Literal["csv", "parquet", "hdf5"] = "csv",
    form: Literal["converted", "raw", "formatted"] = "converted",
) -> StreamingResponse:
    """Export all samples of some fields over a time range as a file."""
    pieces = export(app.telemetry.telemetry.archive, field, start, end, form=form, file_format=format)
    name = f"telemetry-{start:%Y%m%dT%H%M%SZ}-{end:%Y%m%dT%H%M%SZ}.{format}"
    headers = {"Content-Disposition": f'attachment; filename="{name}"'}
    return StreamingResponse(pieces, media_type=FORMATS[format], headers=headers)


@router.get("/cycles")
def cycles(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 12) -> list[CycleOut]:
    """Timing of the latest iterations."""
    return [present.telemetry.cycle(timed) for timed in app.telemetry.telemetry.cycles(limit)]
