"""Execution of the steps of a run. An entry is stored before its step is executed. A condition that cannot be evaluated fails."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from itertools import takewhile

from gss.domain.errors import BadInput, Conflict, GssError
from gss.operations.clock import Now, iso_z
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.line.link import LinkService
from gss.operations.procedures.conditions import Conditions
from gss.operations.procedures.document import ProcedureDocument, ProcedureStep
from gss.operations.procedures.run_record import (
    EntryState,
    ProcedureRecorder,
    StepEntry,
    Values,
    entries_of,
    open_entry,
)
from gss.operations.procedures.validation import command_of, confirmation_of
from gss.store.models import Command, ProcedureRun

SOURCE = "procedure"
ENDED = ("completed", "rejected", "failed", "unknown", "resolved", "withdrawn")
CLOCK_ERROR_S = 2.0
"""Largest difference of a stored time limit from the monotonic clock that is not corrected."""
UNATTENDED = ("text", "check", "command", "wait", "branch")
"""Kinds of steps that need no operator."""


@dataclass(frozen=True)
class ActiveRun:
    """The active run. ``confirmed``: names of hazardous commands that a user confirmed before the start. ``aborts``: number of
    ABORTs before the run; after a further ABORT the run sends no command. ``planned``: True for the run of a pass plan.
    ``held_since_s``: monotonic time since which the run of a plan has been waiting for a signal, None if it is not waiting."""

    id: int
    document: ProcedureDocument
    aborts: int
    confirmed: frozenset[str] = frozenset()
    planned: bool = False
    held_since_s: float | None = None


@dataclass(frozen=True)
class StepRequest:
    """Request to run a step: the user and the user's input."""

    user: str
    answer: str = ""
    confirm: str = ""
    note: str = ""


@dataclass(frozen=True)
class _TimeLimit:
    """Monotonic times at which an entry began and is due, and the same limit as stored in the entry."""

    began_s: float
    due_s: float
    due: str


