"""Transfers: downloads of frames and bank content; uploads of catalogues, tables and images. Progress counts the data
that the receiving side reports as stored.

All data needed to resume after a crash are stored before they are used: the content of an upload as a blob, the
received part of a download on disk, and all other data in the options of the row.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from gss.device.driver import Driver
from gss.device.protocol.transfer import Compatibility, chunk_count
from gss.device.session_events import Direction
from gss.device.session_transfer import HeldPart, Part
from gss.domain.errors import BadInput, Conflict, GssError
from gss.domain.json_object import JsonObject
from gss.instruments.operations import Operation
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.link import LinkService
from gss.operations.transfers.arrivals import Writer
from gss.operations.transfers.transfer_parts import PartStore
from gss.operations.transfers.transfer_progress import TransferProgress, TransferView
from gss.store import transfers as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Transfer

STORE_WITHIN_S = 5.0
"""Maximum time in seconds that a stopping server waits for content to be stored. If the time expires, the next server
resumes the download from its stored part."""

HELD_CHUNK_BYTES = 1024
"""Chunk size of stored content. The session converts it to the chunk size of the line."""
RESTARTED = "the server restarted"
RESUMABLE = ("paused", "link_lost", "failed", "aborted")


@dataclass(frozen=True)
class StoredContent:
    """An image of an earlier download. ``frame_number``: number on the device; ``data``: bytes as sent on the line."""

    frame_id: int
    frame_number: int
    data: bytes

    @property
    def sha256(self) -> str:
        """Hash of the data."""
        return hashlib.sha256(self.data).hexdigest()

    def as_complete_part(self) -> HeldPart:
        """Return the content as a completely received download."""
        last = chunk_count(len(self.data), HELD_CHUNK_BYTES) - 1
        return HeldPart(self.sha256, HELD_CHUNK_BYTES, self.data, ((0, last),))


Start = Callable[[Driver], int]
"""Function that starts a transfer in a session and returns its number there. It does not access the store or files."""


def prepare(row: Transfer, blobs: BlobStore, partial: HeldPart | None = None, paused: str | None = None) -> Start:
    """Read the data for the transfer of ``row``, and return a function that starts it in a session. ``partial``,
    ``paused``: see ``DriverTransfers``. Raises BadInput."""
    options = row.options
    if "slot" not in options:
        raise BadInput("the transfer was started by an older version of GSS", hint="start a new transfer")
    slot, reason, unit = int(options["slot"]), paused or "", str(options.get("unit", ""))
    if row.direction == Direction.DOWN:
        part = Part(**options["part"]) if options.get("part") else None
        return lambda session: session.transfers.start_download(
            row.kind, slot, partial=partial, part=part, paused=reason, unit=unit
        )
    facts = options["compatibility"]
    compatibility = Compatibility(**(facts | {"dictionary_hash": bytes.fromhex(facts["dictionary_hash"])}))
    data = blobs.get(options["content"])
    return lambda session: session.transfers.start_upload(row.kind, slot, data, compatibility, paused=reason, unit=unit)


DOWNLOADS = {
    "frame": Operation.DOWNLOAD_FRAME,
    "thumbnail": Operation.DOWNLOAD_FRAME,
    "region": Operation.DOWNLOAD_WINDOW,
    "star_windows": Operation.DOWNLOAD_WINDOW,
}
UPLOADS = {"image": Operation.UPLOAD_IMAGE, "catalogue": Operation.UPLOAD_CATALOGUE}
"""Operation of each kind of transfer. All other kinds are the content of a bank or a table."""


class TransferService:
    """Starts, pauses, resumes and aborts transfers; ``TransferProgress`` follows them.

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
        progress: TransferProgress,
        check_room: Callable[[str], None],
    ) -> None:
        self._writer, self._check_room = writer, check_room
        self._link, self._database, self._bus, self._now = link, database, bus, now
        self._blobs, self._parts, self._progress = blobs, parts, progress

    def start(self) -> None:
        """Restore the transfers that were open when the server stopped. They are paused until the device answers;
        transfers that an operator paused remain paused."""
        self._parts.prune()
        with self._database.unit_of_work() as session:
            rows = store.unfinished(session)
        for row in rows:
            by_operator = row.state == "paused" and row.reason == ""
            try:
                self._start_again(row, "" if by_operator else RESTARTED)
            except GssError as error:
                reason = f"{RESTARTED}; the transfer cannot continue: {error}"
                self._progress.note(row.id, state="failed", reason=reason, finished=self._now())
                continue
            self._progress.note(row.id, state="paused", reason="" if by_operator else RESTARTED)

    def stop(self) -> None:
        """Finish storing received content within STORE_WITHIN_S. Must be called after the line was closed."""
        self._writer.finish(STORE_WITHIN_S)
        self._progress.finalise()

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
        stored: StoredContent | None = None,
    ) -> TransferView:
        """Queue a download. ``slot``: number of the image memory or bank; ``target``: name of the bank, "" without a
        name; ``facts``: JSON values needed to store the content; ``stored``: an earlier download. If the device has the
        same content, no chunk is sent again."""
        self._link.roles.operations.require(DOWNLOADS.get(kind, Operation.READ_BACK))
        self._check_line()
        self._check_room("a download")
        options = {"slot": slot, "part": asdict(part) if part else None, "facts": dict(facts or {})}
        if stored is not None:
            options["stored"] = {
                "frame_id": stored.frame_id,
                "frame_number": stored.frame_number,
                "sha256": stored.sha256,
            }
        partial = stored.as_complete_part() if stored is not None else None
        return self._add(Direction.DOWN, kind, target or str(slot), subject, options, {}, partial)

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
        """Queue an upload to a bank or a slot. It is then verified and committed automatically. ``links``:
        catalogue_id, frame_id, table_id."""
        self._link.roles.operations.require(UPLOADS.get(kind, Operation.UPLOAD_PARAMETERS))
        self._check_line()
        self._check_room("an upload")
        facts = asdict(compatibility) | {"dictionary_hash": compatibility.dictionary_hash.hex()}
        options_stored = {"slot": target, "content": self._blobs.put(data), "compatibility": facts, **(options or {})}
        return self._add(Direction.UP, kind, name, subject, options_stored, links)

    def pause(self, transfer_id: int) -> TransferView:
        """Pause a transfer. Chunks that are already stored are kept."""
        return self._control(transfer_id, self._link.session.transfers.pause)

    def resume(self, transfer_id: int) -> TransferView:
        """Resume a transfer with the missing chunks, also if it failed, was aborted, or was started before the last
        restart. Raises Conflict if it cannot be resumed."""
        with self._link.hold_events():  # otherwise two requests at the same time could both start the transfer
            if self._progress.session_id(transfer_id) is not None:
                return self._control(transfer_id, self._link.session.transfers.resume)
            row = self.get(transfer_id).row
            if row.state not in RESUMABLE:
                raise Conflict("this transfer cannot be resumed", expected=" or ".join(RESUMABLE), got=row.state)
            self._start_again(row, None)
            self._progress.note(row.id, state="queued", reason="", finished=None)
        return self.get(transfer_id)

    def abort(self, transfer_id: int) -> TransferView:
        """Abort a transfer on the ground and on the device."""
        return self._control(transfer_id, self._link.session.transfers.abort)

    def _control(self, transfer_id: int, action: Callable[[int], None]) -> TransferView:
        view = self.get(transfer_id)
        session_id = self._progress.session_id(transfer_id)
        if session_id is None:
            raise Conflict("this transfer is not in progress", got=view.row.state)
        with self._link.lock:
            action(session_id)
        return self.get(transfer_id)

    # --- queries ------------------------------------------------------------------------------------------------

    def get(self, transfer_id: int) -> TransferView:
        """Return the transfer with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return self._progress.view(store.get(session, transfer_id))

    def newest(self, limit: int) -> list[TransferView]:
        """Return up to ``limit`` transfers, latest first."""
        with self._database.unit_of_work() as session:
            return [self._progress.view(row) for row in store.newest(session, limit)]

    def busy(self, direction: Direction) -> bool:
        """True if another transfer in a direction must wait; see ``TransferProgress``."""
        return self._progress.busy(direction)

    def in_use(self, kind: str, sha256: str) -> None:
        """Record which content the device uses: set the upload of this content to active, and other active uploads to
        committed."""
        with self._database.unit_of_work() as session:
            changed_rows = store.mark_active(session, kind, sha256)
        for row in changed_rows:
            self._bus.publish("transfer", TransferView(row, None))

    # --- session ------------------------------------------------------------------------------------------------

    def _add(
        self,
        direction: Direction,
        kind: str,
        target: str,
        subject: str,
        options: JsonObject,
        links: Mapping[str, int | None],
        partial: HeldPart | None = None,
    ) -> TransferView:
        hello = self._link.hello
        row = Transfer(
            contact_id=self._link.contact_id,
            direction=str(direction),
            kind=kind,
            target=target,
            subject=subject,
            state="queued",
            created=self._now(),
            stored=[],
            options=options | {"unit": hello.unit_name if hello is not None else ""},
            log=[],
            **links,
        )
        start = prepare(row, self._blobs, partial)
        with self._link.hold_events():
            with self._link.lock:
                session_id = start(self._link.session)
            try:
                with self._database.unit_of_work() as session:
                    store.add(session, row)
            except BaseException:
                # A transfer that cannot be recorded must not run.
                with self._link.lock:
                    self._link.session.transfers.abort(session_id)
                raise
            self._progress.follow(row.id, session_id)
        view = TransferView(row, None)
        self._bus.publish("transfer", view)
        return view

    def _start_again(self, row: Transfer, paused: str | None) -> None:
        """Start a stored transfer in the session again. ``paused``: "" pauses it until an operator resumes it, a reason
        pauses it until the device answers, None does not pause it."""
        start = prepare(row, self._blobs, self._parts.load(row.id), paused)
        with self._link.hold_events():
            with self._link.lock:
                session_id = start(self._link.session)
                if paused == "":
                    self._link.session.transfers.pause(session_id)
            self._progress.follow(row.id, session_id)

    def _check_line(self) -> None:
        if not self._link.connected:
            raise Conflict("the line is down", got=self._link.reason, hint="open the link first")
