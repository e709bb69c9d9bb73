"""Command service: checks, confirms and queues commands, and records their reports. Commands are never resent automatically."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from gss.device.protocol.codec import EncodedCommand
from gss.device.session_events import CommandUpdate, DeviceEvent
from gss.domain.errors import BadInput, Conflict, GssError, NotFound, StoreDown
from gss.instruments.dictionary.definitions import CommandDefinition as Definition
from gss.instruments.operations import Operation
from gss.operations.accounts.permissions import STOP
from gss.operations.clock import Now
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.aborts import AbortReceipt, Aborts
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.command_checks import (
    REMEMBERED_IDS,
    DryRun,
    PreconditionState,
    check_confirmation,
    check_stored_result,
    check_unit,
    precondition_states,
    risk_of,
    subsystems_of,
)
from gss.operations.commanding.command_record import CommandCompleted, CommandRecorder, CommandView
from gss.operations.events import EventBus
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.line_events import AbortIssued, LineBatch
from gss.operations.line.link import LinkService
from gss.store import commands as store
from gss.store.engine import Database
from gss.store.models import Command

RESTARTED = "The server restarted during this command. It may or may not have been executed."
NEEDS_OPERATOR = f"Needs operator: {RESTARTED[0].lower()}{RESTARTED[1:]}"
SOFTWARE = "gss"
"""User name of commands that the server sends on its own behalf."""
SERVER = "server"
"""Source of commands that the server sends on its own behalf. These commands do not need command authority."""

Permits = Callable[[str, str], None]
"""Function of (user, permission) that raises NotPermitted. It takes the user's name, because a procedure continues after its HTTP
request."""


class CommandService:
    """Sends single commands to the sensor on behalf of a user, and records their results."""

    def __init__(
        self,
        link: LinkService,
        database: Database,
        bus: EventBus,
        now: Now,
        authority: AuthorityService,
        permits: Permits,
        journal: AbortJournal,
    ) -> None:
        self._link, self._database, self._bus, self._now = link, database, bus, now
        self._authority, self._permits = authority, permits
        self._writes = DeferredWrites()
        self._recorder = CommandRecorder(database, bus, now, self.view, link.events, self._writes)
        self._aborts = Aborts(link, self._recorder, bus, now, self._writes, journal)

    def start(self) -> None:
        """Mark the commands that were in progress when the previous server stopped as unknown. Nothing is resent automatically.
        Commands with an unknown result can still be retried, and a late report can still end them.
        """
        self._aborts.record_left()
        with self._database.unit_of_work() as session:
            for row in store.left_in_flight(session):
                CommandRecorder.lose(row, self._now(), RESTARTED if self.idempotent(row.name) else NEEDS_OPERATOR)
            last = store.last_request_id(session)
            unknown = [
                (row.request_id, self._order_of(row), row.unit or store.unit_of_contact(session, row))
                for row in store.of_unknown_fate(session, REMEMBERED_IDS)
            ]
        with self._link.lock:
            self._link.session.restore(last + 1, [(n, order, unit) for n, order, unit in unknown if order is not None])

    def _order_of(self, row: Command) -> EncodedCommand | None:
        """Encode a recorded command again. Return None if the current dictionary does not accept it."""
        try:
            return self._link.session.encode(row.name, row.arguments)
        except (BadInput, NotFound):
            return None

    @property
    def aborts(self) -> int:
        """Number of ABORTs issued since the server started; see :meth:`send`."""
        return self._aborts.count

    # --- before sending -----------------------------------------------------------------------------------------

    def preconditions(self, definition: Definition) -> tuple[PreconditionState, ...]:
        """Return the current state of each precondition of a command."""
        return precondition_states(definition, self._link.session.housekeeping)

    def visible(self) -> list[Definition]:
        """Return the commands of the dictionary that the connected device accepts."""
        hello = self._link.hello
        real = hello is not None and not hello.simulated
        return [c for c in self._link.dictionary.commands if not (real and c.simulator_only)]

    def idempotent(self, name: str) -> bool:
        """True if the dictionary contains the command and marks it as idempotent."""
        return any(c.name == name and c.idempotent for c in self._link.dictionary.commands)

    def check(self, name: str, arguments: Mapping[str, Any], *, user: str) -> DryRun:
        """Dry run of a command: return the packet, the risk, and all reasons why it cannot be sent. Nothing is sent."""
        definition = self._link.dictionary.command(name)
        states = self.preconditions(definition)
        problems = [f"{state.text}: it is {state.value}" for state in states if state.met is False]
        if not self._link.connected:
            problems.append(f"the line is down: {self._link.reason}")
        trials: list[Callable[[], None]] = [lambda: check_unit(definition, self._link.hello)]
        if not self._aborts_all(name, arguments):
            trials += [
                lambda: self._check_commander(user, name, arguments),
                lambda: self._link.session.check_allowed(name),
            ]
        for trial in trials:
            try:
                trial()
            except GssError as error:
                problems.append(str(error))
        groups: list[tuple[str, bytes]] = []
        try:
            groups = self.preview(self._link.session.encode(name, arguments))
        except GssError as error:
            problems.append(str(error))
        risk = risk_of(self._link.roles.operations, definition, arguments)
        holder = self._authority.holder()
        return DryRun(tuple(problems), states, tuple(groups), risk, definition.role, definition.idempotent, holder)

    def _aborts_all(self, name: str, arguments: Mapping[str, Any]) -> bool:
        return self._link.roles.operations.of_command(name, arguments) is Operation.ABORT

    def check_permitted(self, user: str, name: str, arguments: Mapping[str, Any]) -> None:
        """Raise NotPermitted if the user's role does not permit the command. ABORT needs only the permission ``stop``."""
        definition = self._link.dictionary.command(name)
        if self._aborts_all(name, arguments):
            self._permits(user, STOP)
            return
        for subsystem in sorted(subsystems_of(self._link.roles.operations, definition, arguments)):
            self._permits(user, f"command.{subsystem}")

    def _check_commander(self, user: str, name: str, arguments: Mapping[str, Any]) -> None:
        """Check the user's permission and command authority. The permission is checked first, because only users with the
        permission may see who holds authority."""
        self.check_permitted(user, name, arguments)
        self._authority.check(user)

    def check_user(self, user: str) -> None:
        """Raise Conflict if another user holds command authority."""
        self._authority.check(user)

    def require_user(self, user: str) -> None:
        """Raise Conflict if another user holds command authority. If there is no holder, the user takes authority."""
        self._authority.require(user)

    def preview(self, order: EncodedCommand) -> list[tuple[str, bytes]]:
        """Return (label, bytes) of the packet that the next ``send`` of this command would send."""
        with self._link.lock:
            return self._link.session.preview(order)

    # --- sending ------------------------------------------------------------------------------------------------

    def send(
        self,
        name: str,
        arguments: Mapping[str, Any],
        *,
        confirm: str,
        user: str,
        source: str,
        run_id: int | None = None,
        aborts: int | None = None,
    ) -> Command:
        """Queue a command and return its row immediately. Raises Conflict or BadInput if it cannot be sent, NotPermitted if the
        user's role does not permit it.

        ``aborts``: value of ``self.aborts`` when the procedure of this command began. After a further ABORT the
        command is not sent.
        """
        definition = self._link.dictionary.command(name)
        if self._aborts_all(name, arguments):
            if source != SERVER:
                self.check_permitted(user, name, arguments)
            return self.abort(user=user, source=source).row()
        if source != SERVER:
            self._check_commander(user, name, arguments)
        check_unit(definition, self._link.hello)
        order = self._link.session.encode(name, arguments)
        check_confirmation(risk_of(self._link.roles.operations, definition, arguments), confirm)
        self.check_line()
        self._link.session.check_allowed(name)
        unmet = [state for state in self.preconditions(definition) if state.met is False]
        if unmet:
            state = unmet[0]
            raise Conflict(f"{name} is not allowed in the current state", expected=state.text.lower(), got=state.value)
        if source != SERVER:
            self._authority.require(user)
        return self._submit(order, arguments, user, source, run_id, aborts)

    def query(self, *names: str) -> None:
        """Send commands without arguments on the server's own behalf. If a command cannot be sent, this is recorded as an
        event."""
        for name in names:
            try:
                self.send(name, {}, confirm="", user=SOFTWARE, source=SERVER)
            except GssError as error:
                self._bus.record("link", "watch", f"{name} was not sent: {error}")

    def _submit(
        self,
        order: EncodedCommand,
        arguments: Mapping[str, Any],
        user: str,
        source: str,
        run_id: int | None,
        aborts: int | None,
    ) -> Command:
        """Store the row and then submit the command, so that every sent command is recorded. The line lock is released during the
        storing, because ABORT needs the lock."""
        with self._link.lock:
            request_id, hello = self._link.session.reserve(), self._link.session.hello
        contact_id, name, unit = self._link.contact_id, order.command.name, hello.unit_name if hello else ""
        row = self._recorder.add(request_id, name, arguments, user, source, contact_id, run_id, unit=unit)
        try:
            with self._link.lock:
                if self._aborts.stops(request_id, aborts):
                    raise Conflict(
                        "ABORT was requested before this command was sent", hint="send it again if it is still needed"
                    )
                self._link.session.submit(order, request_id=request_id)
        except GssError as error:
            self._recorder.refuse(row.id, str(error))
            raise
        return row

    def abort(self, *, user: str, source: str) -> AbortReceipt:
        """Send ABORT before all other packets; see :meth:`Aborts.issue`."""
        return self._aborts.issue(user, source)

    def retry(self, command_id: int, *, user: str) -> Command:
        """Send a command again with the same bytes and request id. The result of the command must be unknown. In
        addition, the command must be idempotent, or the device must still store the result of this id, so that the
        device does not execute the command twice. Raises Conflict if another unit has answered."""
        with self._link.hold_events():  # otherwise a late report could be overwritten
            return self._retry(self.get(command_id), user)

    def _retry(self, row: Command, user: str) -> Command:
        self.check_permitted(user, row.name, row.arguments)
        self._authority.check(user)
        self.check_line()
        self._check_retry(row)
        self._authority.require(user)
        # The retry is recorded first, because a command that cannot be recorded must not be sent.
        row = self._recorder.requeue(row.id, f"retry by {user}")
        try:
            with self._link.lock:
                self._link.session.retry(row.request_id, self._link.monotonic_s())
        except GssError as error:
            self._recorder.still_unknown(row.id, f"not retried: {error}")
            raise
        self._bus.record("command", "ok", f"{row.name} retried with the same id by {user}", command_id=row.id)
        return row

    def _check_retry(self, row: Command) -> None:
        if row.result != "unknown":
            raise Conflict("only a command whose result is unknown can be retried", expected="unknown", got=row.result)
        self._link.session.check_retry(row.request_id)
        if not self.idempotent(row.name):
            check_stored_result(self._link.session, row.request_id)

    def can_retry(self, row: Command) -> bool:
        """True if the command can be sent again to its unit with the same request id without being executed twice."""
        try:
            self._check_retry(row)
        except GssError:
            return False
        return True

    def withdraw(self, command_id: int, *, user: str) -> Command:
        """Withdraw a command that is still queued. The user needs the permission and the authority to send it. Raises Conflict if
        the command is no longer queued."""
        row = self.get(command_id)
        self._check_commander(user, row.name, row.arguments)
        return self.withdraw_queued(command_id, user=user)

    def withdraw_queued(self, command_id: int, *, user: str) -> Command:
        """Withdraw a queued command without a check of permission and authority, for a procedure that ends. Raises Conflict if the
        command is no longer queued."""
        row = self.get(command_id)
        if row.result != "queued":
            raise Conflict("only a queued command can be withdrawn", expected="queued", got=row.result)
        with self._link.lock:
            stage = self._link.session.withdraw(row.request_id, f"withdrawn by {user}")
        try:
            row = self._recorder.withdrawn(command_id, stage)
        except StoreDown:
            self._link.events.publish([stage])  # the withdrawal is recorded when the store is available again
            raise
        self._bus.record("command", "ok", f"{row.name} withdrawn by {user} before it was sent", command_id=row.id)
        return row

    def resolve(self, command_id: int, note: str, *, user: str) -> Command:
        """Mark a command with an unknown result as resolved, with an operator's note. Nothing is sent."""
        row = self.get(command_id)
        self.check_permitted(user, row.name, row.arguments)
        if row.result != "unknown":
            raise Conflict("only a command with the result unknown can be marked resolved", got=row.result)
        row = self._recorder.resolve(command_id, f"{user}: {note}")
        self._bus.record("command", "ok", f"{row.name} marked resolved by {user}: {note}", command_id=row.id)
        return row

    # --- results ------------------------------------------------------------------------------------------------

    def get(self, command_id: int) -> Command:
        """Return the command with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, command_id)

    def view(self, row: Command) -> CommandView:
        """Return the row, with the information whether the command is idempotent and can be retried now."""
        return CommandView(row, self.idempotent(row.name), self.can_retry(row))

    def handle(self, batch: LineBatch) -> list[CommandCompleted]:
        """Record the reports on commands and the device's events. Return the completed commands."""
        for event in batch.events:
            if isinstance(event, AbortIssued):
                self._writes.add(partial(self._aborts.record, event))
            elif isinstance(event, CommandUpdate):
                self._writes.add(partial(self._recorder.follow, event, batch.at))
            elif isinstance(event, DeviceEvent):
                text = f"{event.name}: {event.text}" if event.text else event.name
                self._writes.add(partial(self._bus.record, "device", event.severity, text))
        self._writes.run()
        return self._recorder.take_completed()

    def check_line(self) -> None:
        """Raise Conflict if the line is down."""
        if not self._link.connected:
            raise Conflict("the line is down", got=self._link.reason, hint="open the link first")
