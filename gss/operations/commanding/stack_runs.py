"""Execution of stacks of commands, one stack at a time, in a background thread. Each step starts after the previous step has
completed.

A step that does not complete (rejected, failed, unknown, withdrawn, not permitted, condition not met) ends the run. ABORT and a
server restart also end it. Nothing is resent automatically. An operator can continue a failed run by retrying or skipping the
failed step.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from gss.device.session_events import Telemetry
from gss.domain.errors import BadInput, Conflict, GssError
from gss.operations.clock import Monotonic, Now
from gss.operations.commanding.command_record import CommandChanged
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.stack_control import RunControl, Stopped
from gss.operations.commanding.stack_record import RunRecord
from gss.operations.commanding.stacks import STEP, StackService, Step, condition_of
from gss.operations.events import EventBus
from gss.operations.line.line_events import AbortIssued, LineBatch
from gss.operations.line.link import LinkService
from gss.store.engine import Database
from gss.store.models import Command, StackRun

CHECK_PERIOD_S = 0.2
ENDED = ("completed", "rejected", "failed", "unknown", "resolved", "withdrawn")


class StackRunner:
    """Runs stacks. ``handle`` receives telemetry for the conditions, and the results of commands."""

    def __init__(
        self,
        stacks: StackService,
        link: LinkService,
        commands: CommandService,
        database: Database,
        bus: EventBus,
        now: Now,
        monotonic_s: Monotonic,
    ) -> None:
        self._stacks, self._link, self._commands = stacks, link, commands
        self._record, self._bus, self._now, self._monotonic_s = RunRecord(database, bus, now), bus, now, monotonic_s
        self._lock = threading.Lock()
        self._control: RunControl | None = None
        self._run_id: int | None = None
        self._thread: threading.Thread | None = None

    # --- operator requests --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Set the state ``stopped`` for all runs that a server restart interrupted."""
        self._record.end_interrupted()

    def shut_down(self) -> None:
        """Stop the current run and wait for its thread."""
        control, thread = self._control, self._thread
        if control is not None:
            self._request_stop(control, "the server is stopping")
        if thread is not None:
            thread.join(timeout=5)

    def run(self, stack_id: int, confirm: Sequence[str], *, user: str) -> StackRun:
        """Start a run and return its row without waiting. Raises BadInput with the names that must still be typed, Conflict if the
        stack cannot run now."""
        stack = self._stacks.get(stack_id)
        self._check(stack.name, stack.steps, confirm, user)
        row = self._begin(lambda: self._record.add(stack, user), 0, user)
        self._bus.record("stack", "ok", f"{user} runs {stack.name}: {len(stack.steps)} steps", run_id=row.id)
        return row

    def continue_run(self, run_id: int, skip: str, confirm: Sequence[str], *, user: str) -> StackRun:
        """Continue the latest run at its failed step. ``skip``: reason for skipping the step; "" to retry it. A command with an
        unknown result is resent with the same request id, so the device does not execute it twice. In other cases a new command
        is sent."""
        row = self._failed_last(run_id)
        failed, first = row.steps[row.step], row.step + bool(skip)
        remaining_steps = [{name: step[name] for name in STEP} for step in row.steps[first:]]
        if remaining_steps:
            self._check(row.name, remaining_steps, confirm, user)

        def open_again() -> StackRun:
            self._failed_last(run_id)
            if skip:
                detail = f"by {user}: {skip}; previously {failed['state']} {failed['detail']}".strip()
                self._record.mark(run_id, row.step, "skipped", command_id=failed["command_id"], detail=detail)
            return self._record.change(run_id, state="running", reason="", finished=None)

        opened = self._begin(open_again, first, user)
        message = f"{user} {'skips' if skip else 'retries'} step {row.step + 1} of {row.name}"
        self._bus.record("stack", "watch", f"{message}: {skip}" if skip else message, run_id=run_id)
        return opened

    def _failed_last(self, run_id: int) -> StackRun:
        row, newest = self.get(run_id), self.newest(1)[0]
        if row.state != "failed":
            raise Conflict("only a failed run can be resumed", expected="failed", got=row.state)
        if newest.id != run_id:
            raise Conflict("another stack has run since", got=f"run {newest.id}", hint="run the stack again")
        return row

    def _check(self, name: str, steps: Sequence[Step], confirm: Sequence[str], user: str) -> None:
        """Check that the remaining steps are permitted and possible now, and that hazardous steps are confirmed by typed names."""
        self._stacks.check_permitted(steps, user=user)
        check = self._stacks.check(steps, user=user)
        if check.problems:
            raise Conflict(f"{name} cannot run in the current state", got=check.problems[0])
        missing = [name for name in check.confirm if name not in confirm]
        if missing:
            raise BadInput(f"{name} has steps that need confirmation", expected=f"typed: {', '.join(missing)}")

    def _begin(self, open_row: Callable[[], StackRun], first: int, user: str) -> StackRun:
        """Start a thread that executes the run from step ``first`` on, and return the run's row immediately."""
        with self._lock:
            if self._control is not None:
                raise Conflict("a stack is running", got=f"run {self._run_id}", hint="wait until it ends, or stop it")
            self._commands.require_user(user)
            row = open_row()
            self._control, self._run_id = RunControl(self._commands.aborts), row.id
            self._thread = threading.Thread(
                target=self._execute, args=(row.id, first, self._control, user), name="stack", daemon=True
            )
            self._thread.start()
        return row

    def pause(self, run_id: int, *, user: str) -> StackRun:
        """Pause a run before its next step. The current step continues until it ends."""
        with self._lock:
            self._active(run_id).pause = True
            row = self._record.change(run_id, state="paused")
        self._bus.record("stack", "ok", f"{user} pauses run {run_id}", run_id=run_id)
        return row

    def resume(self, run_id: int, *, user: str) -> StackRun:
        """Resume a paused run."""
        with self._lock:
            control = self._active(run_id)
            self._commands.check_user(user)
            row = self._record.change(run_id, state="running")
            control.pause = False
        control.notify()
        self._bus.record("stack", "ok", f"{user} resumes run {run_id}", run_id=run_id)
        return row

    def stop(self, run_id: int, *, user: str) -> StackRun:
        """Stop the run without sending another step. The result of a command that was already sent is still recorded."""
        self._request_stop(self._active(run_id), f"stopped by {user}")
        thread = self._thread
        if thread is not None:
            thread.join(timeout=5)
        return self.get(run_id)

    def _active(self, run_id: int) -> RunControl:
        control = self._control
        if control is None or self._run_id != run_id:
            raise Conflict("this run has ended", got=self.get(run_id).state)
        return control

    @staticmethod
    def _request_stop(control: RunControl, reason: str) -> None:
        control.stop_reason = control.stop_reason or reason
        control.notify()

    def get(self, run_id: int) -> StackRun:
        """Return the run with that id. Raises NotFound."""
        return self._record.get(run_id)

    def newest(self, limit: int) -> list[StackRun]:
        """Return the latest runs, newest first."""
        return self._record.newest(limit)

    # --- events during a run ------------------------------------------------------------------------------------

    def handle(self, batch: LineBatch) -> None:
        """Receive telemetry for the run's conditions, the results of its commands, and ABORT."""
        control = self._control
        if control is None:
            return
        for event in batch.events:
            if isinstance(event, Telemetry):
                control.packets[event.packet] = (batch.at_s, event.values)
            elif isinstance(event, CommandChanged) and event.run_id == self._run_id:
                control.results[event.command_id] = event.result
            elif isinstance(event, AbortIssued):
                self._request_stop(control, f"ABORT by {event.user}")
        control.notify()

    # --- run thread ---------------------------------------------------------------------------------------------

    def _execute(self, run_id: int, first: int, control: RunControl, user: str) -> None:
        state, reason = "completed", ""
        try:
            for number, step in list(enumerate(self.get(run_id).steps))[first:]:
                self._step(run_id, number, step, control, user)
        except Stopped as stopped:
            state, reason = stopped.state, stopped.reason
        except GssError as error:
            state, reason = "failed", str(error)
        except Exception as error:  # a software defect must fail the run visibly instead of ending the thread silently
            state, reason = "failed", f"internal error: {type(error).__name__}: {error}"
        with self._lock:
            self._control = self._run_id = None
            row = self._record.change(run_id, state=state, reason=reason, finished=self._now())
        severity = "ok" if state == "completed" else "watch" if state == "stopped" else "warning"
        message = f"{row.name}: {state} at step {row.step + 1} of {len(row.steps)}" + (f", {reason}" if reason else "")
        self._bus.record("stack", severity, message, run_id=run_id)

    def _step(self, run_id: int, number: int, step: Mapping[str, Any], control: RunControl, user: str) -> None:
        began_s = self._monotonic_s()
        try:
            if step["delay_s"]:
                self._record.mark(run_id, number, "delay")
                self._wait(control, lambda: self._monotonic_s() >= began_s + step["delay_s"])
            if step["condition"]:
                self._record.mark(run_id, number, "condition")
                self._await_condition(control, step["condition"], began_s)
            self._record.mark(run_id, number, "sending")
            self._wait(control, lambda: not control.pause)
            row = self._send(run_id, step, control, user)
        except (Stopped, GssError) as error:
            state = error.state if isinstance(error, Stopped) else "failed"
            detail = error.reason if isinstance(error, Stopped) else str(error)
            self._record.mark(run_id, number, state, command_id=step["command_id"], detail=detail)
            raise
        self._record.mark(run_id, number, row.result, command_id=row.id, detail=row.detail)
        if row.result != "completed":
            raise Stopped("failed", f"step {number + 1}, {row.name}: {row.result} {row.detail}".strip())

    def _wait(self, control: RunControl, done: Callable[[], bool], until_s: float | None = None) -> bool:
        """Wait until ``done`` is True and return True. Return False at the time ``until_s``. Raises Stopped if a stop is
        requested."""
        with control.changed:
            while not control.stop_reason:
                if done():
                    return True
                if until_s is not None and self._monotonic_s() >= until_s:
                    return False
                control.changed.wait(CHECK_PERIOD_S)
        raise Stopped("stopped", control.stop_reason)

    def _await_condition(self, control: RunControl, condition: Mapping[str, Any], since_s: float) -> None:
        """Wait until telemetry meets the condition. Values received before this step began are ignored, because they can describe
        the state before the previous step."""
        rule = condition_of(condition)

        def met() -> bool:
            at_s, values = control.packets.get(condition["packet"], (-1.0, {}))
            return at_s >= since_s and rule.met(values) is True

        if not self._wait(control, met, self._monotonic_s() + condition["wait_s"]):
            at_s, values = control.packets.get(condition["packet"], (-1.0, {}))
            got = str(values.get(rule.field)) if at_s >= since_s else "no value received"
            reason = f"condition {rule.text} not met within {condition['wait_s']:g} s; {rule.field}: {got}"
            raise Stopped("failed", reason)

    def _send(self, run_id: int, step: Mapping[str, Any], control: RunControl, user: str) -> Command:
        """Send the step's command and wait until it ends. The confirmation was checked when the run started."""
        row = self._previous_command(step)
        if row is None:
            row = self._commands.send(
                step["command"],
                step["arguments"],
                confirm=self._stacks.confirmation(step),
                user=user,
                source="stack",
                run_id=run_id,
                aborts=control.aborts,
            )
        elif row.result == "completed":
            return row
        else:
            row = self._commands.retry(row.id, user=user)
        try:
            self._wait(control, lambda: self._ended(control, row) or not self._reachable(control, row))
        except Stopped:
            self._withdraw(row.id, user)
            raise
        if not self._ended(control, row):
            self._withdraw(row.id, user)
        return self._commands.get(row.id)

    def _previous_command(self, step: Mapping[str, Any]) -> Command | None:
        """Return the previous command of a retried step if the device can have executed it (its result is unknown, or it completed
        late), otherwise None."""
        row = None if step["command_id"] is None else self._commands.get(step["command_id"])
        return row if row is not None and row.result in ("unknown", "completed") else None

    @staticmethod
    def _ended(control: RunControl, row: Command) -> bool:
        return control.results.get(row.id) in ENDED

    def _reachable(self, control: RunControl, row: Command) -> bool:
        """True if the link is up or the command was already sent. If it is still queued while the link is down, it must be
        withdrawn, because it would be sent unexpectedly in the next contact."""
        return self._link.connected or control.results.get(row.id, "queued") != "queued"

    def _withdraw(self, command_id: int, user: str) -> None:
        try:
            self._commands.withdraw_queued(command_id, user=user)
        except Conflict:
            return  # the command was already sent, and its result will be recorded
