"""Device tables: create, store and send. Activation is a command."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Query, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, RowId, User, need
from gss.api.schemas.tables import (
    OnBoardTableOut,
    TableDefaultsOut,
    TableDetailOut,
    TableIn,
    TableKind,
    TableOut,
    TableUploadIn,
)
from gss.api.schemas.transfers import TransferOut

router = api_router("tables", "/tables")
Kind = Literal["", "star_list", "distance_table"] | TableKind


@router.get("")
def list_tables(app: App, kind: Kind = "", limit: Annotated[int, Query(ge=1, le=500)] = 50) -> list[TableOut]:
    """Tables, newest first."""
    reports = app.transfers.tables.on_board()
    return [present.tables.table(row, reports) for row in app.transfers.tables.newest(limit, kind)]


@router.get("/on-board")
def tables_on_board(app: App) -> list[OnBoardTableOut]:
    """Table banks as reported by the device."""
    return present.tables.on_board(app.transfers.tables.on_board())


@router.get("/defaults")
def table_defaults(app: App, kind: TableKind, profile: Annotated[str, Query(max_length=40)] = "") -> TableDefaultsOut:
    """Default values of a new table for a camera. If ``profile`` is empty, use the camera of the configured instrument."""
    camera = profile or app.base.settings.unit_instrument
    return TableDefaultsOut(kind=kind, profile=camera, content=dict(app.transfers.tables.defaults(kind, camera)))


@router.post("", status_code=201, dependencies=[need("tables")])
def create_table(app: App, body: TableIn, user: User, audit_note: AuditNote) -> TableDetailOut:
    """Create a table from a camera's values, overridden by the values in the request."""
    camera = body.profile or app.base.settings.unit_instrument
    audit_note(f"{body.kind} {body.name} of {camera}:", ", ".join(body.content) or "the camera's values")
    row = app.transfers.tables.create(body.kind, body.name, camera, body.content, user=user)
    return present.tables.table_detail(row, app.transfers.tables.on_board())


@router.get("/{table_id}")
def read_table(app: App, table_id: RowId) -> TableDetailOut:
    """A table with its values."""
    return present.tables.table_detail(app.transfers.tables.get(table_id), app.transfers.tables.on_board())


@router.get("/{table_id}/file.bin", response_class=Response, dependencies=[EXPORT])
def table_file(app: App, table_id: RowId) -> Response:
    """Table as stored by the sensor, in binary form."""
    headers = {"Content-Disposition": f"attachment; filename=table-{table_id}.bin"}
    return Response(app.transfers.tables.data(table_id), media_type="application/octet-stream", headers=headers)


@router.post("/{table_id}/upload", status_code=201, dependencies=[need("tables")])
def upload_table(app: App, table_id: RowId, body: TableUploadIn, user: User, audit_note: AuditNote) -> TransferOut:
    """Send a table to an inactive bank. The table is then verified by read-back and committed."""
    row = app.transfers.tables.get(table_id)
    audit_note(f"{row.kind} {row.name} to bank {body.bank}")
    app.commanding.authority.check(user)
    return present.records.transfer(app.transfers.tables.upload(table_id, body.bank))
