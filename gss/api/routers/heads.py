"""Spacecraft with several heads: mountings, fused attitude, agreement, misalignment and drift."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from fastapi import Query, Request
from fastapi.responses import Response, StreamingResponse
from pydantic import Field

from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, QueryTime, RowId, User, need
from gss.api.present.heads import heads, history
from gss.api.routers.attitudes import message_file
from gss.api.schemas.base import In
from gss.api.schemas.heads import HeadHistoryOut, HeadsOut
from gss.operations.heads.mountings import SpacecraftRequest, SpacecraftSetup
from gss.orbit.write_attitude import MessageFormat
from gss.wiring.services import Services

if TYPE_CHECKING:  # the module loads the HTTP client, which a server with one unit does not need
    from gss.api.units.fleet import Fleet

router = api_router("fleet", "/fleet/spacecraft")


class CorrectIn(In):
    """The head whose mounting is corrected by its estimated misalignment."""

    unit: str = Field(min_length=1, max_length=24)


@router.get("")
def list_spacecraft(app: App, request: Request) -> list[HeadsOut]:
    """Every spacecraft with its heads and their latest comparison, by name."""
    return [_out(app, request, setup) for setup in app.heads.book.list_all()]


@router.post("", status_code=201, dependencies=[need("heads")])
def create_spacecraft(
    app: App, request: Request, body: SpacecraftRequest, user: User, audit_note: AuditNote
) -> HeadsOut:
    """Store a spacecraft with the mountings of its heads."""
    audit_note(_described(body))
    setup = app.heads.book.create(body, user=user)
    app.heads.watch.refresh()
    return _out(app, request, setup)


@router.put("/{spacecraft_id}", dependencies=[need("heads")])
def change_spacecraft(
    app: App, request: Request, spacecraft_id: RowId, body: SpacecraftRequest, user: User, audit_note: AuditNote
) -> HeadsOut:
    """Replace all values of a spacecraft. The estimation of misalignments restarts."""
    audit_note(f"to {_described(body)}")
    setup = app.heads.book.change(spacecraft_id, body, user=user)
    app.heads.watch.refresh()
    return _out(app, request, setup)


@router.delete("/{spacecraft_id}", status_code=204, dependencies=[need("heads")])
def delete_spacecraft(app: App, spacecraft_id: RowId, user: User, audit_note: AuditNote) -> None:
    """Delete a spacecraft with the history of its heads."""
    audit_note(app.heads.book.get(spacecraft_id).name)
    app.heads.book.remove(spacecraft_id, user=user)
    app.heads.watch.refresh()


@router.post("/{spacecraft_id}/correct", dependencies=[need("heads")])
def correct_mounting(
    app: App, request: Request, spacecraft_id: RowId, body: CorrectIn, user: User, audit_note: AuditNote
) -> HeadsOut:
    """Correct the mounting of a head by its estimated misalignment."""
    audit_note(f"{body.unit} on {app.heads.book.get(spacecraft_id).name}")
    return _out(app, request, app.heads.watch.correct(spacecraft_id, body.unit, user=user))


@router.get("/{spacecraft_id}/history")
def read_history(app: App, spacecraft_id: RowId, hours: Annotated[float, Query(gt=0, le=720)] = 1.0) -> HeadHistoryOut:
    """Comparisons of the last hours."""
    return history(app.heads.history.pairs(spacecraft_id, hours))


@router.get("/{spacecraft_id}/attitudes", dependencies=[EXPORT], response_class=Response)
def export_fused_attitudes(
    app: App, spacecraft_id: RowId, start: QueryTime, end: QueryTime, format: MessageFormat = "aem"
) -> StreamingResponse:
    """Export the fused attitudes of the body in a span as a CCSDS AEM or ACM in KVN."""
    return message_file(app.heads.history.message(format, spacecraft_id, start, end), format)


def _out(app: Services, request: Request, setup: SpacecraftSetup) -> HeadsOut:
    fleet: Fleet | None = request.app.state.fleet
    states = {state.setup.id: state for state in app.heads.watch.states()}
    state = states.get(setup.id)
    current = state if state is not None and state.setup.changed == setup.changed else None
    return heads(setup, current, fleet.names if fleet else (), app.telemetry.alarms.opened())


def _described(body: SpacecraftRequest) -> str:
    """Return the mountings as text for the audit log."""
    parts = [f"{head.unit} {head.mounting_deg or head.body_from_cam} ± {head.sigma_arcsec:g}″" for head in body.heads]
    return f"{body.name}: {', '.join(parts)}"
