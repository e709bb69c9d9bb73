"""ABORT: queued for the line at once, recorded when the store can take it."""

from __future__ import annotations

import logging
from collections import deque
from concurrent.futures import Future
from dataclasses import dataclass
from datetime import datetime

from gss.device.session_events import CommandStage
from gss.domain.errors import Conflict, StoreDown
from gss.operations.clock import Now
from gss.operations.commanding.command_record import CommandRecorder
from gss.operations.events import EventBus
from gss.operations.line.line_events import AbortIssued, LineBatch
from gss.operations.line.link import LinkService
from gss.store.models import Command

log = logging.getLogger("gss.commands")
RECORD_WITHIN_S = 10.0
"""Longer than a locked store is waited for."""


@dataclass(frozen=True)
class AbortReceipt:
    """ABORT leaves on the line at the next opportunity. ``at``: when it was queued; ``recorded``: resolves to its row."""

    request_id: int
    at: datetime
    recorded: Future[Command]

    def row(self, within_s: float = RECORD_WITHIN_S) -> Command:
        """The command's row. StoreDown if it is not stored within that time; ABORT was sent all the same."""
        try:
            return self.recorded.result(within_s)
        except TimeoutError:
            raise StoreDown(
                "ABORT was sent but is not recorded yet", hint="look at the database and the disk"
            ) from None


class Aborts:
    """Issues ABORT without waiting for anything, and records it from the event queue."""

    def __init__(self, link: LinkService, recorder: CommandRecorder, bus: EventBus, now: Now) -> None:
        self._link, self._recorder, self._bus, self._now = link, recorder, bus, now
        self.count = 0
        """ABORTs issued since the server started."""
        self._newest_id = 0
        self._unrecorded: deque[AbortIssued] = deque()
        self._withdrawn: list[CommandStage] = []

    def issue(self, user: str, source: str) -> AbortReceipt:
        """Send ABORT ahead of everything, without checks and without waiting for the store.

        Commands that still wait in the queue are withdrawn: they must not run after everything was stopped. Raises Conflict while
        the line is down; nothing is sent then.
        """
        with self._link.lock:
            if not self._link.line_is_open:  # the session would keep it for the next line
                raise Conflict(
                    "ABORT was not sent: the line is down", got=self._link.reason, hint="open the port first"
                )
            self._newest_id = self._link.session.abort(self._link.monotonic_s())
            self.count += 1
            withdrawn = self._link.session.withdraw_all(f"ABORT by {user}")
            issued = AbortIssued(self._newest_id, user, source, tuple(withdrawn))
            self._link.events.publish([issued])
        return AbortReceipt(issued.request_id, self._now(), issued.recorded)

    def stops(self, request_id: int, count: int | None) -> bool:
        """True if an ABORT overtook the command with that id, or was issued after ``count`` ABORTs. Hold ``LinkService.lock``."""
        return request_id < self._newest_id or count not in (None, self.count)

    def handle(self, batch: LineBatch) -> None:
        """Store the ABORTs of a batch and what they withdrew; what a locked store cannot take, with a later batch."""
        self._unrecorded.extend(event for event in batch.events if isinstance(event, AbortIssued))
        try:
            while self._unrecorded:
                self._record(self._unrecorded[0])
            if self._withdrawn:
                self._recorder.taken_back(self._withdrawn)
                self._withdrawn.clear()
        except StoreDown as error:
            log.warning("%d ABORT commands are not recorded yet: %s", len(self._unrecorded), error)

    def _record(self, issued: AbortIssued) -> None:
        contact_id = self._link.contact_id
        row = self._recorder.add(issued.request_id, "ABORT", {}, issued.user, issued.source, contact_id, None)
        self._unrecorded.popleft()  # the row exists: whatever fails from here on must not add a second one
        self._withdrawn.extend(issued.withdrawn)
        issued.recorded.set_result(row)
        self._recorder.catch_up(issued.request_id)
        more = f"; withdrawn unsent: {len(issued.withdrawn)}" if issued.withdrawn else ""
        self._bus.record("command", "watch", f"ABORT by {issued.user}{more}", command_id=row.id)