class StepActions:
    """Executes steps of the active run. Methods that execute a step return the run's row. The run has ended if there is no
    further step.

    Waits and time limits are measured with the monotonic clock, because the server's clock can be corrected meanwhile.
    """

    def __init__(
        self,
        conditions: Conditions,
        link: LinkService,
        commands: CommandService,
        record: ProcedureRecorder,
        bus: EventBus,
        now: Now,
    ) -> None:
        self._conditions, self._link, self._commands = conditions, link, commands
        self._record, self._bus, self._now = record, bus, now
        self._limit: _TimeLimit | None = None
        self._last_end: tuple[str, float] | None = None
        """End of the last entry, as stored and in monotonic time."""

    def is_unattended(self, run: ActiveRun, step: ProcedureStep) -> bool:
        """True if the step can run without an operator. After a failed step, the remaining hazardous commands must be confirmed
        again."""
        if step.kind == "command":
            name = self.confirmation(step)
            return not name or (name in run.confirmed and not self._has_failed(run.id))
        return step.kind in UNATTENDED

    def _has_failed(self, run_id: int) -> bool:
        return any(entry.state == "failed" for entry in entries_of(self._record.get(run_id)))

    def confirmation(self, step: ProcedureStep) -> str:
        """Return the name that confirms a step's command, "" for other steps and if no confirmation is needed."""
        return confirmation_of(step, self._link.roles.operations) if step.kind == "command" else ""

    def perform(self, run: ActiveRun, step: ProcedureStep, request: StepRequest) -> ProcedureRun:
        """Execute a step. Raises Conflict, BadInput, NotPermitted."""
        began = iso_z(self._now())
        entry = StepEntry(step.id, step.title, step.kind, "running", request.user, began, note=request.note)
        if step.kind == "command":
            return self._send(run, step, entry, request.confirm)
        if step.kind == "check":
            return self._check(run, step, entry)
        if step.kind == "branch":
            return self._branch(run, step, entry)
        if step.kind == "wait":
            return self._record.add(run.id, self._with_limit(entry, step.seconds))
        if step.kind == "question":
            if request.answer not in [branch.when for branch in step.branches]:
                expected = " | ".join(branch.when for branch in step.branches)
                raise BadInput("The question needs one of its answers", expected=expected, got=request.answer[:80])
        elif step.kind == "hold" and request.user == self._first_person(run.id):
            raise Conflict("A second person must confirm this step", expected=f"another user than {request.user}")
        self._record.add(run.id, entry)
        self._close(run.id, "done", request.answer)
        return self.advance(run, step, step.target(request.answer) if step.kind == "question" else "next")

    def _first_person(self, run_id: int) -> str:
        """Return the user who ran the last step that was not a hold point. If there is none, return the user who started the
        run."""
        row = self._record.get(run_id)
        return next((e.by for e in reversed(entries_of(row)) if e.kind != "hold"), row.user)

    def _check(self, run: ActiveRun, step: ProcedureStep, entry: StepEntry) -> ProcedureRun:
        if step.seconds:
            entry = self._with_limit(entry, step.seconds)
        self._record.add(run.id, entry)
        return self._look(run, step, entry)

    def _last_command_end(self, run_id: int) -> datetime | None:
        """Return when the last command ended, by the present clock."""
        ends = [e.ended for e in entries_of(self._record.get(run_id)) if e.kind == "command" and e.ended]
        if not ends:
            return None
        if self._last_end is not None and self._last_end[0] == ends[-1]:
            return self._now() - timedelta(seconds=self._link.monotonic_s() - self._last_end[1])
        return min(datetime.fromisoformat(ends[-1]), self._now())

    def _with_limit(self, entry: StepEntry, seconds: float) -> StepEntry:
        """Return the entry with a time limit that begins now."""
        now_s, due = self._link.monotonic_s(), iso_z(self._now() + timedelta(seconds=seconds))
        self._limit = _TimeLimit(now_s, now_s + seconds, due)
        return replace(entry, due=due)

    def _limit_of(self, entry: StepEntry, seconds: float) -> _TimeLimit:
        """Return the time limit of an entry. After a restart, it is what the stored time leaves of the ``seconds``."""
        if self._limit is None or self._limit.due != entry.due:
            left_s = (datetime.fromisoformat(entry.due) - self._now()).total_seconds()
            now_s = self._link.monotonic_s()
            self._limit = _TimeLimit(now_s, now_s + min(max(left_s, 0.0), seconds), entry.due)
        return self._limit

    def _is_due(self, entry: StepEntry, seconds: float) -> bool:
        return self._link.monotonic_s() >= self._limit_of(entry, seconds).due_s

    def _close(self, run_id: int, state: EntryState, detail: str, values: Values | None = None) -> ProcedureRun:
        """End the last entry. If it failed, switch off automatic execution."""
        row = self._record.close(run_id, state, detail, values)
        self._last_end = entries_of(row)[-1].ended, self._link.monotonic_s()
        return row

    def _look(self, run: ActiveRun, step: ProcedureStep, entry: StepEntry) -> ProcedureRun:
        """Evaluate a check in progress. End it if its condition is met or its time limit has passed. A check with a time limit
        ignores values received before the last command ended, because they can describe the state before that command."""
        since = self._last_command_end(run.id) if step.seconds else None
        result, values = self._conditions.evaluate(step.words, self._now(), since)
        if result.value is True:
            self._close(run.id, "done", "met", values)
            return self.advance(run, step, "next")
        if entry.due and not self._is_due(entry, step.seconds):
            return self._record.get(run.id)
        within = f" within {step.seconds:g} s" if step.seconds else ""
        has_else = any(branch.when == "else" for branch in step.branches)
        if result.value is False and has_else:
            self._close(run.id, "done", f"not met{within}: continued at {step.target('else')}", values)
            return self.advance(run, step, step.target("else"))
        outcome = f"not met{within}" if result.value is False else f"unknown{within}: {result.reason}"
        return self._fail(run.id, f"The check is {outcome}.", values)

    def _branch(self, run: ActiveRun, step: ProcedureStep, entry: StepEntry) -> ProcedureRun:
        self._record.add(run.id, entry)
        used: Values = {}
        for branch in step.branches[:-1]:
            result, values = self._conditions.evaluate(branch.when.removeprefix("if "), self._now())
            used |= values
            if result.value is None:
                return self._fail(run.id, f"The condition “{branch.when}” is unknown: {result.reason}.", used)
            if result.value is True:
                self._close(run.id, "done", f"{branch.when}: continued at {branch.target}", used)
                return self.advance(run, step, branch.target)
        self._close(run.id, "done", f"else: continued at {step.branches[-1].target}", used)
        return self.advance(run, step, step.branches[-1].target)

    def _send(self, run: ActiveRun, step: ProcedureStep, entry: StepEntry, confirm: str) -> ProcedureRun:
        """Send a step's command, or send the command of an earlier attempt again. The entry is stored first, so that after a
        crash the next server can look up the command."""
        command, arguments = command_of(step, self._link.roles.operations)
        earlier = self._earlier(run.id, step)
        if earlier is not None and earlier.result == "completed":
            self._record.add(run.id, with_command(entry, earlier))
            return self._follow(run, step)
        self._record.add(run.id, replace(entry, state="sending", command_id=None if earlier is None else earlier.id))
        try:
            if earlier is not None:
                row = self._commands.retry(earlier.id, user=entry.by)
            else:
                row = self._commands.send(
                    command.name,
                    arguments,
                    confirm=confirm,
                    user=entry.by,
                    source=SOURCE,
                    run_id=run.id,
                    aborts=run.aborts,
                )
        except GssError as error:
            self._fail(run.id, f"The command was not sent: {error}")
            raise
        return self._record.update(run.id, with_command(entry, row))

    def _earlier(self, run_id: int, step: ProcedureStep) -> Command | None:
        """Return the command of the preceding failed attempts of this step if the unit can have executed it (its result is unknown,
        or it completed late), otherwise None."""
        entries = reversed(entries_of(self._record.get(run_id)))
        attempts = takewhile(lambda entry: (entry.step, entry.state) == (step.id, "failed"), entries)
        command_id = next((entry.command_id for entry in attempts if entry.command_id is not None), None)
        row = None if command_id is None else self._commands.get(command_id)
        return row if row is not None and row.result in ("unknown", "completed") else None

    def _follow(self, run: ActiveRun, step: ProcedureStep) -> ProcedureRun:
        """End the step of a command if the command has ended. A command that is still queued when the line is down is withdrawn,
        because it would be sent unexpectedly in the next contact."""
        entry = open_entry(self._record.get(run.id))
        if entry is None or entry.command_id is None:
            return self._record.get(run.id)
        if not self._link.connected:
            self.withdraw(entry, entry.by)
        row = self._commands.get(entry.command_id)
        if row.result not in ENDED:
            return self._record.get(run.id)
        if row.result == "completed":
            self._close(run.id, "done", "completed")
            return self.advance(run, step, "next")
        detail = f": {row.detail}" if row.detail else ""
        return self._fail(run.id, f"The command ended {row.result}{detail}")

    def withdraw(self, entry: StepEntry, user: str) -> None:
        """Withdraw the command of an entry on behalf of a user if it has not been sent."""
        if entry.command_id is not None:
            with suppress(Conflict):  # it was sent, and its result is recorded
                self._commands.withdraw_queued(entry.command_id, user=user)

    def _fail(self, run_id: int, detail: str, values: Values | None = None) -> ProcedureRun:
        """End the step as failed. An operator then runs it again, skips it, or stops the run."""
        row = self._close(run_id, "failed", detail, values)
        self._bus.record(
            "procedure", "warning", f"Procedure {row.name}, step {row.current}: {detail}", procedure_run_id=run_id
        )
        return row

    def advance(self, run: ActiveRun, step: ProcedureStep, target: str) -> ProcedureRun:
        """Continue at the target of a step. After the last step, complete the run."""
        following = run.document.after(step, target)
        return (
            self._record.freeze(run.id, "completed", "") if following is None else self._record.move(run.id, following)
        )

    def continue_step(self, run: ActiveRun, row: ProcedureRun, entry: StepEntry) -> ProcedureRun:
        """Update the step in progress, and end the step if its action has ended."""
        step = run.document.step(row.current)
        if entry.kind == "command":
            return self._follow(run, step)
        if entry.kind == "check" and run.held_since_s is None:
            return self._look(run, step, entry)
        if entry.kind == "wait" and self._is_due(entry, step.seconds):
            self._close(run.id, "done", f"waited {step.seconds:g} s")
            return self.advance(run, step, "next")
        return row

    def on_present_clock(self, run: ActiveRun, row: ProcedureRun, entry: StepEntry) -> StepEntry:
        """Return the entry of the step in progress. If the server's clock has jumped, its time limit is stored again, so that
        users see when it ends."""
        if not entry.due:
            return entry
        limit = self._limit_of(entry, run.document.step(row.current).seconds)
        due = self._now() + timedelta(seconds=limit.due_s - self._link.monotonic_s())
        if abs((datetime.fromisoformat(entry.due) - due).total_seconds()) <= CLOCK_ERROR_S:
            return entry
        self._limit = replace(limit, due=iso_z(due))
        entry = replace(entry, due=self._limit.due)
        self._record.update(run.id, entry)
        return entry

    def extend_check(self, run: ActiveRun) -> None:
        """Extend the time limit of a check in progress by the time for which the run was suspended."""
        entry = open_entry(self._record.get(run.id))
        if run.held_since_s is not None and entry is not None and entry.kind == "check" and entry.due:
            limit = self._limit_of(entry, run.document.step(entry.step).seconds)
            suspended_s = self._link.monotonic_s() - max(run.held_since_s, limit.began_s)
            due = iso_z(datetime.fromisoformat(entry.due) + timedelta(seconds=suspended_s))
            self._limit = _TimeLimit(limit.began_s, limit.due_s + suspended_s, due)
            self._record.update(run.id, replace(entry, due=due))


def with_command(entry: StepEntry, row: Command) -> StepEntry:
    """Return the entry with its queued command."""
    return replace(entry, state="running", command_id=row.id)
