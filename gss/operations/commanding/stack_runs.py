"""Runs stacks: one at a time, on a thread; each step starts only after the previous one completed.

A step that does not complete (rejected, failed, unknown, withdrawn, not allowed, condition not met) ends the run; so does
ABORT. A run does not survive a restart of the server, and nothing is resent automatically: an operator may continue a failed
run at the step that failed, by retrying or skipping it.
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
from gss.operations.commanding.stack_orders import Orders, Stopped
from gss.operations.commanding.stack_record import RunRecord
from gss.operations.commanding.stacks import STEP, StackService, Step, condition_of
from gss.operations.events import EventBus
from gss.operations.line.line_events import AbortIssued, LineBatch
from gss.operations.line.link import LinkService
from gss.store.engine import Database
from gss.store.models import Command, StackRun

LOOK_EVERY_S = 0.2
ENDED = ("completed", "rejected", "failed", "unknown", "resolved", "withdrawn")


class StackRunner:
    """Runs stacks. ``handle`` collects telemetry for the conditions."""

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
        self._orders: Orders | None = None
        self._run_id: int | None = None
        self._thread: threading.Thread | None = None

    # --- operator requests --------------------------------------------------------------------------------------

    def start(self) -> None:
        """Mark runs that a restart of the server interrupted as stopped."""
        self._record.end_left()

    def shut_down(self) -> None:
        """Stop the run in progress and wait for its thread."""
        orders, thread = self._orders, self._thread
        if orders is not None:
            self._ask_to_stop(orders, "the server is stopping")
        if thread is not None:
            thread.join(timeout=5)

    def run(self, stack_id: int, confirm: Sequence[str], *, user: str) -> StackRun:
        """Start a run and return its row at once. Raises BadInput with the names that must still be typed, Conflict if the
        stack cannot run now."""
        stack = self._stacks.get(stack_id)
        self._check(stack.name, stack.steps, confirm, user)
        row = self._begin(lambda: self._record.add(stack, user), 0, user)
        self._bus.record("stack", "ok", f"{user} runs {stack.name}: {len(stack.steps)} steps", run_id=row.id)
        return row

    def continue_run(self, run_id: int, skip: str, confirm: Sequence[str], *, user: str) -> StackRun:
        """Continue the last run at the step that failed: retry it, or skip it if ``skip`` gives a reason. A command of
        unknown fate is resent with its id, so that the device does not execute it twice; any other is sent as a new command."""
        row = self._failed_last(run_id)
        failed, first = row.steps[row.step], row.step + bool(skip)
        remaining_steps = [{name: step[name] for name in STEP} for step in row.steps[first:]]
        if remaining_steps:
            self._check(row.name, remaining_steps, confirm, user)

        def open_again() -> StackRun:
            self._failed_last(run_id)
            if skip:
                detail = f"by {user}: {skip}; before {failed['state']} {failed['detail']}".strip()
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
        """Check the steps still to be sent: permitted, possible now, and confirmed by typed names where hazardous."""
        self._stacks.check_permitted(steps, user=user)
        check = self._stacks.check(steps, user=user)
        if check.problems:
            raise Conflict(f"{name} cannot run in the current state", got=check.problems[0])
        missing = [word for word in check.confirm if word not in confirm]
        if missing:
            raise BadInput(f"{name} has steps that need confirmation", expected=f"typed: {', '.join(missing)}")

    def _begin(self, row_of: Callable[[], StackRun], first: int, user: str) -> StackRun:
        """Start the thread of a run from step ``first`` on, and return the run's row at once."""
        with self._lock:
            if self._orders is not None:
                raise Conflict("a stack is running", got=f"run {self._run_id}", hint="wait until it ends, or stop it")
            self._commands.require_user(user)
            row = row_of()
            self._orders, self._run_id = Orders(self._commands.aborts), row.id
            self._thread = threading.Thread(
                target=self._execute, args=(row.id, first, self._orders, user), name="stack", daemon=True
            )
            self._thread.start()
        return row

    def pause(self, run_id: int, *, user: str) -> StackRun:
        """Send no further step; the step in progress continues until it ends."""
        with self._lock:
            self._under_way(run_id).pause = True
            row = self._record.change(run_id, state="paused")
        self._bus.record("stack", "ok", f"{user} pauses run {run_id}", run_id=run_id)
        return row

    def resume(self, run_id: int, *, user: str) -> StackRun:
        """Resume a paused run."""
        with self._lock:
            orders = self._under_way(run_id)
            self._commands.check_user(user)
            row = self._record.change(run_id, state="running")
            orders.pause = False
        orders.ring()
        self._bus.record("stack", "ok", f"{user} resumes run {run_id}", run_id=run_id)
        return row

    def stop(self, run_id: int, *, user: str) -> StackRun:
        """End the run without sending another step; a command that was sent is still followed."""
        self._ask_to_stop(self._under_way(run_id), f"stopped by {user}")
        thread = self._thread
        if thread is not None:
            thread.join(timeout=5)
        return self.get(run_id)

    def _under_way(self, run_id: int) -> Orders:
        orders = self._orders
        if orders is None or self._run_id != run_id:
            raise Conflict("this run has ended", got=self.get(run_id).state)
        return orders

    @staticmethod
    def _ask_to_stop(orders: Orders, reason: str) -> None:
        orders.stop_reason = orders.stop_reason or reason
        orders.ring()

    def get(self, run_id: int) -> StackRun:
        """Return the run with that id. Raises NotFound."""
        return self._record.get(run_id)

    def newest(self, limit: int) -> list[StackRun]:
        """Return the newest runs first."""
        return self._record.newest(limit)

    # --- events during a run ------------------------------------------------------------------------------------

    def handle(self, batch: LineBatch) -> None:
        """Collect telemetry for the run's conditions, the results of its commands, and ABORT."""
        orders = self._orders
        if orders is None:
            return
        for event in batch.events:
            if isinstance(event, Telemetry):
                orders.packets[event.packet] = (batch.at_s, event.values)
            elif isinstance(event, CommandChanged) and event.run_id == self._run_id:
                orders.results[event.command_id] = event.result
            elif isinstance(event, AbortIssued):
                self._ask_to_stop(orders, f"ABORT by {event.user}")
        orders.ring()

    # --- run thread ---------------------------------------------------------------------------------------------

    def _execute(self, run_id: int, first: int, orders: Orders, user: str) -> None:
        state, reason = "completed", ""
        try:
            for number, step in list(enumerate(self.get(run_id).steps))[first:]:
                self._step(run_id, number, step, orders, user)
        except Stopped as stopped:
            state, reason = stopped.state, stopped.reason
        except GssError as error:
            state, reason = "failed", str(error)
        except Exception as error:  # a defect must end as a visible failure, never as a silent dead thread
            state, reason = "failed", f"internal error: {type(error).__name__}: {error}"
        with self._lock:
            self._orders = self._run_id = None
            row = self._record.change(run_id, state=state, reason=reason, finished=self._now())
        severity = "ok" if state == "completed" else "watch" if state == "stopped" else "warning"
        message = f"{row.name}: {state} at step {row.step + 1} of {len(row.steps)}" + (f", {reason}" if reason else "")
        self._bus.record("stack", severity, message, run_id=run_id)

    def _step(self, run_id: int, number: int, step: Mapping[str, Any], orders: Orders, user: str) -> None:
        began_s = self._monotonic_s()
        try:
            if step["delay_s"]:
                self._record.mark(run_id, number, "delay")
                self._wait(orders, lambda: self._monotonic_s() >= began_s + step["delay_s"])
            if step["condition"]:
                self._record.mark(run_id, number, "condition")
                self._await_condition(orders, step["condition"], began_s)
            self._record.mark(run_id, number, "sending")
            self._wait(orders, lambda: not orders.pause)
            row = self._send(run_id, step, orders, user)
        except (Stopped, GssError) as error:
            state = error.state if isinstance(error, Stopped) else "failed"
            detail = error.reason if isinstance(error, Stopped) else str(error)
            self._record.mark(run_id, number, state, command_id=step["command_id"], detail=detail)
            raise
        self._record.mark(run_id, number, row.result, command_id=row.id, detail=row.detail)
        if row.result != "completed":
            raise Stopped("failed", f"step {number + 1}, {row.name}: {row.result} {row.detail}".strip())

    def _wait(self, orders: Orders, done: Callable[[], bool], until_s: float | None = None) -> bool:
        """Wait until ``done`` returns True (True) or ``until_s`` has passed (False). Raises Stopped if the run is to end."""
        with orders.bell:
            while not orders.stop_reason:
                if done():
                    return True
                if until_s is not None and self._monotonic_s() >= until_s:
                    return False
                orders.bell.wait(LOOK_EVERY_S)
        raise Stopped("stopped", orders.stop_reason)

    def _await_condition(self, orders: Orders, condition: Mapping[str, Any], since_s: float) -> None:
        """Wait for the condition. Only values received after this step began count, because an older one may describe the
        state before the previous step."""
        rule = condition_of(condition)

        def met() -> bool:
            at_s, values = orders.packets.get(condition["packet"], (-1.0, {}))
            return at_s >= since_s and rule.met(values) is True

        if not self._wait(orders, met, self._monotonic_s() + condition["wait_s"]):
            at_s, values = orders.packets.get(condition["packet"], (-1.0, {}))
            got = str(values.get(rule.field)) if at_s >= since_s else "no value received"
            reason = f"condition {rule.text} not met within {condition['wait_s']:g} s; {rule.field}: {got}"
            raise Stopped("failed", reason)

    def _send(self, run_id: int, step: Mapping[str, Any], orders: Orders, user: str) -> Command:
        """Send the step's command and wait until it ends. Its name was typed before the run began."""
        row = self._fate(step)
        if row is None:
            row = self._commands.send(
                step["command"],
                step["arguments"],
                confirm=self._stacks.confirmation(step),
                user=user,
                source="stack",
                run_id=run_id,
                aborts=orders.aborts,
            )
        elif row.result == "completed":
            return row
        else:
            row = self._commands.retry(row.id, user=user)
        try:
            self._wait(orders, lambda: self._ended(orders, row) or not self._reachable(orders, row))
        except Stopped:
            self._withdraw(row.id, user)
            raise
        if not self._ended(orders, row):
            self._withdraw(row.id, user)
        return self._commands.get(row.id)

    def _fate(self, step: Mapping[str, Any]) -> Command | None:
        """Return the earlier command of a retried step if it may have run: still unknown, or completed late."""
        row = None if step["command_id"] is None else self._commands.get(step["command_id"])
        return row if row is not None and row.result in ("unknown", "completed") else None

    @staticmethod
    def _ended(orders: Orders, row: Command) -> bool:
        return orders.results.get(row.id) in ENDED

    def _reachable(self, orders: Orders, row: Command) -> bool:
        """False if the command is unsent and the line is down: it would otherwise be sent, unexpectedly, in the next
        contact."""
        return self._link.connected or orders.results.get(row.id, "queued") != "queued"

    def _withdraw(self, command_id: int, user: str) -> None:
        try:
            self._commands.withdraw_queued(command_id, user=user)
        except Conflict:
            return  # it was already sent and is followed separately
