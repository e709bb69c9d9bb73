"""Transfers: progress and control."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, CurrentUser, RowId, need
from gss.api.schemas.transfers import TransferIn, TransferOut
from gss.device.session_transfer import Part
from gss.operations.accounts.permissions import STOP
from gss.operations.transfers.downloads import permission_of
from gss.store.models import Transfer

router = api_router("transfers", "/transfers")


@router.get("")
def list_transfers(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 20) -> list[TransferOut]:
    """Transfers, newest first."""
    return [present.records.transfer(view) for view in app.transfers.transfers.newest(limit)]


@router.post("/download", status_code=201, dependencies=[need("frames.transfer|catalogues.upload|tables")])
def download(app: App, caller: CurrentUser, body: TransferIn) -> TransferOut:
    """Download an image or a part of it, a bank, or a table from the device. The required permission depends on the
    kind."""
    caller.require(permission_of(body.kind))
    app.commanding.commands.require_user(caller.name)
    region = Part(**body.region.model_dump()) if body.region else None
    view = app.frames.downloads.start(body.kind, slot=body.slot, bank=body.bank, region=region, side_px=body.side_px)
    return present.records.transfer(view)


@router.get("/{transfer_id}")
def read_transfer(app: App, transfer_id: RowId) -> TransferOut:
    """Return one transfer."""
    return present.records.transfer(app.transfers.transfers.get(transfer_id))


@router.post("/{transfer_id}/pause", dependencies=[need(STOP)])
def pause(app: App, transfer_id: RowId, audit_note: AuditNote) -> TransferOut:
    """Pause a transfer; stored chunks are kept. Like ABORT, it needs no command authority."""
    audit_note(_described(app.transfers.transfers.get(transfer_id).row))
    return present.records.transfer(app.transfers.transfers.pause(transfer_id))


@router.post("/{transfer_id}/resume", dependencies=[need("frames.transfer|catalogues.upload|tables")])
def resume(app: App, caller: CurrentUser, transfer_id: RowId, audit_note: AuditNote) -> TransferOut:
    """Resume a transfer with its missing chunks. Failed and aborted transfers can also be resumed, even after a restart
    of the server. Needs the same permission as the start of the transfer."""
    app.commanding.commands.check_user(caller.name)
    row = app.transfers.transfers.get(transfer_id).row
    audit_note(_described(row))
    caller.require(permission_of(row.kind))
    if row.options.get("solve"):
        caller.require("command.attitude")
    app.commanding.commands.require_user(caller.name)
    return present.records.transfer(app.transfers.transfers.resume(transfer_id))


@router.post("/{transfer_id}/abort", dependencies=[need(STOP)])
def abort(app: App, transfer_id: RowId, audit_note: AuditNote) -> TransferOut:
    """Abort a transfer on both sides. Like ABORT, it needs no command authority."""
    audit_note(_described(app.transfers.transfers.get(transfer_id).row))
    return present.records.transfer(app.transfers.transfers.abort(transfer_id))


def _described(row: Transfer) -> str:
    return f"{row.subject} {row.direction} {row.target}, {row.state}"
