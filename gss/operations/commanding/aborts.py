"""ABORT: queued for the line at once, recorded when the store can take it."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime
from functools import partial

from gss.domain.errors import Conflict, StoreDown
from gss.instruments.operations import Operation
from gss.operations.clock import Now
from gss.operations.commanding.abort_journal import AbortJournal, IssuedAbort
from gss.operations.commanding.command_record import CommandRecorder
from gss.operations.events import EventBus
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.line_events import AbortIssued
from gss.operations.line.link import LinkService
from gss.store.models import Command

RECORD_WITHIN_S = 10.0
"""Longer than a locked store is waited for."""


@dataclass(frozen=True)
class AbortReceipt:
    """ABORT is queued for the line and leaves next. ``at``: when it was queued; ``recorded``: resolves to its row."""

    request_id: int
    at: datetime
    recorded: Future[Command]

    def row(self, within_s: float = RECORD_WITHIN_S) -> Command:
        """The command's row. StoreDown if it is not stored within that time; ABORT is queued for the line all the same."""
        try:
            return self.recorded.result(within_s)
        except TimeoutError:
            raise StoreDown(
                "ABORT is queued for sending but not stored yet", hint="check the database and the disk"
            ) from None


class Aborts:
    """Issues ABORT without waiting for anything, and records it from the event queue."""

    def __init__(
        self,
        link: LinkService,
        recorder: CommandRecorder,
        bus: EventBus,
        now: Now,
        writes: DeferredWrites,
        journal: AbortJournal,
    ) -> None:
        self._link, self._recorder, self._bus, self._now, self._writes = link, recorder, bus, now, writes
        self._journal = journal
        self.count = 0
        """ABORTs issued since the server started."""
        self._newest_id = 0

    def issue(self, user: str, source: str) -> AbortReceipt:
        """Send ABORT ahead of everything, without checks and without waiting for the store.

        Commands that still wait in the queue are withdrawn: they must not run after everything was stopped. Raises Conflict while
        the line is down; nothing is sent then.
        """
        self._link.roles.operations.require(Operation.ABORT)
        with self._link.lock:
            if not self._link.line_is_open:  # the session would keep it for the next line
                raise Conflict(
                    "ABORT was not sent: the line is down", got=self._link.reason, hint="open the port first"
                )
            self._newest_id = self._link.session.abort(self._link.monotonic_s())
            self.count += 1
            withdrawn = self._link.session.withdraw_all(f"ABORT by {user}")
            issued = AbortIssued(self._newest_id, user, source, self._now(), tuple(withdrawn))
            self._link.events.publish([issued])
        self._journal.add(IssuedAbort(issued.request_id, user, source, issued.at.isoformat()))
        return AbortReceipt(issued.request_id, issued.at, issued.recorded)

    def stops(self, request_id: int, count: int | None) -> bool:
        """True if an ABORT overtook the command with that id, or was issued after ``count`` ABORTs. Hold ``LinkService.lock``."""
        return request_id < self._newest_id or count not in (None, self.count)

    def record(self, issued: AbortIssued) -> None:
        """Store an ABORT's row; what it withdrew and its event follow as separate writes."""
        contact_id, names = self._link.contact_id, (issued.user, issued.source)
        abort = self._link.roles.operations.command(Operation.ABORT)
        row = self._recorder.add(issued.request_id, abort, {}, *names, contact_id, None, issued.at)
        self._journal.remove(issued.request_id)
        issued.recorded.set_result(row)
        if issued.withdrawn:
            self._writes.add(partial(self._recorder.add_withdrawn, issued.withdrawn))
        withdrawn = f"; withdrawn unsent: {len(issued.withdrawn)}" if issued.withdrawn else ""
        text = f"ABORT by {issued.user}{withdrawn}"
        self._writes.add(partial(self._bus.record, "command", "watch", text, command_id=row.id))
