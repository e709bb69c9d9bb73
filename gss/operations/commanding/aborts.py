"""ABORT: the command is queued for the line immediately, and its row is stored when the store is available."""

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

ABORT_WITHIN_S = 2.0
"""Maximum time that ABORT waits for a driver that hangs."""
RECORD_WITHIN_S = 10.0
"""Maximum time to wait for the row of an ABORT. It exceeds the time that the store waits for a lock."""


@dataclass(frozen=True)
class AbortReceipt:
    """Receipt of an ABORT that was inserted at the head of the line's queue. ``at``: time at which it was queued.
    ``recorded``: resolves to its row."""

    request_id: int
    at: datetime
    recorded: Future[Command]

    def row(self, within_s: float = RECORD_WITHIN_S) -> Command:
        """Return the row of the ABORT. Raises StoreDown if it is not stored within this time; ABORT is sent nevertheless."""
        try:
            return self.recorded.result(within_s)
        except TimeoutError:
            raise StoreDown(
                "ABORT is queued for sending but is not stored", hint="check the database and the disk"
            ) from None


class Aborts:
    """Issues ABORT without waiting, and records it when the dispatcher handles its event."""

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
        """Number of ABORTs issued since the server started."""
        self._newest_id = 0

    def issue(self, user: str, source: str) -> AbortReceipt:
        """Queue ABORT before all other packets, without checks and without waiting for the store.

        Commands that are waiting in the queue are withdrawn, because they must not run after the ABORT. If the line is down
        or the driver hangs, raises Conflict and nothing is sent.
        """
        self._link.roles.operations.require(Operation.ABORT)
        with self._link.lock.within(ABORT_WITHIN_S, "ABORT was not sent"):
            if not self._link.line_is_open:  # the session would send ABORT at the next contact
                raise Conflict(
                    "ABORT was not sent: the line is down", got=self._link.reason, hint="open the link first"
                )
            self._newest_id = self._link.session.abort(self._link.monotonic_s())
            self.count += 1
            withdrawn = self._link.session.withdraw_all(f"ABORT by {user}")
            issued = AbortIssued(self._newest_id, user, source, self._now(), tuple(withdrawn))
            self._link.events.publish([issued])
        self._journal.add(IssuedAbort(issued.request_id, user, source, issued.at.isoformat()))
        return AbortReceipt(issued.request_id, issued.at, issued.recorded)

    def stops(self, request_id: int, count: int | None) -> bool:
        """True if an ABORT stops the command with this id. This is the case if ABORT was issued after the id was
        reserved, or if the number of ABORTs is no longer ``count`` (None: not checked). The caller must hold
        ``LinkService.lock``."""
        return request_id < self._newest_id or count not in (None, self.count)

    def record_left(self) -> None:
        """Store the ABORTs that the journal of the previous server contains, unless they are stored: the server can end
        before it updates the journal."""
        for issued in self._journal.entries():
            if not self._recorder.is_stored(issued.request_id, issued.moment):
                abort = self._link.roles.operations.command(Operation.ABORT)
                names = (issued.user, issued.source)
                self._recorder.add(issued.request_id, abort, {}, *names, None, None, issued.moment)
            self._journal.remove(issued.request_id)

    def record(self, issued: AbortIssued) -> None:
        """Store the row of an ABORT. The withdrawn commands and the event are stored by separate writes."""
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
