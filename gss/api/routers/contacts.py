"""Contacts, with record check, replay and pass report."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import Query
from fastapi.responses import HTMLResponse, Response, StreamingResponse

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, RowId, User, need
from gss.api.files.cached import BLOCK_BYTES, file_download
from gss.api.present.contact_sheet import contact_sheet
from gss.api.schemas.base import MAX_ID
from gss.api.schemas.contacts import (
    ContactDetailOut,
    ContactNoteIn,
    ContactOut,
    RecordOut,
    ReplayChangeIn,
    ReplayIn,
    ReplayOut,
    ReportOut,
)
from gss.operations.contacts.contact_report import ContactReport, contact_report
from gss.operations.line.capture_files import PACKED, plain_blocks, plain_name
from gss.operations.report.html import as_html
from gss.operations.report.pdf import as_pdf

router = api_router("contacts")
Offset = Annotated[int, Query(ge=0, le=MAX_ID)]


@router.get("/contacts")
def list_contacts(
    app: App, response: Response, limit: Annotated[int, Query(ge=1, le=500)] = 50, offset: Offset = 0
) -> list[ContactOut]:
    """Page of contacts, newest first. The header X-Total contains the total number of contacts."""
    response.headers["X-Total"] = str(app.contacts.contacts.total())
    return [present.contacts.contact(*row) for row in app.contacts.contacts.newest(limit, offset)]


@router.get("/contacts/{contact_id}")
def read_contact(app: App, contact_id: RowId) -> ContactDetailOut:
    """All details of a contact."""
    return present.contacts.detail(app.contacts.contacts.detail(contact_id))


@router.put("/contacts/{contact_id}/note", dependencies=[need("contacts.note")])
def note_contact(app: App, user: User, contact_id: RowId, body: ContactNoteIn) -> ContactDetailOut:
    """Set the operator's note of a contact."""
    return present.contacts.detail(app.contacts.contacts.note(contact_id, body.note, user=user))


@router.get("/contacts/{contact_id}/record")
def check_record(app: App, contact_id: RowId) -> RecordOut:
    """Gaps in the contact's 1 Hz record, with their causes."""
    return present.contacts.record(contact_id, app.contacts.contacts.record(contact_id))


@router.get("/contacts/{contact_id}/captures/{file}", response_class=StreamingResponse, dependencies=[EXPORT])
def read_capture(app: App, contact_id: RowId, file: str) -> StreamingResponse:
    """Download a file of the raw capture. If the file is still being written, download its current content."""
    path = app.contacts.contacts.file(contact_id, file)
    if path.suffix != PACKED:
        return file_download(path)
    headers = {"Content-Disposition": f'attachment; filename="{plain_name(path)}"'}
    return StreamingResponse(plain_blocks(path, BLOCK_BYTES), media_type="application/octet-stream", headers=headers)


def _report(app: App, contact_id: int) -> ContactReport:
    return contact_report(app.contacts.contacts, app.telemetry.telemetry.archive, app.base.database, contact_id)


@router.get("/contacts/{contact_id}/report")
def report(app: App, contact_id: RowId) -> ReportOut:
    """Pass report as data."""
    contact_data = _report(app, contact_id)
    procedures = app.procedures.runs.between(contact_data.detail.row.started, contact_data.detail.end)
    return present.contacts.report(contact_data, procedures, app.contacts.handover.of_contact(contact_id))


@router.get("/contacts/{contact_id}/report.html", response_class=HTMLResponse, dependencies=[EXPORT])
def report_page(app: App, contact_id: RowId) -> HTMLResponse:
    """Pass report as one self-contained HTML page without scripts."""
    return HTMLResponse(as_html(contact_sheet(report(app, contact_id))))


@router.get("/contacts/{contact_id}/report.pdf", response_class=Response, dependencies=[EXPORT])
def report_pdf(app: App, contact_id: RowId) -> Response:
    """Pass report as a PDF file."""
    contact_data = report(app, contact_id)
    data = as_pdf(contact_sheet(contact_data), contact_data.contact.ended or contact_data.contact.started)
    headers = {"Content-Disposition": f"attachment; filename=contact-{contact_id}.pdf"}
    return Response(data, media_type="application/pdf", headers=headers)


@router.post("/contacts/{contact_id}/replay", status_code=201, dependencies=[need("replay")])
def start_replay(app: App, contact_id: RowId, body: ReplayIn) -> ReplayOut:
    """Replay the contact's capture in a separate view. A running replay is stopped."""
    return present.contacts.replay(app.contacts.replay.start(contact_id, body.speed, _unix(body.start)))


@router.get("/replay")
def read_replay(app: App) -> ReplayOut:
    """State of the replay."""
    return present.contacts.replay(app.contacts.replay.state)


@router.put("/replay", dependencies=[need("replay")])
def change_replay(app: App, body: ReplayChangeIn) -> ReplayOut:
    """Change speed or position of the replay, or pause it."""
    fastest = "speed" in body.model_fields_set and body.speed is None
    state = app.contacts.replay.change(
        speed=body.speed, as_fast_as_possible=fastest, paused=body.paused, at_s=_unix(body.at)
    )
    return present.contacts.replay(state)


@router.delete("/replay", dependencies=[need("replay")])
def stop_replay(app: App) -> ReplayOut:
    """Stop the replay."""
    return present.contacts.replay(app.contacts.replay.stop())


def _unix(time: datetime | None) -> float | None:
    if time is None:
        return None
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()
