"""Transfers, jobs and events as responses."""

from __future__ import annotations

from gss.api.schemas.events import EventOut
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.transfers import FrameRegionOut, TransferOptionsOut, TransferOut
from gss.operations.job_rules import CANCELLING, can_start_again, permission_of
from gss.operations.transfers.transfer_progress import TransferView
from gss.operations.transfers.transfers import RESUMABLE
from gss.store.models import Event, Job, Transfer

PAUSABLE = ("queued", "opening", "transferring", "link_lost")


def transfer(view: TransferView) -> TransferOut:
    """Return a transfer with its current rate and progress."""
    row, live = view.row, view.live
    chunks = -(-row.size // row.chunk_size) if row.chunk_size else 0
    stored = [(int(a), int(b)) for a, b in row.stored]
    in_chunks = sum(b - a + 1 for a, b in stored) * row.chunk_size
    names = "id direction kind target subject state reason size chunk_size resent sha256 created finished log"
    return TransferOut(
        **{name: getattr(row, name) for name in names.split()},
        slot=row.options.get("slot"),
        options=_options(row),
        can_pause=row.state in PAUSABLE,
        can_resume=row.state in RESUMABLE and "slot" in row.options,
        can_abort=row.state in (*PAUSABLE, "paused", "verifying"),
        frame_id=row.frame_id,
        catalogue_id=row.catalogue_id,
        table_id=row.table_id,
        chunks=chunks,
        stored=stored,
        stored_bytes=min(row.size, live.stored_bytes if live else in_chunks),
        rate_bytes_s=live.rate_bytes_s if live else None,
        line_share=live.line_share if live else None,
        left_s=live.left_s if live else None,
    )


def _options(row: Transfer) -> TransferOptionsOut:
    part = row.options.get("part")
    return TransferOptionsOut(
        region=FrameRegionOut(**part) if part and row.kind == "region" else None,
        side_px=part["columns"] if part and row.kind == "star_windows" else None,
        solve=row.options.get("solve"),
    )


def job(row: Job) -> JobOut:
    """Return a job."""
    names = "id kind title state done total text created finished result attempts"
    values = {name: getattr(row, name) for name in names.split()}
    if row.state == CANCELLING:
        values["state"] = "running"
    user = row.request.get("user") or ""
    return JobOut(**values, user=user, permission=permission_of(row), can_start_again=can_start_again(row))


def event(row: Event) -> EventOut:
    """Return an event."""
    return EventOut.model_validate(row)
