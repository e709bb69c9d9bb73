"""Records of procedure runs. Each change is stored and published. At the end of a run, the hash of its record is stored."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from typing import Any, Literal

from pydantic import TypeAdapter

from gss.domain.errors import Conflict
from gss.operations.clock import Now, iso_z
from gss.operations.events import EventBus
from gss.store import procedures as store
from gss.store.engine import Database
from gss.store.models import Procedure, ProcedureRun

Values = dict[str, float | bool | str | None]
EntryState = Literal["sending", "running", "done", "failed", "skipped"]
INTERRUPTED = "interrupted"
"""State of a run that ended without a decision of an operator. It can be resumed at its current step."""
FORMAT, VERSION = "gss-procedure-record", 1


@dataclass(frozen=True)
class StepEntry:
    """Record of a step that was run. ``by``: user who ran it. ``detail``: result or reason. ``values``: telemetry
    values that a condition used. ``due``: latest time at which a wait or a check ends. Times are ISO 8601, UTC."""

    step: str
    title: str
    kind: str
    state: EntryState
    by: str
    began: str
    ended: str = ""
    detail: str = ""
    values: Values | None = None
    command_id: int | None = None
    due: str = ""
    note: str = ""


ENTRIES = TypeAdapter(list[StepEntry])


def entries_of(row: ProcedureRun) -> list[StepEntry]:
    """Return the entries of a run, oldest first."""
    return ENTRIES.validate_python(row.entries)


def open_entry(row: ProcedureRun) -> StepEntry | None:
    """Return the entry of the step in progress, None if no step is in progress."""
    entries = entries_of(row)
    return entries[-1] if entries and entries[-1].state in ("sending", "running") else None


def record_bytes(row: ProcedureRun) -> bytes:
    """Return the record of a run as canonical JSON: sorted keys, no spaces, UTF-8."""
    record = {
        "format": FORMAT,
        "version": VERSION,
        "run": row.id,
        "procedure": row.name,
        "text": row.text,
        "text_sha256": hashlib.sha256(row.text.encode()).hexdigest(),
        "instrument": row.instrument,
        "contact": row.contact_id,
        "started_by": row.user,
        "started": iso_z(row.started),
        "finished": iso_z(row.finished) if row.finished else None,
        "state": row.state,
        "reason": row.reason,
        "entries": [asdict(entry) for entry in entries_of(row)],
    }
    return json.dumps(record, ensure_ascii=False, sort_keys=True, separators=(",", ":")).encode()


def is_intact(row: ProcedureRun) -> bool:
    """True if the record of an ended run still has the hash that was stored at its end."""
    return row.sha256 == hashlib.sha256(record_bytes(row)).hexdigest()


class ProcedureRecorder:
    """Stores the state of each run and of its steps."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now

    def begin(
        self, procedure: Procedure, first: str, instrument: str, contact_id: int | None, user: str, automatic: bool
    ) -> ProcedureRun:
        """Store a new run and return its row."""
        row = ProcedureRun(
            procedure_id=procedure.id,
            name=procedure.name,
            text=procedure.text,
            instrument=instrument,
            contact_id=contact_id,
            user=user,
            automatic=automatic,
            state="running",
            current=first,
            entries=[],
            reason="",
            started=self._now(),
            sha256="",
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
        self._bus.publish("procedure_run", row)
        return row

    def get(self, run_id: int) -> ProcedureRun:
        """Return the run with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get_run(session, run_id)

    def add(self, run_id: int, entry: StepEntry) -> ProcedureRun:
        """Append an entry and return the run's row."""
        return self._write(run_id, entry, replaces=False)

    def update(self, run_id: int, entry: StepEntry) -> ProcedureRun:
        """Replace the last entry and return the run's row."""
        return self._write(run_id, entry, replaces=True)

    def _write(self, run_id: int, entry: StepEntry, *, replaces: bool, automatic: bool | None = None) -> ProcedureRun:
        with self._database.unit_of_work() as session:
            row = store.get_run(session, run_id)
            entries = list(row.entries)[: -1 if replaces else None]
            row.entries = [*entries, asdict(entry)]
            row.automatic = row.automatic if automatic is None else automatic
        self._bus.publish("procedure_run", row)
        return row

    def close(self, run_id: int, state: EntryState, detail: str, values: Values | None = None) -> ProcedureRun:
        """End the last entry and return the run's row. If the entry failed, automatic execution is switched off."""
        entry = entries_of(self.get(run_id))[-1]
        ended = replace(entry, state=state, detail=detail, ended=iso_z(self._now()), values=values)
        return self._write(run_id, ended, replaces=True, automatic=False if state == "failed" else None)

    def move(self, run_id: int, current: str) -> ProcedureRun:
        """Set the current step and return the run's row."""
        return self.change(run_id, current=current)

    def change(self, run_id: int, **values: Any) -> ProcedureRun:
        """Change columns of the run's row and return it."""
        with self._database.unit_of_work() as session:
            row = store.get_run(session, run_id)
            for name, value in values.items():
                setattr(row, name, value)
        self._bus.publish("procedure_run", row)
        return row

    def freeze(self, run_id: int, state: str, reason: str) -> ProcedureRun:
        """End a run and store the hash of its record, which is not changed afterwards. Raises Conflict if the run has ended."""
        with self._database.unit_of_work() as session:
            row = store.get_run(session, run_id)
            if row.state != store.RUNNING:
                raise Conflict("This run has ended", got=row.state)
            at = self._now()
            row.state, row.reason, row.finished = state, reason, at
            row.current = row.current if state == INTERRUPTED else ""
            row.automatic = False
            row.entries = [self._ended(entry, at, reason) for entry in row.entries]
            session.flush()
            row.sha256 = hashlib.sha256(record_bytes(row)).hexdigest()
        self._bus.publish("procedure_run", row)
        severity = "ok" if state == "completed" else "watch"
        message = f"Procedure {row.name}: {state}" + (f", {reason}" if reason else "")
        self._bus.record("procedure", severity, f"{message}; record {row.sha256[:12]}", procedure_run_id=row.id)
        return row

    def reopen(self, run_id: int) -> ProcedureRun:
        """Set an interrupted run to running again. Its record is frozen again at its end."""
        return self.change(run_id, state=store.RUNNING, reason="", finished=None, sha256="")

    @staticmethod
    def _ended(entry: dict[str, object], at: datetime, reason: str) -> dict[str, object]:
        """Return the columns of an entry at the end of the run. An entry in progress becomes failed."""
        if entry["state"] not in ("sending", "running"):
            return entry
        detail = f"{entry['detail']}; {reason}".removeprefix("; ")
        return entry | {"state": "failed", "ended": iso_z(at), "detail": detail}
