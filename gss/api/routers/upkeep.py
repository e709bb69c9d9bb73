"""Health, metrics, retention, backups and the store check."""

from __future__ import annotations

from fastapi import Response
from fastapi.responses import PlainTextResponse, StreamingResponse

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, RowId, User, need
from gss.api.schemas.frames import FrameOut
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.upkeep import (
    BackupOut,
    ConfirmClockIn,
    FavouriteIn,
    ForecastOut,
    HealthCheckOut,
    HealthOut,
    RemovalOut,
    RetentionOut,
    RunRetentionIn,
    ServerClockOut,
)
from gss.operations.metrics import CONTENT_TYPE
from gss.operations.requests import as_stored
from gss.operations.upkeep.backup_manifest import Manifest
from gss.operations.upkeep.retention_policy import RetentionPolicy

router = api_router("upkeep")
root = api_router("upkeep", root="")


@router.get("/admin/health", dependencies=[need("admin.health")])
def health(app: App) -> HealthOut:
    """Results of the health checks, which detect slowly developing problems."""
    health_report = app.upkeep.health.look()
    return HealthOut(
        state=health_report.state, checks=[HealthCheckOut.model_validate(check) for check in health_report.checks]
    )


@root.get("/metrics", dependencies=[need("metrics")], response_class=PlainTextResponse)
def metrics(app: App) -> Response:
    """Metrics in Prometheus text format."""
    return Response(app.upkeep.metrics.text(), media_type=CONTENT_TYPE)


@router.get("/admin/retention", dependencies=[need("admin.retention")])
def read_retention(app: App) -> RetentionOut:
    """Retention policy, and the forecast of disk usage."""
    return _retention(app)


@router.put("/admin/retention", dependencies=[need("admin.retention")])
def choose_retention(app: App, user: User, body: RetentionPolicy, audit_note: AuditNote) -> RetentionOut:
    """Set the retention policy. It applies from the next run; captures beyond their size limit are deleted
    immediately."""
    before, after = app.upkeep.retention.policy().model_dump(), body.model_dump()
    changes = (f"{name} from {before[name]:g} to {value:g}" for name, value in after.items() if value != before[name])
    audit_note(", ".join(changes) or "nothing changed")
    app.upkeep.retention.choose(body, user=user)
    return _retention(app)


@router.post("/admin/retention/preview", dependencies=[need("admin.retention", changes=False)])
def preview_retention(app: App, body: RetentionPolicy) -> RemovalOut:
    """Data that a removal with this policy would delete now. Nothing is changed."""
    return RemovalOut.model_validate(app.upkeep.retention.preview(body))


@router.post("/admin/retention/run", status_code=202, dependencies=[need("admin.retention")])
def run_retention(app: App, user: User, audit_note: AuditNote, body: RunRetentionIn | None = None) -> JobOut:
    """Delete expired data now, as a job. 409 while the clock is in doubt, or if an unusual removal is not confirmed."""
    confirmed = body.confirmed if body is not None else None
    if confirmed is not None:
        audit_note(f"confirmed {as_stored(confirmed)}")
    return present.records.job(app.upkeep.retention.run(user=user, confirmed=confirmed))


@router.post("/admin/retention/confirm-clock", dependencies=[need("admin.retention")])
def confirm_clock(app: App, user: User, body: ConfirmClockIn, audit_note: AuditNote) -> RetentionOut:
    """Confirm that a person has checked the server's date and time. Retention and backup rotation then resume."""
    state = app.base.trust.state()
    audit_note(f"clock {state.now.isoformat()}, {state.doubt or 'not in doubt'}")
    app.base.trust.confirm(body.seen, user=user)
    return _retention(app)


def _retention(app: App) -> RetentionOut:
    return RetentionOut(
        **app.upkeep.retention.policy().model_dump(),
        last_run=app.upkeep.retention.last_run(),
        waiting=app.upkeep.retention.waiting(),
        clock=ServerClockOut.model_validate(app.base.trust.state()),
        forecast=ForecastOut.model_validate(app.upkeep.forecast.now()),
    )


@router.get("/admin/backups", dependencies=[need("admin.backup")])
def list_backups(app: App) -> list[BackupOut]:
    """Backups, newest first."""
    return [_backup(manifest) for manifest in app.upkeep.backups.list_all()]


@router.post("/admin/backups", status_code=202, dependencies=[need("admin.backup")])
def make_backup(app: App, user: User) -> JobOut:
    """Create a backup while the server runs, as a job. To restore it, run ``gss restore`` in a terminal."""
    return present.records.job(app.upkeep.backups.start(keep=app.upkeep.retention.policy().backups_keep, user=user))


@router.get("/admin/backups/{name}/file", dependencies=[need("admin.backup"), EXPORT], response_class=StreamingResponse)
def download_backup(app: App, name: str) -> StreamingResponse:
    """Download a backup as a tar file for ``gss restore``."""
    manifest = app.upkeep.backups.get(name)
    headers = {"Content-Disposition": f"attachment; filename=gss-{manifest.name}.tar"}
    return StreamingResponse(app.upkeep.backups.archive(manifest.name), media_type="application/x-tar", headers=headers)


def _backup(manifest: Manifest) -> BackupOut:
    return BackupOut.model_validate(
        {
            "name": manifest.name,
            "created": manifest.created,
            "version": manifest.version,
            "schema_version": manifest.schema,
            "kind": manifest.kind,
            "bytes": manifest.total_bytes,
            "blobs": len(manifest.blobs),
            "captures": len(manifest.captures),
        }
    )


@router.post("/admin/check-store", status_code=202, dependencies=[need("admin.health")])
def check_store(app: App, user: User) -> JobOut:
    """Check, as a job, that all recorded files are present and intact. The job's result is the report."""
    return present.records.job(app.upkeep.check.start(user=user))


@router.put("/frames/{frame_id}/favourite", dependencies=[need("frames.solve")])
def favourite(app: App, frame_id: RowId, body: FavouriteIn) -> FrameOut:
    """Mark a frame as favourite, or remove the mark. Retention never deletes a favourite's pixels."""
    row = app.upkeep.retention.favourite(frame_id, body.favourite)
    return present.frames.frame(*app.frames.frames.with_solution(row))
