"""Stacks become procedures

Each stack becomes a procedure, and each run of a stack a frozen procedure record. Commands, pass plans and tokens then refer to
procedures. The tables of stacks are dropped.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Iterator, Mapping
from datetime import UTC, datetime
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0021"
down_revision = "0020"
branch_labels = None
depends_on = None

SIGNS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
MAX_CHARACTERS, MAX_NAME = 100_000, 80
ENTRY = {"ended": "", "detail": "", "values": None, "command_id": None, "due": "", "note": ""}
UNFINISHED = ("running", "paused")


def upgrade() -> None:
    connection, metadata = op.get_bind(), sa.MetaData()
    metadata.reflect(
        connection,
        only=[
            "stacks",
            "stack_runs",
            "procedures",
            "procedure_runs",
            "commands",
            "contacts",
            "pass_plans",
            "api_tokens",
        ],
    )
    tables = metadata.tables
    procedure_of, text_of = _procedures(connection, tables["stacks"], tables["procedures"])
    run_of = _runs(connection, tables, procedure_of)
    with op.batch_alter_table("commands", schema=None) as batch_op:
        batch_op.drop_constraint(batch_op.f("fk_commands_run_id_stack_runs"), type_="foreignkey")
    commands = tables["commands"]
    for old, new in run_of.items():  # negative first, because a new id can equal an old one
        connection.execute(commands.update().where(commands.c.run_id == old).values(run_id=-new))
    connection.execute(commands.update().where(commands.c.run_id < 0).values(run_id=-commands.c.run_id))
    with op.batch_alter_table("commands", schema=None) as batch_op:
        batch_op.create_foreign_key(
            batch_op.f("fk_commands_run_id_procedure_runs"), "procedure_runs", ["run_id"], ["id"]
        )
    _plans(connection, tables, procedure_of, run_of, text_of)
    _tokens(connection, tables["api_tokens"])
    with op.batch_alter_table("stack_runs", schema=None) as batch_op:
        batch_op.drop_index(batch_op.f("ix_stack_runs_state"))
    op.drop_table("stack_runs")
    op.drop_table("stacks")


def _procedures(
    connection: sa.Connection, stacks: sa.Table, procedures: sa.Table
) -> tuple[dict[int, int], dict[int, tuple[str, str]]]:
    """Store a procedure for each stack. Return the id of the procedure, and its (name, text), by the id of the stack."""
    names = set(connection.scalars(sa.select(procedures.c.name)))
    ids, contents = {}, {}
    for row in connection.execute(stacks.select().order_by(stacks.c.id)):
        name = _free(row.name, names)
        names.add(name)
        text = _text(name, row.note, row.steps)
        values = {"name": name, "text": text, "author": row.author, "changed": row.changed}
        ids[row.id] = connection.execute(procedures.insert().values(values)).inserted_primary_key[0]
        contents[row.id] = (name, text)
    return ids, contents


def _free(name: str, names: set[str]) -> str:
    """Return the name, with a number if a procedure already has it."""
    candidate, number = name, 1
    while candidate in names:
        number += 1
        suffix = f" ({number})"
        candidate = name[: MAX_NAME - len(suffix)] + suffix
    return candidate


def _text(name: str, note: str, steps: Any) -> str:
    """Return a stack as the text of a procedure, without notes if it would be too long. A stack that cannot be converted becomes a
    quotation without steps, which cannot start."""
    head = f"# {' '.join(name.split())}\n"
    try:
        for notes in (True, False):
            parts = [head, _quoted(note)] if note and notes else [head]
            parts += [part for number, step in enumerate(steps, 1) for part in _sections(number, step, notes)]
            if len(text := "\n".join(parts)) <= MAX_CHARACTERS:
                return text
    except (KeyError, TypeError, ValueError, AttributeError):
        pass  # the quotation below contains the steps
    content = json.dumps(steps, ensure_ascii=False)
    return "\n".join([head, _quoted(f"This stack could not be converted to steps:\n{content}")])[:MAX_CHARACTERS]


def _sections(number: int, step: Mapping[str, Any], notes: bool) -> Iterator[str]:
    command, condition = step["command"], step["condition"]
    if step["delay_s"]:
        yield _section(f"wait-{number}", f"Wait before {command}", "wait", _seconds(step["delay_s"]))
    if condition:
        value = json.dumps(condition["value"])
        expression = f"{condition['packet']}.{condition['field']} {SIGNS[condition['op']]} {value}"
        within = f"within: {_seconds(condition['wait_s'])}"
        yield _section(f"check-{number}", f"Check before {command}", "check", expression, within)
    arguments = [f"{key}={_value(value)}" for key, value in step["arguments"].items()]
    line = shlex.join([command, *arguments])
    if not line.isprintable():
        raise ValueError("the arguments contain control characters")
    yield _section(f"send-{number}", f"Send {command}", "command", line, note=step["note"] if notes else "")


def _section(name: str, title: str, kind: str, *lines: str, note: str = "") -> str:
    prose = f"\n{_quoted(note)}" if note else ""
    return f"## {name}: {title}\n{prose}\n" + "\n".join([f"```{kind}", *lines, "```", ""])


def _quoted(text: str) -> str:
    """Return text as a Markdown quotation, in which lines are never headings or actions."""
    return "\n".join(f"> {line}" for line in text.splitlines()) + "\n"


def _seconds(value: float) -> str:
    return f"{value:.6f}".rstrip("0").rstrip(".") + " s"


def _value(value: object) -> str:
    return json.dumps(value) if isinstance(value, bool) else str(value)


def _runs(connection: sa.Connection, tables: Mapping[str, sa.Table], procedure_of: Mapping[int, int]) -> dict[int, int]:
    """Store a frozen procedure record for each run of a stack. Return its id by the id of the run of the stack."""
    runs, records, commands, contacts = (tables[n] for n in ("stack_runs", "procedure_runs", "commands", "contacts"))
    now, ids = datetime.now(UTC).replace(tzinfo=None), {}
    for row in connection.execute(runs.select().order_by(runs.c.id)):
        sent = {c.id: c for c in connection.execute(commands.select().where(commands.c.run_id == row.id))}
        contact_id = next((c.contact_id for c in sent.values() if c.contact_id is not None), None)
        model = connection.scalar(sa.select(contacts.c.instrument).where(contacts.c.id == contact_id))
        interrupted = row.state in UNFINISHED
        values = {
            "procedure_id": procedure_of.get(row.stack_id),
            "name": row.name,
            "text": _text(row.name, "", row.steps),
            "instrument": model or "",
            "contact_id": contact_id,
            "user": row.user,
            "automatic": False,
            "state": _state(row.state, row.reason),
            "current": "",
            "entries": _entries(row, sent),
            "reason": "stopped: the server was updated" if interrupted else row.reason,
            "started": row.started,
            "finished": row.finished or now,
            "sha256": "",
        }
        new = connection.execute(records.insert().values(values)).inserted_primary_key[0]
        connection.execute(records.update().where(records.c.id == new).values(sha256=_sha256(new, values)))
        ids[row.id] = new
    return ids


def _state(state: str, reason: str) -> str:
    """Return the state of a record. A failed step ended the run of a stack, as a stop of an operator ends a procedure."""
    if state == "completed":
        return state
    return "aborted" if reason.startswith("ABORT by ") else "stopped"


def _entries(row: Any, sent: Mapping[int, Any]) -> list[dict[str, Any]]:
    """Return an entry for each step that was started. Times are those of its command, otherwise of the run."""
    entries: list[dict[str, Any]] = []
    steps = row.steps if isinstance(row.steps, list) else []
    for number, step in enumerate(steps, 1):
        if not isinstance(step, dict) or step.get("state", "waiting") == "waiting":
            continue
        command = sent.get(step.get("command_id"))
        began, ended = (command.created, command.finished) if command else (row.started, row.finished)
        state = {"completed": "done", "skipped": "skipped"}.get(step["state"], "failed")
        detail = f"{step['state']}: {step.get('detail')}" if step.get("detail") else step["state"]
        entry = {"step": f"send-{number}", "title": f"Send {step.get('command')}", "kind": "command", "state": state}
        times = {"began": _iso(began), "ended": _iso(ended or began)}
        more = {"by": row.user, "detail": detail, "command_id": step.get("command_id")}
        entries.append(ENTRY | entry | times | more)
    return entries


def _sha256(run_id: int, values: Mapping[str, Any]) -> str:
    """Return the hash of a record in the format gss-procedure-record, version 1."""
    record = {
        "format": "gss-procedure-record",
        "version": 1,
        "run": run_id,
        "procedure": values["name"],
        "text": values["text"],
        "text_sha256": hashlib.sha256(values["text"].encode()).hexdigest(),
        "instrument": values["instrument"],
        "contact": values["contact_id"],
        "started_by": values["user"],
        "started": _iso(values["started"]),
        "finished": _iso(values["finished"]),
        "state": values["state"],
        "reason": values["reason"],
        "entries": values["entries"],
    }
    content = json.dumps(record, ensure_ascii=False, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(content.encode()).hexdigest()


def _iso(moment: datetime) -> str:
    return f"{moment.isoformat(timespec='milliseconds')}Z"


def _plans(
    connection: sa.Connection,
    tables: Mapping[str, sa.Table],
    procedure_of: Mapping[int, int],
    run_of: Mapping[int, int],
    text_of: Mapping[int, tuple[str, str]],
) -> None:
    """Make the items of pass plans refer to procedures. An item that was reviewed before its stack was changed still differs."""
    stacks, plans = tables["stacks"], tables["pass_plans"]
    steps_of = {row.id: row.steps for row in connection.execute(stacks.select())}

    def converted(item: dict[str, Any]) -> dict[str, Any]:
        stack_id = item.pop("stack_id", None)
        if item.get("kind") != "stack":
            return item
        # No procedure has the id 0, so an item whose stack was deleted still cannot start.
        item |= {"kind": "procedure", "procedure_id": procedure_of.get(stack_id, 0)}
        item["started_id"] = run_of.get(item.get("started_id"))
        if stack_id in text_of:
            name, text = text_of[stack_id]
            item["title"] = f"Procedure {name}"
            reviewed = hashlib.sha256(json.dumps(steps_of[stack_id], sort_keys=True).encode()).hexdigest()
            if item.get("reviewed_sha256") == reviewed:
                item["reviewed_sha256"] = hashlib.sha256(text.encode()).hexdigest()
        return item

    _convert_lists(connection, plans, "items", lambda item: converted(dict(item)) if isinstance(item, dict) else item)


def _tokens(connection: sa.Connection, tokens: sa.Table) -> None:
    """Replace the permission for stacks by the permission for procedures."""
    _convert_lists(connection, tokens, "scopes", lambda scope: "procedures" if scope == "stacks" else scope)


def _convert_lists(connection: sa.Connection, table: sa.Table, column: str, convert: Callable[[Any], Any]) -> None:
    """Convert all elements of a column of lists. Rows that do not change are not written."""
    for row in connection.execute(sa.select(table.c.id, table.c[column])).all():
        if isinstance(row[1], list):
            elements = [convert(element) for element in row[1]]
            if elements != row[1]:
                connection.execute(table.update().where(table.c.id == row[0]).values({column: elements}))


def downgrade() -> None:
    op.create_table(
        "stacks",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("steps", sa.JSON(), nullable=False),
        sa.Column("author", sa.String(length=60), nullable=False),
        sa.Column("changed", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_stacks")),
        sa.UniqueConstraint("name", name=op.f("uq_stacks_name")),
    )
    op.create_table(
        "stack_runs",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("stack_id", sa.Integer(), nullable=True),
        sa.Column("name", sa.String(length=80), nullable=False),
        sa.Column("steps", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(length=12), nullable=False),
        sa.Column("step", sa.Integer(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("user", sa.String(length=60), nullable=False),
        sa.Column("started", sa.DateTime(), nullable=False),
        sa.Column("finished", sa.DateTime(), nullable=True),
        sa.ForeignKeyConstraint(
            ["stack_id"], ["stacks.id"], name=op.f("fk_stack_runs_stack_id_stacks"), ondelete="SET NULL"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_stack_runs")),
    )
    with op.batch_alter_table("stack_runs", schema=None) as batch_op:
        batch_op.create_index(batch_op.f("ix_stack_runs_state"), ["state"], unique=False)
    with op.batch_alter_table("commands", schema=None) as batch_op:
        batch_op.drop_constraint(batch_op.f("fk_commands_run_id_procedure_runs"), type_="foreignkey")
    op.execute("UPDATE commands SET run_id = NULL")
    with op.batch_alter_table("commands", schema=None) as batch_op:
        batch_op.create_foreign_key(batch_op.f("fk_commands_run_id_stack_runs"), "stack_runs", ["run_id"], ["id"])
