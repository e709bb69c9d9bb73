"""Execution of procedures. One procedure runs at a time. An operator runs each step, or the server runs steps automatically until
it needs an operator. If the line is lost, an automatic run pauses until an operator continues it, or until the next acquisition of
signal for the run of a pass plan.

An entry is stored before its step is executed, so the run continues after a restart of the server: a wait continues,
and a command is looked up in the record of commands and never sent twice. A run of a pass plan becomes interrupted
instead, because the plan has ended. An operator can resume the run. ABORT ends the run.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from gss.domain.errors import BadInput, Conflict, GssError
from gss.operations.clock import Now, iso_z
from gss.operations.commanding.command_record import CommandChanged
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.line.line_events import AbortIssued, LineBatch
from gss.operations.line.link import LinkService
from gss.operations.procedures.conditions import Conditions
from gss.operations.procedures.document import read_procedure
from gss.operations.procedures.procedures import ProcedureService
from gss.operations.procedures.run_record import INTERRUPTED, ProcedureRecorder, StepEntry, open_entry
from gss.operations.procedures.step_actions import ActiveRun, StepActions, StepRequest, with_command
from gss.operations.procedures.validation import command_of, confirmation_of
from gss.store import procedures as store
from gss.store.engine import Database
from gss.store.models import ProcedureRun

log = logging.getLogger("gss.procedures")
LOOK_EVERY_S = 0.5


class ProcedureRunner:
    """Runs procedures. ``handle`` receives ABORT and the results of commands."""

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
        self._procedures, self._link, self._commands = procedures, link, commands
        self._database, self._bus, self._now = database, bus, now
        self._record = ProcedureRecorder(database, bus, now)
        self._actions = StepActions(conditions, link, commands, self._record, bus, now)
        self._lock, self._wake, self._stopping = threading.RLock(), threading.Event(), False
        self._active: ActiveRun | None = None
        self._aborted_by = ""
        self._thread: threading.Thread | None = None

    # --- life ---------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Resume the run that was active when the previous server ended, and start the thread. An operator must start the next
        step of the run."""
        with self._database.unit_of_work() as session:
            row = store.running(session)
        if row is not None:
            self._active = ActiveRun(row.id, read_procedure(row.text), self._commands.aborts)
            self._record.change(row.id, automatic=False)
            self._recover(row)
        self._thread = threading.Thread(target=self._run, name="procedures", daemon=True)
        self._thread.start()

    def _recover(self, row: ProcedureRun) -> ProcedureRun:
        """If the sending of a command was interrupted, by the end of the server or a failure of the store, determine whether the
        command was queued, and update the entry. Return the run's row."""
        entry = open_entry(row)
        if entry is None or entry.state != "sending":
            return row
        if entry.command_id is not None:  # it was sent again
            return self._record.update(row.id, replace(entry, state="running"))
        with self._database.unit_of_work() as session:
            command_row = store.first_command(session, row.id, datetime.fromisoformat(entry.began))
        if command_row is None:
            return self._record.close(row.id, "failed", "The command was not queued, so it was not sent.")
        return self._record.update(row.id, with_command(entry, command_row))

    def shut_down(self) -> None:
        """Stop the thread. The run continues after the next start of the server."""
        self._stopping = True
        self._wake.set()
        if self._thread is not None:
            self._thread.join(timeout=5)

    def handle(self, batch: LineBatch) -> None:
        """Receive ABORT and the results of commands, and wake the thread that processes them."""
        for event in batch.events:
            if isinstance(event, AbortIssued):
                self._aborted_by = event.user
                self._wake.set()
            elif isinstance(event, CommandChanged):
                self._wake.set()

    # --- requests of people -------------------------------------------------------------------------------------

    def begin(
        self,
        procedure_id: int,
        *,
        user: str,
        sha256: str = "",
        automatic: bool = False,
        confirmed: Sequence[str] = (),
        aborts: int | None = None,
    ) -> ProcedureRun:
        """Start a run of a procedure. No command is sent by this call. ``sha256``: hash of the text that the user has, "" for any
        text. ``confirmed``: names of hazardous commands that an automatic run sends without another confirmation. ``aborts``:
        number of ABORTs that the run's pass plan has handled, None without a plan. Raises BadInput with the first mistake, Conflict
        if the text is another one or another procedure is running. An automatic run also raises NotPermitted if the user does not
        have the permission for one of the commands, Conflict if another user holds command authority or the line is down."""
        document = self._procedures.valid(procedure := self._procedures.get(procedure_id, sha256))
        if automatic:
            self.confirmations(procedure_id, user=user)
            self._check_automatic(user)
        with self._lock:
            self._require_none_active()
            self._aborted_by, before = "", self._commands.aborts if aborts is None else aborts
            contact = self._link.contact_id if self._link.connected else None
            row = self._record.begin(
                procedure, document.steps[0].id, self._link.dictionary.device_model, contact, user, automatic
            )
            self._active = ActiveRun(row.id, document, before, frozenset(confirmed), aborts is not None)
        self._bus.record("procedure", "ok", f"{user} started the procedure {row.name}", procedure_run_id=row.id)
        self._wake.set()
        return row

    def confirmations(self, procedure_id: int, *, user: str) -> list[str]:
        """Return the names that confirm the hazardous commands of a procedure. Raises NotPermitted if the user does not have the
        permission for one of its commands, BadInput with the first mistake."""
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
        """Run the current step. ``step_id``: id of the step that the user saw as current. A late click therefore cannot
        run another step. Raises Conflict, BadInput, NotPermitted. A condition that is not met and a command that cannot
        be sent are recorded as entries."""
        with self._lock:
            run = self._check_current(run_id, step_id)
            request = StepRequest(user, answer, confirm, note.strip())
            row = self._settled(self._actions.perform(run, run.document.step(step_id), request))
        self._wake.set()
        return row

    def skip(self, run_id: int, step_id: str, reason: str, *, user: str) -> ProcedureRun:
        """Continue after the current step without running it. Raises BadInput without a reason, Conflict if the step cannot be
        skipped."""
        if not reason.strip():
            raise BadInput("Skipping a step needs a reason", expected="1 – 500 characters")
        with self._lock:
            run = self._check_current(run_id, step_id)
            self._commands.check_user(user)
            step = run.document.step(step_id)
            if step.kind in ("question", "branch"):
                raise Conflict("A step that chooses the next one cannot be skipped", got=step.kind)
            at = iso_z(self._now())
            entry = StepEntry(step.id, step.title, step.kind, "skipped", user, at, at, note=reason.strip())
            self._record.add(run_id, entry)
            row = self._settled(self._actions.advance(run, step, "next"))
        self._wake.set()
        return row

    def set_automatic(self, run_id: int, automatic: bool, *, user: str) -> ProcedureRun:
        """Switch automatic execution on or off. If it is on, steps run on behalf of this user until an operator is needed."""
        with self._lock:
            self._active_run(run_id)
            if automatic:
                self._check_automatic(user)
            row = self._record.change(run_id, automatic=automatic, **({"user": user} if automatic else {}))
        self._wake.set()
        return row

    def _check_automatic(self, user: str) -> None:
        """Raise Conflict if steps cannot run automatically: another user holds command authority, or the line is down."""
        self._commands.check_user(user)
        self._commands.check_line()

    def hold(self, run_id: int) -> None:
        """Suspend a run until ``release`` after a loss of signal. No further step is run and no check is evaluated. A
        command that was sent is still monitored. Has no effect on a run that is not active."""
        with self._lock:
            active = self._active
            if active is not None and active.id == run_id and active.held_since_s is None:
                self._active = replace(active, held_since_s=self._link.monotonic_s())

    def release(self, run_id: int) -> None:
        """Continue a suspended run. The time limit of a check in progress is extended by the time of the suspension."""
        with self._lock:
            active = self._active
            if active is not None and active.id == run_id and active.held_since_s is not None:
                self._actions.extend_check(active)
                self._active = replace(active, held_since_s=None)
        self._wake.set()

    def stop(self, run_id: int, reason: str, *, user: str) -> ProcedureRun:
        """End the run. A queued command is withdrawn. The result of a command that was sent is still recorded."""
        with self._lock:
            self._active_run(run_id)
            entry = open_entry(self.get(run_id))
            if entry is not None:
                self._actions.withdraw(entry, user)
            message = f"stopped by {user}" + (f": {reason.strip()}" if reason.strip() else "")
            return self._finish(run_id, "stopped", message)

    def interrupt(self, run_id: int, reason: str) -> None:
        """End a run at its current step, so that another procedure can start. ``resume`` continues the run. Has no effect on a run
        that has ended."""
        with self._lock:
            if self._active is not None and self._active.id == run_id:
                self._finish(run_id, INTERRUPTED, reason)

    def resume(self, run_id: int, *, user: str) -> ProcedureRun:
        """Make an interrupted run active again. An operator then runs its current step. If a command of this step was sent before
        and its result is unknown, it is sent again with the same request id, so the unit does not execute it twice. Raises
        Conflict."""
        with self._lock:
            row = self.get(run_id)
            if row.state != INTERRUPTED:
                raise Conflict("Only an interrupted run can be resumed", expected=INTERRUPTED, got=row.state)
            self._require_none_active()
            self._aborted_by, aborts = "", self._commands.aborts
            previous_sha256, row = row.sha256, self._record.reopen(run_id)
            self._active = ActiveRun(run_id, read_procedure(row.text), aborts)
        message = f"{user} resumed the procedure {row.name}; record before resuming {previous_sha256[:12]}"
        self._bus.record("procedure", "ok", message, procedure_run_id=run_id)
        return row

    def get(self, run_id: int) -> ProcedureRun:
        """Return the run with that id. Raises NotFound."""
        return self._record.get(run_id)

    def newest(self, limit: int, procedure_id: int | None = None, before: int | None = None) -> list[ProcedureRun]:
        """Return the latest runs, newest first. ``procedure_id``: only runs of this procedure; ``before``: only runs
        started before the run with this id."""
        with self._database.unit_of_work() as session:
            return store.newest_runs(session, limit, procedure_id, before)

    def state(self, run_id: int) -> tuple[ProcedureRun, str]:
        """Return a run and the id of the step that waits for an operator, "" if no step waits. Raises NotFound."""
        with self._lock:
            row, active = self.get(run_id), self._active
            if active is None or active.id != run_id or open_entry(row) is not None:
                return row, ""
            unattended = row.automatic and self._actions.is_unattended(active, active.document.step(row.current))
            return row, "" if unattended else row.current

    def between(self, start: datetime, end: datetime) -> list[ProcedureRun]:
        """Return the runs that were in progress in a time span, oldest first."""
        with self._database.unit_of_work() as session:
            return store.between(session, start, end)

    def _require_none_active(self) -> None:
        if self._active is not None:
            raise Conflict(
                "Another procedure is running", got=f"run {self._active.id}", hint="finish it or stop it first"
            )

    def _active_run(self, run_id: int) -> ActiveRun:
        """Return the active run. Raises Conflict if the run with this id is not active."""
        active, row = self._active, self._settled(self.get(run_id))
        if active is None or active.id != run_id or row.state != store.RUNNING:
            raise Conflict("This run has ended", got=row.state)
        return active

    def _check_current(self, run_id: int, step_id: str) -> ActiveRun:
        self._active_run(run_id)
        self._end_if_aborted()
        active = self._active_run(run_id)
        row = self.get(run_id)
        if row.current != step_id:
            raise Conflict("This is not the current step", expected=row.current, got=step_id[:40])
        entry = open_entry(row)
        if entry is not None:
            raise Conflict("The step is already in progress", got=f"{entry.state}, started {entry.began}")
        return active

    def _finish(self, run_id: int, state: str, reason: str) -> ProcedureRun:
        return self._settled(self._record.freeze(run_id, state, reason))

    def _settled(self, row: ProcedureRun) -> ProcedureRun:
        """Clear the active run if this row shows that it has ended. Return the row."""
        if self._active is not None and self._active.id == row.id and row.state != store.RUNNING:
            self._active = None
        return row

    # --- thread -------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stopping:
            self._wake.wait(LOOK_EVERY_S if self._active else None)
            self._wake.clear()
            try:
                self.tick()
            except GssError as error:  # the store is down, or a command was rejected; the rejection is already recorded
                log.warning("procedure: %s", error)

    def tick(self) -> None:
        """End the run after ABORT, update the step in progress, and run the next steps of an automatic run."""
        with self._lock:
            self._end_if_aborted()
            while self._active is not None and not self._stopping:
                run, row = self._active, self._settled(self.get(self._active.id))
                if row.state != store.RUNNING:  # its end is stored, but the store failed before it was published
                    return
                row = self._recover(row)
                before, step = (row.current, len(row.entries), row.entries[-1:]), run.document.step(row.current)
                if row.automatic and not run.planned and not self._link.connected:
                    row = self._record.change(run.id, automatic=False)
                    message = f"Procedure {row.name} paused at step {row.current}: the line is down"
                    self._bus.record("procedure", "watch", message, procedure_run_id=run.id)
                entry = open_entry(row)
                if entry is not None:
                    entry = self._actions.on_present_clock(run, row, entry)
                    row = self._settled(self._actions.continue_step(run, row, entry))
                elif self._can_continue(run, row) and self._actions.is_unattended(run, step):
                    request = StepRequest(row.user, confirm=self._actions.confirmation(step))
                    row = self._settled(self._actions.perform(run, step, request))
                if (row.current, len(row.entries), row.entries[-1:]) == before:
                    return

    def _can_continue(self, run: ActiveRun, row: ProcedureRun) -> bool:
        """True if the next step of a run can start without a request of an operator."""
        return row.automatic and run.held_since_s is None and self._link.connected

    def _end_if_aborted(self) -> None:
        if (
            self._aborted_by
            and self._active is not None
            and self._settled(self.get(self._active.id)).state == store.RUNNING
        ):
            self._finish(self._active.id, "aborted", f"ABORT by {self._aborted_by}")
        self._aborted_by = ""
