"""Commands: dictionary, dry run, sending, history."""

from __future__ import annotations

import csv
import io
from typing import Annotated

from fastapi import APIRouter, Query, Response

from gss.api import present
from gss.api.deps import App, ContactId, RowId
from gss.api.schemas.commands import CheckOut, CommandIn, CommandOut, DictionaryOut, ResolveIn

router = APIRouter(tags=["commands"])
Limit = Annotated[int, Query(ge=1, le=1000)]


@router.get("/dictionary")
def read_dictionary(app: App) -> DictionaryOut:
    """All commands and telemetry, with the present state of the commands' preconditions."""
    d = app.link.dictionary
    return present.commands.dictionary(d, {c.name: app.commands.preconditions(c) for c in d.commands})


@router.get("/commands")
def list_commands(app: App, limit: Limit = 100, contact: ContactId = None) -> list[CommandOut]:
    """Newest first."""
    return [present.commands.command(row) for row in app.commands.newest(limit, contact)]


@router.get("/commands.csv", response_class=Response)
def export_commands(app: App, limit: Limit = 1000) -> Response:
    """The history as a table, newest first."""
    buffer = io.StringIO()
    writer = csv.writer(buffer)
    writer.writerow(
        ["id", "request_id", "utc", "user", "source", "command", "arguments", "result", "detail", "duration_s"]
    )
    for row in app.commands.newest(limit, None):
        c = present.commands.command(row)
        created = c.model_dump(mode="json")["created"]
        writer.writerow(
            [c.id, c.request_id, created, c.user, c.source, c.name, c.text, c.result, c.detail, c.duration_s]
        )
    headers = {"Content-Disposition": "attachment; filename=commands.csv"}
    return Response(buffer.getvalue(), media_type="text/csv", headers=headers)


@router.post("/commands/check")
def check_command(app: App, body: CommandIn) -> CheckOut:
    """Dry run: the bytes, the preconditions, the problems. Nothing is sent."""
    result = app.commands.check(body.name, body.arguments)
    names = [a.name for a in app.link.dictionary.command(body.name).arguments]
    return present.commands.check(result, names)


@router.post("/commands/abort", status_code=201)
def abort(app: App) -> CommandOut:
    """ABORT, ahead of everything."""
    return present.commands.command(app.commands.abort(user=app.settings.user, source="abort"))


@router.post("/commands", status_code=201)
def send_command(app: App, body: CommandIn) -> CommandOut:
    """Queue a command."""
    row = app.commands.send(body.name, body.arguments, confirm=body.confirm, user=app.settings.user, source="form")
    return present.commands.command(row)


@router.get("/commands/{command_id}")
def read_command(app: App, command_id: RowId) -> CommandOut:
    """One command."""
    return present.commands.command(app.commands.get(command_id))


@router.post("/commands/{command_id}/retry")
def retry_command(app: App, command_id: RowId) -> CommandOut:
    """The same bytes with the same id, only while unknown."""
    return present.commands.command(app.commands.retry(command_id, user=app.settings.user))


@router.post("/commands/{command_id}/resolve")
def resolve_command(app: App, command_id: RowId, body: ResolveIn) -> CommandOut:
    """Settle an unknown command with a note."""
    return present.commands.command(app.commands.resolve(command_id, body.note, user=app.settings.user))
