"""Audit log for admins: read, export, verify. It cannot be changed."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime, timedelta
from typing import Annotated, Any, Literal

from fastapi import Depends, Query
from fastapi.responses import StreamingResponse
from pydantic import BeforeValidator

from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, QueryTime, need
from gss.api.schemas.accounts import AuditRowOut, AuditVerdictOut
from gss.api.schemas.base import MAX_ID
from gss.operations.accounts.audit import FORMATS
from gss.store.audit import AuditFilter

router = api_router("audit", "/audit")
ADMIN = need("admin.audit")
DATE = len("2026-01-01")


def _whole_day(value: Any) -> Any:
    """Extend an end date without a time to the end of that day."""
    if not isinstance(value, str) or len(value) != DATE:
        return value
    try:
        return (datetime.fromisoformat(value) + timedelta(days=1)).isoformat()
    except (ValueError, OverflowError):
        return value


def _filter(
    who: Annotated[str, Query(max_length=80)] = "",
    action: Annotated[str, Query(max_length=60)] = "",
    result: Literal["", "done", "denied", "failed", "unknown"] = "",
    since: QueryTime | None = None,
    until: Annotated[QueryTime | None, BeforeValidator(_whole_day)] = None,
) -> AuditFilter:
    return AuditFilter(who, action, result, since, until)


AuditFilters = Annotated[AuditFilter, Depends(_filter)]


@router.get("", dependencies=[ADMIN])
def read_audit(
    app: App,
    filters: AuditFilters,
    before: Annotated[int | None, Query(ge=1, le=MAX_ID)] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
) -> list[AuditRowOut]:
    """Audit rows, newest first. ``before``: rows with a smaller number, for the next page. ``action``: prefix."""
    return [AuditRowOut.model_validate(row) for row in app.accounts.audit.page(filters, limit, before)]


@router.get("/export", response_class=StreamingResponse, dependencies=[ADMIN, EXPORT])
def export_audit(app: App, filters: AuditFilters, format: Literal["jsonl", "csv"] = "jsonl") -> StreamingResponse:
    """Export all matching rows as a file, oldest first."""
    pieces: Iterator[str] = app.accounts.audit.export(format, filters)
    headers = {"Content-Disposition": f"attachment; filename=audit.{format}"}
    return StreamingResponse(pieces, media_type=FORMATS[format], headers=headers)


@router.get("/verify", dependencies=[ADMIN])
def verify_audit(app: App, last_hash: Annotated[str, Query(max_length=64)] = "") -> AuditVerdictOut:
    """Recompute every hash. ``last_hash``: a hash noted earlier, which must still be in the log."""
    return AuditVerdictOut(**vars(app.accounts.audit.verify(last_hash)))
