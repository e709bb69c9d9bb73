"""Files on their way: frames down, catalogues and images up. Progress shown is what the receiving side says it stored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from gss.device.session import Compatibility
from gss.device.session_events import Direction, SessionEvent, TransferDone, TransferState, TransferUpdate
from gss.domain.errors import Conflict, StoreDown
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.link import LinkService
from gss.store import transfers as store
from gss.store.engine import Database
from gss.store.models import Transfer

PUBLISH_EVERY_S = 0.25
LOG_LINES = 40
ENDS = (
    TransferState.VERIFIED,
    TransferState.COMMITTED,
    TransferState.ACTIVE,
    TransferState.FAILED,
    TransferState.ABORTED,
)

DoneHook = Callable[[Transfer, TransferDone], dict[str, Any]]
BrokenHook = Callable[[Transfer, bytes, Sequence[tuple[int, int]], TransferUpdate], dict[str, Any]]


@dataclass(frozen=True)
class TransferView:
    """A transfer's row with the figures of the moment, None when it is not under way."""

    row: Transfer
    live: TransferUpdate | None


class TransferService:
    """Starts, follows and ends transfers; what arrives is handed to the hook of its kind."""

    def __init__(self, link: LinkService, database: Database, bus: EventBus, now: Now) -> None:
        self._link, self._database, self._bus, self._now = link, database, bus, now
        self._row_of: dict[int, int] = {}
        self._session_of: dict[int, int] = {}
        self._live: dict[int, TransferUpdate] = {}
        self._next_publish_s: dict[int, float] = {}
        self.done_hooks: dict[tuple[Direction, str], DoneHook] = {}
        self.broken_hooks: dict[str, BrokenHook] = {}

    def start(self) -> None:
        """Transfers of the last server ended with it. The device keeps what it stored; starting again resumes there."""
        with self._database.unit_of_work() as session:
            for row in store.unfinished(session):
                row.state, row.finished = "failed", self._now()
                row.reason = "the server stopped; start it again and only what is missing is sent"

    def download(self, kind: str, slot: int, subject: str) -> TransferView:
        """Bring down a frame, thumbnail or bank."""
        self._check_line()
        with self._link.lock:
            session_id = self._link.session.start_download(kind, slot, self._link.monotonic_s())
            return self._add(session_id, Direction.DOWN, kind, str(slot), subject)

    def upload(
        self,
        kind: str,
        target: int,
        data: bytes,
        compatibility: Compatibility,
        *,
        name: str,
        subject: str,
        **links: int | None,
    ) -> TransferView:
        """Send data to a bank or a slot; verify and commit follow by themselves. ``links``: catalogue_id, frame_id."""
        self._check_line()
        with self._link.lock:
            session_id = self._link.session.start_upload(kind, target, data, compatibility, self._link.monotonic_s())
            return self._add(session_id, Direction.UP, kind, name, subject, **links)

    def pause(self, transfer_id: int) -> TransferView:
        """Stop sending; what is stored stays stored."""
        return self._control(transfer_id, self._link.session.pause_transfer)

    def resume(self, transfer_id: int) -> TransferView:
        """Go on with what is missing."""
        return self._control(transfer_id, self._link.session.resume_transfer)

    def abort(self, transfer_id: int) -> TransferView:
        """Give it up on both sides."""
        return self._control(transfer_id, self._link.session.abort_transfer)

    def get(self, transfer_id: int) -> TransferView:
        """The transfer of that id."""
        with self._database.unit_of_work() as session:
            row = store.get(session, transfer_id)
        return TransferView(row, self._live.get(row.id))

    def newest(self, limit: int) -> list[TransferView]:
        """Newest first."""
        with self._database.unit_of_work() as session:
            return [TransferView(row, self._live.get(row.id)) for row in store.newest(session, limit)]

    def busy(self, direction: Direction) -> bool:
        """Is one of that direction under way?"""
        return any(update.direction is direction and update.state not in ENDS for update in self._live.values())

    def handle(self, events: Sequence[SessionEvent]) -> None:
        """Follow the transfers among these events."""
        for event in events:
            if isinstance(event, TransferUpdate) and event.transfer_id in self._row_of:
                self._update(self._row_of[event.transfer_id], event)
            elif isinstance(event, TransferDone) and event.transfer_id in self._row_of:
                self._done(self._row_of[event.transfer_id], event)

    def _update(self, row_id: int, update: TransferUpdate) -> None:
        before = self._live.get(row_id)
        self._live[row_id] = update
        changed = before is None or before.state is not update.state
        now_s = self._link.monotonic_s()
        if not changed and now_s < self._next_publish_s.get(row_id, 0.0):
            return
        self._next_publish_s[row_id] = now_s + PUBLISH_EVERY_S
        row = self._store(row_id, update, changed)
        if changed and update.state in (TransferState.FAILED, TransferState.LINK_LOST, TransferState.ABORTED):
            self._bus.record("transfer", "warning", f"{row.subject}: {_words(update)}", transfer_id=row_id)
            self._broken(row, update)
        if update.state in ENDS:
            self._live.pop(row_id, None)

    def _store(self, row_id: int, update: TransferUpdate, changed: bool) -> Transfer:
        with self._database.unit_of_work() as session:
            row = store.get(session, row_id)
            row.state, row.reason = str(update.state), update.reason
            row.size, row.chunk_size, row.resent = update.size, update.chunk_size, update.resent
            row.stored, row.sha256 = [list(r) for r in update.stored], update.sha256
            if changed:
                row.log = [*row.log[-LOG_LINES:], f"{self._now():%H:%M:%SZ} {_words(update)}"]
            if update.state in ENDS:
                row.finished = self._now()
        self._bus.publish("transfer", TransferView(row, update))
        return row

    def _done(self, row_id: int, done: TransferDone) -> None:
        hook = self.done_hooks.get((done.direction, done.kind))
        row = self.get(row_id).row
        links = hook(row, done) if hook else {}
        self._link_rows(row_id, links)
        with self._link.lock:
            self._link.session.forget_transfer(done.transfer_id)
        self._forget(row_id)

    def _broken(self, row: Transfer, update: TransferUpdate) -> None:
        hook = self.broken_hooks.get(row.kind)
        if hook is None or update.direction is not Direction.DOWN or not update.stored:
            return
        with self._link.lock:
            data, held = self._link.session.partial(update.transfer_id)
        self._link_rows(row.id, hook(row, data, held, update))

    def _link_rows(self, row_id: int, links: dict[str, Any]) -> None:
        if not links:
            return
        with self._database.unit_of_work() as session:
            row = store.get(session, row_id)
            for name, value in links.items():
                setattr(row, name, value)
        self._bus.publish("transfer", TransferView(row, self._live.get(row_id)))

    def _forget(self, row_id: int) -> None:
        self._row_of.pop(self._session_of.pop(row_id, -1), None)
        self._live.pop(row_id, None)

    def _control(self, transfer_id: int, action: Callable[[int, float], None]) -> TransferView:
        if transfer_id not in self._session_of:
            view = self.get(transfer_id)
            raise Conflict(
                "this transfer is not under way", got=view.row.state, hint="start it again; what is stored is kept"
            )
        with self._link.lock:
            action(self._session_of[transfer_id], self._link.monotonic_s())
        return self.get(transfer_id)

    def _add(
        self, session_id: int, direction: Direction, kind: str, target: str, subject: str, **links: int | None
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
            log=[],
            **links,
        )
        try:
            with self._database.unit_of_work() as session:
                store.add(session, row)
        except StoreDown:
            # What cannot be recorded is not sent.
            self._link.session.abort_transfer(session_id, self._link.monotonic_s())
            raise
        self._row_of[session_id], self._session_of[row.id] = row.id, session_id
        view = TransferView(row, None)
        self._bus.publish("transfer", view)
        return view

    def _check_line(self) -> None:
        if not self._link.connected:
            raise Conflict("the line is down", got=self._link.reason, hint="open the port first")


def _words(update: TransferUpdate) -> str:
    state = str(update.state).replace("_", " ")
    resumed = " (resumed)" if update.resumed else ""
    return (
        f"{state}{resumed}: {update.reason}" if update.reason else f"{state}{resumed}, {update.stored_bytes} B stored"
    )
