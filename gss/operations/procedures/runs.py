"""Runs procedures: one at a time, a step when a person runs it, or step after step until a person is needed.

Every entry is stored before its step acts, so that a restart of the server continues the run: a wait continues, and a command is
looked up in the record of commands and never sent twice. ABORT ends the run. A condition that cannot be evaluated fails the step.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from gss.domain.errors import BadInput, Conflict, GssError
from gss.operations.clock import Now, iso_z
from gss.operations.commanding.command_record import CommandChanged
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.line.line_events import AbortIssued, LineBatch
from gss.operations.line.link import LinkService
from gss.operations.procedures.conditions import Conditions
from gss.operations.procedures.document import ProcedureDocument, ProcedureStep, read_procedure
from gss.operations.procedures.procedures import ProcedureService
from gss.operations.procedures.run_record import ProcedureRecorder, StepEntry, entries_of, open_entry
from gss.operations.procedures.validation import command_of, confirmation_of
from gss.store import procedures as store
from gss.store.engine import Database
from gss.store.models import Command, ProcedureRun

log = logging.getLogger("gss.procedures")
SOURCE = "procedure"
LOOK_EVERY_S = 0.5
ENDED = ("completed", "rejected", "failed", "unknown", "resolved", "withdrawn")
UNATTENDED = ("text", "check", "command", "wait", "branch")
"""Kinds of steps that need no person."""


@dataclass(frozen=True)
class ActiveRun:
    """The run that has not ended. ``confirmed``: names of hazardous commands that a user confirmed before the start.
    ``held_since``: since when the run waits for a signal."""

    id: int
    document: ProcedureDocument
    confirmed: frozenset[str] = frozenset()
    held_since: datetime | None = None


class ProcedureRunner:
    """Runs procedures. ``handle`` follows ABORT and the results of commands."""

    def __init__(
        self,
        procedures: ProcedureService,
        conditions: Conditions,
        link: LinkService,
        commands: CommandService,
        database: Database,
        bus: EventBus,
        now: Now,
    ) -> None:
        self._procedures, self._conditions, self._link, self._commands = procedures, conditions, link, commands
        self._database, self._bus, self._now = database, bus, now
        self._record = ProcedureRecorder(database, bus, now)
        self._lock, self._wake, self._stopping = threading.RLock(), threading.Event(), False
        self._active: ActiveRun | None = None
        self._aborts, self._aborted_by = 0, ""
        self._thread: threading.Thread | None = None

    # --- life ---------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Continue the run that the last server left: a person starts its next step."""
        with self._database.unit_of_work() as session:
            row = store.running(session)
        if row is not None:
            self._aborts = self._commands.aborts
            self._active = ActiveRun(row.id, read_procedure(row.text))
            self._record.change(row.id, automatic=False)
            entry = open_entry(row)
            if entry is not None and entry.state == "sending":
                self._recover(row, entry)
        self._thread = threading.Thread(target=self._run, name="procedures", daemon=True)
        self._thread.start()

    def _recover(self, row: ProcedureRun, entry: StepEntry) -> None:
        """Find out whether the command was queued before the server stopped."""
        step = self._document(row.id).step(entry.step)
        command, _ = command_of(step, self._link.roles.operations)
        with self._database.unit_of_work() as session:
            command_row = store.first_command(session, SOURCE, command.name, datetime.fromisoformat(entry.began))
        if command_row is None:
            self._record.close(row.id, "failed", "The server stopped before the command was queued. It was not sent.")
        else:
            self._record.update(row.id, _with_command(entry, command_row))

    def shut_down(self) -> None:
        """Stop following; the run continues after the next start."""
        self._stopping = True
        self._wake.set()
        if self._thread is not None:
            self._thread.join(timeout=5)

    def handle(self, batch: LineBatch) -> None:
        """Take ABORT and the results of commands; the work is done on the thread."""
        for event in batch.events:
            if isinstance(event, AbortIssued):
                self._aborted_by = event.user
                self._wake.set()
            elif isinstance(event, CommandChanged):
                self._wake.set()

    # --- requests of people -------------------------------------------------------------------------------------

    def begin(
        self, procedure_id: int, *, user: str, automatic: bool = False, confirmed: Sequence[str] = ()
    ) -> ProcedureRun:
        """Start a run of a valid procedure; nothing is sent yet. ``confirmed``: names of hazardous commands that an automatic run
        sends without another confirmation. Raises BadInput with its first mistake, Conflict while another one runs."""
        procedure = self._procedures.get(procedure_id)
        document = self._procedures.valid(procedure)
        with self._lock:
            if self._active is not None:
                raise Conflict(
                    "Another procedure is running", got=f"run {self._active.id}", hint="finish it or stop it first"
                )
            self._aborts, self._aborted_by = self._commands.aborts, ""
            contact = self._link.contact_id if self._link.connected else None
            row = self._record.begin(
                procedure, document.steps[0].id, self._link.dictionary.device_model, contact, user, automatic
            )
            self._active = ActiveRun(row.id, document, frozenset(confirmed))
        self._bus.record("procedure", "ok", f"{user} started the procedure {row.name}", procedure_run_id=row.id)
        self._wake.set()
        return row

    def confirmations(self, procedure_id: int, *, user: str) -> list[str]:
        """Return the names that confirm the hazardous commands of a procedure. Raises NotPermitted if the user may not send one
        of its commands, BadInput with its first mistake."""
        operations = self._link.roles.operations
        names: dict[str, None] = {}
        for step in self._procedures.valid(self._procedures.get(procedure_id)).steps:
            if step.kind == "command":
                command, arguments = command_of(step, operations)
                self._commands.check_permitted(user, command.name, arguments)
                names[confirmation_of(step, operations)] = None
        return [name for name in names if name]

    def run_step(
        self, run_id: int, step_id: str, *, user: str, answer: str = "", confirm: str = "", note: str = ""
    ) -> ProcedureRun:
        """Run the current step. ``step_id`` must name it, so that a late click does not run another one. Raises Conflict, BadInput,
        NotPermitted; a condition that is not met and a command that cannot be sent become entries of the record."""
        with self._lock:
            self._check_current(run_id, step_id)
            return self._perform(run_id, self._document(run_id).step(step_id), user, answer, confirm, note.strip())

    def skip(self, run_id: int, step_id: str, reason: str, *, user: str) -> ProcedureRun:
        """Continue behind the current step without running it. Raises BadInput without a reason."""
        if not reason.strip():
            raise BadInput("Skipping a step needs a reason", expected="1 – 500 characters")
        with self._lock:
            self._check_current(run_id, step_id)
            self._commands.check_user(user)
            step = self._document(run_id).step(step_id)
            if step.kind in ("question", "branch"):
                raise Conflict("A step that chooses the next one cannot be skipped", got=step.kind)
            at = iso_z(self._now())
            entry = StepEntry(step.id, step.title, step.kind, "skipped", user, at, at, note=reason.strip())
            self._record.add(run_id, entry)
            return self._advance(run_id, step, "next")

    def set_automatic(self, run_id: int, automatic: bool, *, user: str) -> ProcedureRun:
        """Run the following steps without a person, on behalf of this user, until one is needed; or stop doing so."""
        with self._lock:
            self._document(run_id)
            if automatic:
                self._commands.check_user(user)
            row = self._record.change(run_id, automatic=automatic, **({"user": user} if automatic else {}))
        self._wake.set()
        return row

    def hold(self, run_id: int) -> None:
        """Run no further step and judge no check until ``release``: the signal is lost. A command that was sent is followed."""
        with self._lock:
            active = self._active
            if active is not None and active.id == run_id and active.held_since is None:
                self._active = replace(active, held_since=self._now())

    def release(self, run_id: int) -> None:
        """Continue a run that was held; a check under way gets the time back that it was held."""
        with self._lock:
            active = self._active
            if active is not None and active.id == run_id and active.held_since is not None:
                entry = open_entry(self.get(run_id))
                if entry is not None and entry.kind == "check" and entry.due:
                    lost = self._now() - max(active.held_since, datetime.fromisoformat(entry.began))
                    self._record.update(run_id, _due(entry, datetime.fromisoformat(entry.due) + lost))
                self._active = replace(active, held_since=None)
        self._wake.set()

    def stop(self, run_id: int, reason: str, *, user: str) -> ProcedureRun:
        """End the run; a command that was sent is still followed on its own."""
        with self._lock:
            self._document(run_id)
            words = f"stopped by {user}" + (f": {reason.strip()}" if reason.strip() else "")
            return self._finish(run_id, "stopped", words)

    def get(self, run_id: int) -> ProcedureRun:
        """Return the run with that id. Raises NotFound."""
        return self._record.get(run_id)

    def newest(self, limit: int) -> list[ProcedureRun]:
        """Return the newest runs first."""
        with self._database.unit_of_work() as session:
            return store.newest_runs(session, limit)

    def state(self, run_id: int) -> tuple[ProcedureRun, str]:
        """Return a run, and the name of its step that starts only when a person runs it; "" if none waits. Raises NotFound."""
        with self._lock:
            row, active = self.get(run_id), self._active
            if active is None or active.id != run_id or open_entry(row) is not None:
                return row, ""
            return row, "" if row.automatic and self._needs_no_one(active.document.step(row.current)) else row.current

    def between(self, start: datetime, end: datetime) -> list[ProcedureRun]:
        """Return the runs that were under way in a span, oldest first."""
        with self._database.unit_of_work() as session:
            return store.between(session, start, end)

    def _document(self, run_id: int) -> ProcedureDocument:
        active = self._active
        if active is None or active.id != run_id:
            raise Conflict("This run has ended", got=self.get(run_id).state)
        return active.document

    def _check_current(self, run_id: int, step_id: str) -> None:
        self._document(run_id)
        self._end_if_aborted()
        self._document(run_id)
        row = self.get(run_id)
        if row.current != step_id:
            raise Conflict("This is not the current step", expected=row.current, got=step_id[:40])
        entry = open_entry(row)
        if entry is not None:
            raise Conflict("The step is under way", got=f"{entry.state}, begun {entry.began}")

    # --- steps --------------------------------------------------------------------------------------------------

    def _perform(
        self, run_id: int, step: ProcedureStep, user: str, answer: str, confirm: str, note: str
    ) -> ProcedureRun:
        entry = StepEntry(step.id, step.title, step.kind, "running", user, iso_z(self._now()), note=note)
        if step.kind == "command":
            return self._send(run_id, step, entry, confirm)
        if step.kind == "check":
            return self._check(run_id, step, entry)
        if step.kind == "branch":
            return self._branch(run_id, step, entry)
        if step.kind == "wait":
            return self._record.add(run_id, _due(entry, self._now() + timedelta(seconds=step.seconds)))
        if step.kind == "question":
            if answer not in [branch.when for branch in step.branches]:
                expected = " | ".join(branch.when for branch in step.branches)
                raise BadInput("The question needs one of its answers", expected=expected, got=answer[:80])
        elif step.kind == "hold" and user == self._first_person(run_id):
            raise Conflict("A second person must confirm this step", expected=f"another user than {user}")
        self._record.add(run_id, entry)
        self._record.close(run_id, "done", answer)
        return self._advance(run_id, step, step.target(answer) if step.kind == "question" else "next")

    def _first_person(self, run_id: int) -> str:
        """Return who ran the last step other than a hold point; the person who started the run if there is none."""
        row = self.get(run_id)
        return next((e.by for e in reversed(entries_of(row)) if e.kind != "hold"), row.user)

    def _check(self, run_id: int, step: ProcedureStep, entry: StepEntry) -> ProcedureRun:
        if step.seconds:
            entry = _due(entry, self._now() + timedelta(seconds=step.seconds))
        self._record.add(run_id, entry)
        return self._look(run_id, step, entry)

    def _look(self, run_id: int, step: ProcedureStep, entry: StepEntry) -> ProcedureRun:
        """Evaluate a check that is under way; end it if it is met or its time is over."""
        result, values = self._conditions.evaluate(step.words, self._now())
        if result.value is True:
            self._record.close(run_id, "done", "met", values=values)
            return self._advance(run_id, step, "next")
        if entry.due and self._now() < datetime.fromisoformat(entry.due):
            return self.get(run_id)
        within = f" within {step.seconds:g} s" if step.seconds else ""
        other = any(branch.when == "else" for branch in step.branches)
        if result.value is False and other:
            self._record.close(run_id, "done", f"not met{within}: continued at {step.target('else')}", values=values)
            return self._advance(run_id, step, step.target("else"))
        why = f"not met{within}" if result.value is False else f"unknown{within}: {result.reason}"
        return self._fail(run_id, f"The check is {why}.", values)

    def _branch(self, run_id: int, step: ProcedureStep, entry: StepEntry) -> ProcedureRun:
        self._record.add(run_id, entry)
        used: dict[str, float | bool | str | None] = {}
        for branch in step.branches[:-1]:
            result, values = self._conditions.evaluate(branch.when.removeprefix("if "), self._now())
            used |= values
            if result.value is None:
                return self._fail(run_id, f"The condition “{branch.when}” is unknown: {result.reason}.", used)
            if result.value is True:
                self._record.close(run_id, "done", f"{branch.when}: continued at {branch.target}", values=used)
                return self._advance(run_id, step, branch.target)
        self._record.close(run_id, "done", f"else: continued at {step.branches[-1].target}", values=used)
        return self._advance(run_id, step, step.branches[-1].target)

    def _send(self, run_id: int, step: ProcedureStep, entry: StepEntry, confirm: str) -> ProcedureRun:
        """Send a step's command. The entry is stored first: a server that dies now looks the command up after its start."""
        command, arguments = command_of(step, self._link.roles.operations)
        earlier = self._earlier(run_id, step)
        if earlier is not None and earlier.result == "completed":
            self._record.add(run_id, _with_command(entry, earlier))
            return self._follow(run_id, step)
        self._record.add(run_id, _sending(entry))
        try:
            if earlier is not None:
                row = self._commands.retry(earlier.id, user=entry.by)
            else:
                row = self._commands.send(
                    command.name, arguments, confirm=confirm, user=entry.by, source=SOURCE, aborts=self._aborts
                )
        except GssError as error:
            self._fail(run_id, f"The command was not sent: {error}")
            raise
        return self._record.update(run_id, _with_command(entry, row))

    def _earlier(self, run_id: int, step: ProcedureStep) -> Command | None:
        """Return the step's command of the failed attempt just before, if it may have run: unknown, or completed late."""
        entries = entries_of(self.get(run_id))
        if not entries or entries[-1].step != step.id or entries[-1].command_id is None:
            return None
        row = self._commands.get(entries[-1].command_id)
        return row if row.result in ("unknown", "completed") else None

    def _follow(self, run_id: int, step: ProcedureStep) -> ProcedureRun:
        """End a command's step when the command has ended."""
        entry = open_entry(self.get(run_id))
        if entry is None or entry.command_id is None:
            return self.get(run_id)
        row = self._commands.get(entry.command_id)
        if row.result not in ENDED:
            return self.get(run_id)
        if row.result == "completed":
            self._record.close(run_id, "done", "completed")
            return self._advance(run_id, step, "next")
        detail = f": {row.detail}" if row.detail else ""
        return self._fail(run_id, f"The command ended {row.result}{detail}")

    def _fail(
        self, run_id: int, detail: str, values: dict[str, float | bool | str | None] | None = None
    ) -> ProcedureRun:
        """End the step as failed and wait for a person, who runs it again, skips it, or stops the run."""
        self._record.close(run_id, "failed", detail, values=values)
        row = self._record.change(run_id, automatic=False)
        self._bus.record(
            "procedure", "warning", f"Procedure {row.name}, step {row.current}: {detail}", procedure_run_id=run_id
        )
        return row

    def _advance(self, run_id: int, step: ProcedureStep, target: str) -> ProcedureRun:
        following = self._document(run_id).after(step, target)
        if following is None:
            return self._finish(run_id, "completed", "")
        self._wake.set()
        return self._record.move(run_id, following)

    def _finish(self, run_id: int, state: str, reason: str) -> ProcedureRun:
        row = self._record.freeze(run_id, state, reason)
        self._active = None
        return row

    # --- thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stopping:
            self._wake.wait(LOOK_EVERY_S if self._active else None)
            self._wake.clear()
            try:
                self.tick()
            except GssError as error:  # the store is down, or a command was refused, which is on the record
                log.warning("procedure: %s", error)

    def tick(self) -> None:
        """Do what does not need a person: end on ABORT, follow what is under way, run the next steps of an automatic run."""
        with self._lock:
            self._end_if_aborted()
            while self._active is not None and not self._stopping:
                run_id, document = self._active.id, self._active.document
                row = self.get(run_id)
                before, step = (row.current, len(row.entries), row.entries[-1:]), document.step(row.current)
                entry = open_entry(row)
                if entry is not None:
                    row = self._continue(row, step, entry)
                elif row.automatic and self._active.held_since is None and self._needs_no_one(step):
                    row = self._perform(run_id, step, row.user, "", self._confirmation(step), "")
                if (row.current, len(row.entries), row.entries[-1:]) == before:
                    return

    def _end_if_aborted(self) -> None:
        if self._aborted_by and self._active is not None:
            self._finish(self._active.id, "aborted", f"ABORT by {self._aborted_by}")
        self._aborted_by = ""

    def _continue(self, row: ProcedureRun, step: ProcedureStep, entry: StepEntry) -> ProcedureRun:
        if entry.kind == "command":
            return self._follow(row.id, step)
        held = self._active is not None and self._active.held_since is not None
        if entry.kind == "check" and not held:
            return self._look(row.id, step, entry)
        if entry.kind == "wait" and self._now() >= datetime.fromisoformat(entry.due):
            self._record.close(row.id, "done", f"waited {step.seconds:g} s")
            return self._advance(row.id, step, "next")
        return row

    def _needs_no_one(self, step: ProcedureStep) -> bool:
        if step.kind == "command" and self._active is not None:
            name = confirmation_of(step, self._link.roles.operations)
            return not name or name in self._active.confirmed
        return step.kind in UNATTENDED

    def _confirmation(self, step: ProcedureStep) -> str:
        """Return the text that confirms a command which was confirmed before the start; "" for any other step."""
        return confirmation_of(step, self._link.roles.operations) if step.kind == "command" else ""


def _due(entry: StepEntry, at: datetime) -> StepEntry:
    return replace(entry, due=iso_z(at))


def _sending(entry: StepEntry) -> StepEntry:
    return replace(entry, state="sending")


def _with_command(entry: StepEntry, row: Command) -> StepEntry:
    return replace(entry, state="running", command_id=row.id)
