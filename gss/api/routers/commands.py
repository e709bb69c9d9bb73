"""Commands: dictionary, dry run, sending and history."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Iterator
from datetime import datetime
from itertools import chain
from typing import Annotated

from fastapi import Depends, Header, Query, Request
from fastapi.responses import StreamingResponse

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, ContactId, QueryTime, RowId, User, need
from gss.api.schemas.commands import AbortOut, CheckOut, CommandIn, CommandOut, DictionaryOut, FacetsOut, ResolveIn
from gss.api.urgent import has_closed, run_urgent
from gss.domain.errors import Conflict
from gss.operations.accounts.permissions import STOP
from gss.operations.commanding.command_history import Filter
from gss.store.models import Command
from gss.wiring.services import Services

RECORD_WITHIN_S = 0.3
router = api_router("commands")
Limit = Annotated[int, Query(ge=1, le=1000)]
FilterValues = Annotated[list[str], Query(max_length=60)]
FilterValue = Annotated[str, Query(max_length=60)]
SearchText = Annotated[str, Query(max_length=200)]


def _filter(
    start: QueryTime | None = None,
    end: QueryTime | None = None,
    name: FilterValues = [],  # noqa: B006 - the framework copies it
    result: FilterValues = [],  # noqa: B006 - as above
    user: FilterValue = "",
    source: FilterValue = "",
    contact: ContactId = None,
    run: ContactId = None,
    text: SearchText = "",
) -> Filter:
    """Filter of the command history; a time without a zone is UTC."""
    return Filter(start, end, tuple(name), tuple(result), user, source, contact, run, text)


HistoryFilter = Annotated[Filter, Depends(_filter)]


def _shown(app: Services, row: Command) -> CommandOut:
    return present.commands.command(app.commanding.commands.view(row))


def _file(pieces: Iterator[str], media_type: str, name: str) -> StreamingResponse:
    first = next(pieces)  # raises an error for a bad filter before the response has started
    headers = {"Content-Disposition": f"attachment; filename={name}"}
    return StreamingResponse(chain([first], pieces), media_type=media_type, headers=headers)


@router.get("/dictionary")
def read_dictionary(app: App) -> DictionaryOut:
    """All commands that the device supports, with the current state of their preconditions, and all telemetry, with the active
    limits."""
    shown = app.commanding.commands.visible()
    states = {c.name: app.commanding.commands.preconditions(c) for c in shown}
    limits = app.telemetry.telemetry.limits
    return present.commands.dictionary(app.line.link.roles, app.base.unit.about.notes, shown, states, limits)


@router.get("/commands")
def list_commands(app: App, filters: HistoryFilter, limit: Limit = 100, before: ContactId = None) -> list[CommandOut]:
    """Commands, newest first. ``before``: commands with a smaller id, for the next page."""
    return [
        present.commands.command(app.commanding.commands.view(row))
        for row in app.commanding.history.page(filters, limit, before)
    ]


@router.get("/commands.csv", response_class=StreamingResponse, dependencies=[EXPORT])
def export_commands(app: App, filters: HistoryFilter) -> StreamingResponse:
    """Export all matching commands as CSV, oldest first."""
    return _file(app.commanding.history.csv(filters), "text/csv", "commands.csv")


@router.get("/commands.json", response_class=StreamingResponse, dependencies=[EXPORT])
def export_commands_json(app: App, filters: HistoryFilter) -> StreamingResponse:
    """Export all matching commands as JSON, oldest first."""
    return _file(app.commanding.history.json(filters), "application/json", "commands.json")


@router.get("/commands/facets")
def read_facets(app: App) -> FacetsOut:
    """Names, users, results and sources that occur in the history."""
    return FacetsOut(**app.commanding.history.facets())


@router.post("/commands/check", dependencies=[need("view", changes=False)])
def check_command(app: App, body: CommandIn, user: User) -> CheckOut:
    """Dry run of a command: bytes, hazard, preconditions and problems. Nothing is sent."""
    result = app.commanding.commands.check(body.name, body.arguments, user=user)
    names = [a.name for a in app.line.link.dictionary.command(body.name).arguments]
    return present.commands.check(result, names)


@router.post("/commands/abort", status_code=201, dependencies=[need(STOP)])
async def abort(
    app: App, user: User, request: Request, server_started: Annotated[datetime | None, Header()] = None
) -> AbortOut:
    """Queue ABORT ahead of all other traffic. The response waits at most 0.3 s for the database record. 409: ABORT was
    not queued. 412: it was not queued, because the server has started again since ``server_started``, the start that the
    caller knows; a request can wait until a server has started, and the caller has given up by then."""
    app.upkeep.status.require_start(server_started)
    if await has_closed(request):
        raise Conflict("ABORT was not sent: the connection was closed before the server read the request")
    receipt = await run_urgent(lambda: app.commanding.commands.abort(user=user, source="abort"))
    row = None
    with contextlib.suppress(TimeoutError):
        row = await asyncio.wait_for(asyncio.shield(asyncio.wrap_future(receipt.recorded)), RECORD_WITHIN_S)
    return AbortOut(request_id=receipt.request_id, at=receipt.at, command=None if row is None else _shown(app, row))


@router.post("/commands", status_code=201, dependencies=[need("command")])
def send_command(app: App, body: CommandIn, user: User, audit_note: AuditNote) -> CommandOut:
    """Queue a command."""
    audit_note(body.name, *(f"{name}={value}" for name, value in body.arguments.items()))
    return _shown(
        app, app.commanding.commands.send(body.name, body.arguments, confirm=body.confirm, user=user, source="form")
    )


@router.get("/commands/{command_id}")
def read_command(app: App, command_id: RowId) -> CommandOut:
    """Return one command."""
    return _shown(app, app.commanding.commands.get(command_id))


@router.post("/commands/{command_id}/retry", dependencies=[need("command")])
def retry_command(app: App, command_id: RowId, user: User, audit_note: AuditNote) -> CommandOut:
    """Send an unknown command again, with the same bytes and id. Allowed only while its result is unknown."""
    audit_note(app.commanding.commands.get(command_id).name)
    return _shown(app, app.commanding.commands.retry(command_id, user=user))


@router.post("/commands/{command_id}/withdraw", dependencies=[need("command")])
def withdraw_command(app: App, command_id: RowId, user: User, audit_note: AuditNote) -> CommandOut:
    """Withdraw a command that is still queued."""
    audit_note(app.commanding.commands.get(command_id).name)
    return _shown(app, app.commanding.commands.withdraw(command_id, user=user))


@router.post("/commands/{command_id}/resolve", dependencies=[need("command")])
def resolve_command(app: App, command_id: RowId, body: ResolveIn, user: User, audit_note: AuditNote) -> CommandOut:
    """Record the outcome of an unknown command in a note."""
    audit_note(f"{app.commanding.commands.get(command_id).name}, {body.note}")
    return _shown(app, app.commanding.commands.resolve(command_id, body.note, user=user))
