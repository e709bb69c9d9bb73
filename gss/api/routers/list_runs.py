"""Lists of measured stars: upload, solve as a job, results."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Sequence
from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import Form, Query, Response, UploadFile

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, RowId, User, need
from gss.api.guard.bodies import MAX_BODY_BYTES
from gss.api.schemas.list_runs import ListResultOut, ListResultsOut, ListRunOut, ListRunStartedOut
from gss.operations.frames.measured_lists import SIGMA_PX
from gss.operations.requests import request_from
from gss.operations.studies.list_runs import ListRow, ListRunRequest
from gss.store.models import ListRun

router = api_router("frames", "/lists")


@router.get("")
def list_runs(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 50) -> list[ListRunOut]:
    """Uploaded files of star lists, newest first."""
    return [ListRunOut.model_validate(row) for row in app.studies.list_runs.newest(limit)]


@router.post("", status_code=202, dependencies=[need("frames.import")])
def solve_lists(
    app: App,
    user: User,
    file: UploadFile,
    camera: Annotated[str, Form(max_length=40)],
    no_distortion: Annotated[bool, Form()] = False,
    sigma_px: Annotated[float, Form()] = SIGMA_PX,
    epoch_jyear: Annotated[float | None, Form()] = None,
) -> ListRunStartedOut:
    """Solve lists of measured stars as a job. ``file``: an .npz with the arrays col_px, row_px, flux and first, or a
    .csv with the columns list, col_px, row_px and flux."""
    data = file.file.read(MAX_BODY_BYTES + 1)
    values = {"camera": camera, "no_distortion": no_distortion, "sigma_px": sigma_px, "epoch_jyear": epoch_jyear}
    run, job = app.studies.list_runs.start(
        data, file.filename or "unnamed", request_from(ListRunRequest, values), user=user
    )
    return ListRunStartedOut(run=ListRunOut.model_validate(run), job=present.records.job(job))


@router.get("/{run_id}")
def read_run(app: App, run_id: RowId) -> ListRunOut:
    """Uploaded file of star lists."""
    return ListRunOut.model_validate(app.studies.list_runs.get(run_id))


@router.delete("/{run_id}", status_code=204, dependencies=[need("frames.import")])
def delete_run(app: App, run_id: RowId, audit_note: AuditNote) -> None:
    """Delete an uploaded file with its results."""
    audit_note(app.studies.list_runs.get(run_id).name)
    app.studies.list_runs.remove(run_id)


@router.get("/{run_id}/results")
def read_results(
    app: App,
    run_id: RowId,
    limit: Annotated[int, Query(ge=1, le=1000)] = 100,
    offset: Annotated[int, Query(ge=0, le=10_000_000)] = 0,
) -> ListResultsOut:
    """Results in the order of the file. 404 until the job has ended."""
    run = app.studies.list_runs.get(run_id)
    rows = app.studies.list_runs.results(run, offset, limit)
    return ListResultsOut(total=run.lists, results=[ListResultOut.model_validate(row) for row in rows])


@router.get("/{run_id}/export", response_class=Response, dependencies=[EXPORT])
def export_results(app: App, run_id: RowId, format: Literal["json", "csv"] = "json") -> Response:
    """All results as a file."""
    run = app.studies.list_runs.get(run_id)
    rows = app.studies.list_runs.results(run)
    content, kind = (_csv(rows), "text/csv") if format == "csv" else (_json(run, rows), "application/json")
    name = quote(f"{run.name.rpartition('.')[0] or run.name}-results.{format}")
    headers = {"Content-Disposition": f"attachment; filename*=UTF-8''{name}"}
    return Response(content, media_type=kind, headers=headers)


def _json(run: ListRun, rows: Iterable[ListRow]) -> str:
    about = ListRunOut.model_validate(run).model_dump(mode="json")
    return json.dumps(about | {"results": list(rows)}, allow_nan=False, ensure_ascii=False)


def _csv(rows: Iterable[ListRow]) -> str:
    text = io.StringIO()
    names = [*ListResultOut.model_fields]
    index = names.index("quaternion")
    columns = [*names[:index], "qx", "qy", "qz", "qw", *names[index + 1 :]]
    writer = csv.writer(text)
    writer.writerow(columns)
    for row in rows:
        quaternion: Sequence[float | str] = row["quaternion"] or ("", "", "", "")
        parts = dict(zip(("qx", "qy", "qz", "qw"), quaternion, strict=True))
        values = {**row, **parts, "notes": "; ".join(row["notes"])}
        writer.writerow([values[column] for column in columns])
    return text.getvalue()
