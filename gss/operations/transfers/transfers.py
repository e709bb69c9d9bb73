"""Transfers in progress: frames down; catalogues, tables and images up. Progress is what the receiving side reports as stored.

Everything needed to resume after a crash is stored before anything is sent: the content of an upload as a blob, the received
part of a download on disk, and everything else in the row's options.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import Any

from gss.device.session import Compatibility, HeldPart, Part
from gss.device.session_events import Direction, TransferDone, TransferState, TransferUpdate
from gss.domain.errors import Conflict, GssError, StoreDown
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.transfers.arrivals import Storing, Writer
from gss.operations.transfers.content_events import ContentArrived, PartArrived
from gss.operations.transfers.transfer_parts import PartStore
from gss.operations.transfers.transfer_rows import TransferRows, TransferView, prepare, words_of
from gss.store import transfers as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Transfer

log = logging.getLogger("gss.transfers")
PUBLISH_EVERY_S = 0.25
KEEP_PART_EVERY_S = 2.0
STORE_WITHIN_S = 5.0
"""How long a stopping server waits for content being stored. Otherwise the download is completed again from its kept part."""

RESTARTED = "the server restarted"
ENDS = tuple(map(TransferState, ("verified", "committed", "active", "failed", "aborted")))
BROKEN = (TransferState.FAILED, TransferState.LINK_LOST, TransferState.ABORTED)
AT_REST = (*ENDS, TransferState.PAUSED)
RESUMABLE = ("paused", "link_lost", "failed", "aborted")


class TransferService:
    """Starts, follows and ends transfers. Arrived content is published as ContentArrived and PartArrived.

    ``check_room`` raises StoreDown if the disk is too full; its argument names the operation.
    """

    def __init__(
        self,
        link: LinkService,
        database: Database,
        bus: EventBus,
        now: Now,
        blobs: BlobStore,
        parts: PartStore,
        writer: Writer,
        check_room: Callable[[str], None],
    ) -> None:
        self._writer, self._check_room = writer, check_room
        self._link, self._database, self._bus, self._now = link, database, bus, now
        self._rows = TransferRows(database, bus, now)
        self._blobs, self._parts = blobs, parts
        self._row_of: dict[int, int] = {}
        self._session_of: dict[int, int] = {}
        self._live: dict[int, TransferUpdate] = {}
        self._next_publish_s: dict[int, float] = {}
        self._next_part_s: dict[int, float] = {}
        self._storing: list[Storing] = []
        self._parts_arrived: list[PartArrived] = []
        self._recorded: dict[int, tuple[TransferState, str]] = {}
        self._writes = DeferredWrites()

    def start(self) -> None:
        """Restore the transfers that the last server left open, paused until the device answers; those that an operator had
        paused remain paused."""
        self._parts.prune()
        with self._database.unit_of_work() as session:
            rows = store.unfinished(session)
        for row in rows:
            by_operator = row.state == "paused" and row.reason == ""
            try:
                self._enter(row, "" if by_operator else RESTARTED)
            except GssError as error:
                reason = f"{RESTARTED}, and this cannot go on: {error}"
                self._rows.note(row.id, state="failed", reason=reason, finished=self._now())
                continue
            self._rows.note(row.id, state="paused", reason="" if by_operator else RESTARTED)

    def stop(self) -> None:
        """Called after the line was closed: finish storing received content, within a time limit."""
        self._writer.finish(STORE_WITHIN_S)
        self.settle()

    # --- operator requests --------------------------------------------------------------------------------------

    def download(
        self,
        kind: str,
        slot: int,
        subject: str,
        *,
        part: Part | None = None,
        facts: Mapping[str, Any] | None = None,
        target: str = "",
    ) -> TransferView:
        """Queue a download. ``slot``: number of the image memory or bank; ``target``: its name, if any. ``facts``: JSON
        values needed to store the content."""
        self._check_line()
        self._check_room("a download")
        options = {"slot": slot, "part": asdict(part) if part else None, "facts": dict(facts or {})}
        return self._add(Direction.DOWN, kind, target or str(slot), subject, options, {})

    def upload(
        self,
        kind: str,
        target: int,
        data: bytes,
        compatibility: Compatibility,
        *,
        name: str,
        subject: str,
        options: Mapping[str, Any] | None = None,
        **links: int | None,
    ) -> TransferView:
        """Queue an upload to a bank or a slot; verification and commit follow automatically. ``links``: catalogue_id,
        frame_id, table_id."""
        self._check_line()
        self._check_room("an upload")
        facts = asdict(compatibility) | {"dictionary_hash": compatibility.dictionary_hash.hex()}
        kept = {"slot": target, "content": self._blobs.put(data), "compatibility": facts, **(options or {})}
        return self._add(Direction.UP, kind, name, subject, kept, links)

    def pause(self, transfer_id: int) -> TransferView:
        """Stop sending; chunks already stored are kept."""
        return self._control(transfer_id, self._link.session.pause_transfer)

    def resume(self, transfer_id: int) -> TransferView:
        """Resume with the missing chunks; also a transfer that failed or was aborted, by this server or an earlier one.
        Raises Conflict if it cannot be resumed."""
        if transfer_id in self._session_of:
            return self._control(transfer_id, self._link.session.resume_transfer)
        row = self.get(transfer_id).row
        if row.state not in RESUMABLE:
            raise Conflict("this transfer cannot go on", expected=" or ".join(RESUMABLE), got=row.state)
        with self._link.hold_events():
            self._enter(row, None)
            self._rows.note(row.id, state="queued", reason="", finished=None)
        return self.get(transfer_id)

    def abort(self, transfer_id: int) -> TransferView:
        """Abort the transfer on both sides."""
        return self._control(transfer_id, self._link.session.abort_transfer)

    def _control(self, transfer_id: int, action: Callable[[int, float], None]) -> TransferView:
        view = self.get(transfer_id)
        if transfer_id not in self._session_of:
            raise Conflict("this transfer is not under way", got=view.row.state)
        with self._link.lock:
            action(self._session_of[transfer_id], self._link.monotonic_s())
        return self.get(transfer_id)

    # --- queries ------------------------------------------------------------------------------------------------

    def get(self, transfer_id: int) -> TransferView:
        """Return the transfer with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            row = store.get(session, transfer_id)
        return TransferView(row, self._live.get(row.id))

    def newest(self, limit: int) -> list[TransferView]:
        """Return the newest transfers first."""
        with self._database.unit_of_work() as session:
            return [TransferView(row, self._live.get(row.id)) for row in store.newest(session, limit)]

    def busy(self, direction: Direction) -> bool:
        """True if a transfer in that direction is in progress. One that is only being stored does not count, unless the
        writer's queue is full."""
        stored = {one.row.id for one in self._storing}
        return (direction is Direction.DOWN and self._writer.full) or any(
            update.direction is direction and update.state not in AT_REST and row_id not in stored
            for row_id, update in self._live.items()
        )

    def in_use(self, kind: str, sha256: str) -> None:
        """Record that the device now uses that content: the upload that sent it becomes active, others committed."""
        with self._database.unit_of_work() as session:
            changed = store.mark_active(session, kind, sha256)
        for row in changed:
            self._bus.publish("transfer", TransferView(row, None))

    # --- session ------------------------------------------------------------------------------------------------

    def _add(
        self,
        direction: Direction,
        kind: str,
        target: str,
        subject: str,
        options: dict[str, Any],
        links: Mapping[str, int | None],
    ) -> TransferView:
        row = Transfer(
            contact_id=self._link.contact_id,
            direction=str(direction),
            kind=kind,
            target=target,
            subject=subject,
            state="queued",
            created=self._now(),
            stored=[],
            options=options,
            log=[],
            **links,
        )
        start = prepare(row, self._blobs)
        with self._link.hold_events():
            with self._link.lock:
                session_id = start(self._link.session, self._link.monotonic_s())
            try:
                with self._database.unit_of_work() as session:
                    store.add(session, row)
            except BaseException:
                # A transfer that cannot be recorded must not run.
                with self._link.lock:
                    self._link.session.abort_transfer(session_id, self._link.monotonic_s())
                raise
            self._row_of[session_id], self._session_of[row.id] = row.id, session_id
        view = TransferView(row, None)
        self._bus.publish("transfer", view)
        return view

    def _enter(self, row: Transfer, paused: str | None) -> None:
        """Start a stored transfer in the session again. ``paused``: "" until an operator resumes it, a reason until the
        device answers, None not at all."""
        start = prepare(row, self._blobs, self._parts.load(row.id), paused)
        with self._link.hold_events():
            with self._link.lock:
                now_s = self._link.monotonic_s()
                session_id = start(self._link.session, now_s)
                if paused == "":
                    self._link.session.pause_transfer(session_id, now_s)
            self._row_of[session_id], self._session_of[row.id] = row.id, session_id

    def _check_line(self) -> None:
        if not self._link.connected:
            raise Conflict("the line is down", got=self._link.reason, hint="open the port first")

    # --- events -------------------------------------------------------------------------------------------------

    def handle(self, batch: LineBatch) -> list[ContentArrived | PartArrived]:
        """Update the transfers of a batch. Content is stored before its transfer is reported as complete."""
        known = [
            e for e in batch.events if isinstance(e, TransferUpdate | TransferDone) and e.transfer_id in self._row_of
        ]
        arrived = [event for event in known if isinstance(event, TransferDone)]
        contents = [ContentArrived(self.get(self._row_of[done.transfer_id]).row, done) for done in arrived]
        self._storing += [Storing(c.transfer, c.answers, c.done.transfer_id) for c in contents]
        for update in known:
            if isinstance(update, TransferUpdate) and update.transfer_id in self._row_of:
                storing = self._stored_later(update.transfer_id)
                if storing is None:
                    self._writes.add(partial(self._update, self._row_of[update.transfer_id], update))
                else:
                    storing.held.append(update)
        self._writes.run()
        return [*contents, *self._take_parts()]

    def settle(self) -> None:
        """Complete the transfers whose content has been stored. Called periodically by the dispatcher."""
        try:
            for one in [storing for storing in self._storing if storing.answers.ready()]:
                self._settle(one)
            self._writes.run()
        except StoreDown as error:
            log.warning("a transfer waits for the store: %s", error)
        self._link.events.publish(self._take_parts())

    def _settle(self, one: Storing) -> None:
        """Record the outcome, then the updates received meanwhile. StoreDown leaves it where it is, to be continued."""
        if not one.linked:
            self._link_to(one)
            one.linked = True
        while one.held:
            self._update(one.row.id, one.held[0])
            one.held.pop(0)
        if one.transfer_id is not None:
            if one.keeps_part:
                self._rows.note(one.row.id, state=str(TransferState.FAILED), reason="received, but not stored")
            self._end(one.transfer_id, keep_part=one.keeps_part)
        self._storing.remove(one)

    def _take_parts(self) -> list[PartArrived]:
        parts, self._parts_arrived = self._parts_arrived, []
        return parts

    def _stored_later(self, transfer_id: int) -> Storing | None:
        return next((one for one in self._storing if one.transfer_id == transfer_id), None)

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
            data, held = self._link.session.partial(update.transfer_id)
        try:
            self._parts.keep(row_id, HeldPart(update.sha256, update.chunk_size, data, held))
        except OSError as error:
            self._bus.record("transfer", "watch", f"what has arrived could not be kept: {error}", transfer_id=row_id)

    def _store(self, row_id: int, update: TransferUpdate, changed: bool) -> Transfer:
        values: dict[str, Any] = {
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
        return self._rows.note(row_id, words_of(update) if changed else "", update, **values)

    def _broken(self, row: Transfer, update: TransferUpdate) -> None:
        if update.direction is not Direction.DOWN or not update.stored:
            return
        with self._link.lock:
            data, held = self._link.session.partial(update.transfer_id)
        part = PartArrived(row, data, held, update)
        self._storing.append(Storing(row, part.answers, None))
        self._parts_arrived.append(part)

    def _link_to(self, one: Storing) -> None:
        """Store the links to the rows made from the content, or why there are none. Content that could not be stored at all, for
        another reason than its own, can be downloaded again."""
        row = one.row
        try:
            if one.answers.missing and one.transfer_id is not None and row.direction == Direction.DOWN:
                raise StoreDown("nothing stored it")
            links = one.answers.links()
        except Exception as error:  # a transfer must not be reported as complete whatever went wrong
            one.keeps_part = isinstance(error, StoreDown) or not isinstance(error, GssError)
            if not isinstance(error, GssError):
                log.exception("content of transfer %d was not stored", row.id)
            text = f"{row.subject} was received, but cannot be used: {error}"
            self._rows.note(row.id, text)
            self._writes.add(partial(self._bus.record, "transfer", "warning", text, transfer_id=row.id))
            return
        if links:
            self._rows.note(row.id, **links)

    def _forget(self, row_id: int, session_id: int) -> None:
        with self._link.lock:
            self._link.session.forget_transfer(session_id)
        self._row_of.pop(session_id, None)
        for memory in (self._session_of, self._live, self._next_publish_s, self._next_part_s, self._recorded):
            memory.pop(row_id, None)
