"""Follows the transfers in progress, and writes their progress, received parts and stored content to their rows."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import Any

from gss.device.session_events import Direction, TransferDone, TransferState, TransferUpdate
from gss.device.session_transfer import HeldPart
from gss.domain.errors import GssError, StoreDown
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.transfers.arrivals import ContentArrived, PartArrived, Storing, Writer
from gss.operations.transfers.transfer_parts import PartStore
from gss.store import transfers as store
from gss.store.engine import Database
from gss.store.models import Transfer

log = logging.getLogger("gss.transfers")
PUBLISH_EVERY_S = 0.25
KEEP_PART_EVERY_S = 2.0
LOG_LINES = 40

ENDS = tuple(map(TransferState, ("verified", "committed", "active", "failed", "aborted")))
BROKEN = (TransferState.FAILED, TransferState.LINK_LOST, TransferState.ABORTED)
AT_REST = (*ENDS, TransferState.PAUSED)


@dataclass(frozen=True)
class TransferView:
    """A transfer's row with its current progress. ``live``: None if the transfer is not in progress."""

    row: Transfer
    live: TransferUpdate | None


class TransferProgress:
    """Maps rows to transfers in the session, handles the events of transfers, and publishes their content as
    ContentArrived and PartArrived."""

    def __init__(
        self, link: LinkService, database: Database, bus: EventBus, now: Now, parts: PartStore, writer: Writer
    ) -> None:
        self._link, self._database, self._bus, self._now = link, database, bus, now
        self._parts, self._writer = parts, writer
        self._row_of: dict[int, int] = {}
        self._session_of: dict[int, int] = {}
        self._live: dict[int, TransferUpdate] = {}
        self._next_publish_s: dict[int, float] = {}
        self._next_part_s: dict[int, float] = {}
        self._received: list[TransferUpdate | TransferDone] = []
        self._storing: list[Storing] = []
        self._parts_arrived: list[PartArrived] = []
        self._recorded: dict[int, tuple[TransferState, str]] = {}
        self._writes = DeferredWrites()

    def follow(self, row_id: int, session_id: int) -> None:
        """Follow the transfer of a row. ``session_id``: number of the transfer in the session."""
        self._row_of[session_id], self._session_of[row_id] = row_id, session_id

    def session_id(self, row_id: int) -> int | None:
        """Return the number of a row's transfer in the session; None if the session does not contain it."""
        return self._session_of.get(row_id)

    def view(self, row: Transfer) -> TransferView:
        """Return a row with its current progress."""
        return TransferView(row, self._live.get(row.id))

    def busy(self, direction: Direction) -> bool:
        """True if a transfer in a direction is in progress. A transfer whose content is only being stored does not
        count. For downloads, also true while the writer's queue is full."""
        storing_ids = {storing.row.id for storing in self._storing}
        return (direction is Direction.DOWN and self._writer.full) or any(
            update.direction is direction and update.state not in AT_REST and row_id not in storing_ids
            for row_id, update in self._live.items()
        )

    def note(self, row_id: int, line: str = "", live: TransferUpdate | None = None, **values: Any) -> Transfer:
        """Change columns of a transfer's row, append a line to the transfer's log, and publish the row."""
        if not line and "state" in values and live is None:
            line = f"{values['state']}: {values['reason']}" if values.get("reason") else str(values["state"])
        with self._database.unit_of_work() as session:
            row = store.get(session, row_id)
            for name, value in values.items():
                setattr(row, name, value)
            if line:
                row.log = [*row.log[-LOG_LINES:], f"{self._now():%H:%M:%SZ} {line}"]
        self._bus.publish("transfer", TransferView(row, live))
        return row

    def handle(self, batch: LineBatch) -> list[ContentArrived | PartArrived]:
        """Update the transfers of a batch. Content is stored before its transfer is reported as complete."""
        self._received += [event for event in batch.events if isinstance(event, TransferUpdate | TransferDone)]
        contents = self._take_in()
        self._writes.run()
        return [*contents, *self._interrupted_parts()]

    def _take_in(self) -> list[ContentArrived]:
        """Handle the received events. If the store is down, they remain for the next call, because the session reports received
        content only once."""
        followed, self._received = [event for event in self._received if event.transfer_id in self._row_of], []
        try:
            contents = [
                ContentArrived(self._row(self._row_of[event.transfer_id]), event)
                for event in followed
                if isinstance(event, TransferDone)
            ]
        except StoreDown as error:
            log.warning("received content is waiting for the store: %s", error)
            self._received = followed
            return []
        self._storing += [Storing(c.transfer, c.answers, c.done.transfer_id) for c in contents]
        for update in followed:
            if isinstance(update, TransferUpdate) and update.transfer_id in self._row_of:
                storing = self._storing_of(update.transfer_id)
                if storing is None:
                    self._writes.add(partial(self._update, self._row_of[update.transfer_id], update))
                else:
                    storing.deferred.append(update)
        return contents

    def _row(self, row_id: int) -> Transfer:
        with self._database.unit_of_work() as session:
            return store.get(session, row_id)

    def finalise(self) -> None:
        """Complete the transfers whose content has been stored. Called periodically by the dispatcher."""
        try:
            for ready in [storing for storing in self._storing if storing.answers.ready()]:
                self._complete(ready)
            self._writes.run()
        except StoreDown as error:
            log.warning("a transfer is waiting for the store: %s", error)
        self._link.events.publish([*self._take_in(), *self._interrupted_parts()])

    def _complete(self, storing: Storing) -> None:
        """Record the outcome, then the updates received while the content was stored. After StoreDown, the next call
        continues."""
        if not storing.linked:
            self._link_to(storing)
            storing.linked = True
        while storing.deferred:
            self._update(storing.row.id, storing.deferred[0])
            storing.deferred.pop(0)
        if storing.transfer_id is not None:
            self._end(storing.transfer_id, keep_part=storing.keeps_part)
            if storing.keeps_part:  # last, because a transfer that is shown as failed can be resumed
                reason = "received, but not stored"
                self._writes.add(partial(self.note, storing.row.id, state=str(TransferState.FAILED), reason=reason))
        self._storing.remove(storing)

    def _interrupted_parts(self) -> list[PartArrived]:
        parts, self._parts_arrived = self._parts_arrived, []
        return parts

    def _storing_of(self, transfer_id: int) -> Storing | None:
        return next((storing for storing in self._storing if storing.transfer_id == transfer_id), None)

    def _end(self, transfer_id: int, *, keep_part: bool) -> None:
        row_id = self._row_of[transfer_id]
        if not keep_part:
            self._parts.drop(row_id)
        self._forget(row_id, transfer_id)

    def _update(self, row_id: int, update: TransferUpdate) -> None:
        self._live[row_id] = update
        changed = self._recorded.get(row_id) != (update.state, update.reason)
        now_s = self._link.monotonic_s()
        if changed or now_s >= self._next_part_s.get(row_id, 0.0):
            self._next_part_s[row_id] = now_s + KEEP_PART_EVERY_S
            self._keep_part(row_id, update)
        if not changed and now_s < self._next_publish_s.get(row_id, 0.0):
            return
        self._next_publish_s[row_id] = now_s + PUBLISH_EVERY_S
        row = self._store(row_id, update, changed)
        self._recorded[row_id] = (update.state, update.reason)
        if changed and update.state in BROKEN:
            text = f"{row.subject}: {words_of(update)}"
            self._writes.add(partial(self._bus.record, "transfer", "warning", text, transfer_id=row_id))
            self._broken(row, update)
        if update.state in (TransferState.FAILED, TransferState.ABORTED):
            self._forget(row_id, update.transfer_id)
        elif update.state in ENDS:
            self._live.pop(row_id, None)

    def _keep_part(self, row_id: int, update: TransferUpdate) -> None:
        if update.direction is not Direction.DOWN or not update.stored or update.state is TransferState.VERIFIED:
            return
        with self._link.lock:
            data, chunks = self._link.session.transfers.partial(update.transfer_id)
        try:
            self._parts.keep(row_id, HeldPart(update.sha256, update.chunk_size, data, chunks))
        except OSError as error:
            self._bus.record(
                "transfer",
                "watch",
                f"Received data could not be stored on disk: {error}",
                transfer_id=row_id,
            )

    def _store(self, row_id: int, update: TransferUpdate, changed: bool) -> Transfer:
        values: dict[str, object] = {
            "state": str(update.state),
            "reason": update.reason,
            "size": update.size,
            "chunk_size": update.chunk_size,
            "resent": update.resent,
            "stored": [list(r) for r in update.stored],
            "sha256": update.sha256,
        }
        if update.state in ENDS:
            values["finished"] = self._now()
        return self.note(row_id, words_of(update) if changed else "", update, **values)

    def _broken(self, row: Transfer, update: TransferUpdate) -> None:
        if update.direction is not Direction.DOWN or not update.stored:
            return
        with self._link.lock:
            data, chunks = self._link.session.transfers.partial(update.transfer_id)
        part = PartArrived(row, data, chunks, update)
        self._storing.append(Storing(row, part.answers, None))
        self._parts_arrived.append(part)

    def _link_to(self, storing: Storing) -> None:
        """Store the links to the rows created from the content, or the reason why there are none. If valid content
        could not be stored, the received part is kept, so that the download can be resumed."""
        row = storing.row
        try:
            if storing.answers.missing and storing.transfer_id is not None and row.direction == Direction.DOWN:
                raise StoreDown("no service stored it")
            links = storing.answers.links()
        except Exception as error:  # after any error, the transfer must not be reported as complete
            storing.keeps_part = isinstance(error, StoreDown) or not isinstance(error, GssError)
            if not isinstance(error, GssError):
                log.exception("content of transfer %d was not stored", row.id)
            text = f"{row.subject} was received but is not usable: {error}"
            self.note(row.id, text)
            self._writes.add(partial(self._bus.record, "transfer", "warning", text, transfer_id=row.id))
            return
        if links:
            self.note(row.id, **links)

    def _forget(self, row_id: int, session_id: int) -> None:
        with self._link.lock:
            self._link.session.transfers.forget(session_id)
        self._row_of.pop(session_id, None)
        for memory in (self._session_of, self._live, self._next_publish_s, self._next_part_s, self._recorded):
            memory.pop(row_id, None)


def words_of(update: TransferUpdate) -> str:
    """Return a log line: state, whether it was resumed, and reason or progress."""
    state = str(update.state).replace("_", " ")
    resumed = " (resumed)" if update.resumed else ""
    return (
        f"{state}{resumed}: {update.reason}" if update.reason else f"{state}{resumed}, {update.stored_bytes} B stored"
    )
