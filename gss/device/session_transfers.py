"""Transfers of a host session. One transfer is active on the line; the other transfers are queued. This module produces
messages and performs no I/O."""

from __future__ import annotations

from gss.device.protocol.codec import Decoded, encode
from gss.device.protocol.transfer import Compatibility, StatusPage
from gss.device.session_counters import LineQuality
from gss.device.session_events import Direction, Ranges, TransferDone, TransferState, TransferUpdate
from gss.device.session_transfer import (
    ENDED,
    MOVING,
    HeldPart,
    Part,
    RequestIds,
    ServiceMessage,
    SessionTransfer,
    checked_target,
)
from gss.device.session_transfer_exchange import TransferExchange, abort_message
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.instruments.dictionary.definitions import Dictionary

REPORT_EVERY_S = 0.25


class TransferManager:
    """Manages all transfers of a session. Each opening uses a new request id, which identifies the transfer on the
    line."""

    holds_channel = False
    """Always False: chunks and other packets share the line."""

    def __init__(self, dictionary: Dictionary, quality: LineQuality, next_id: int = 1) -> None:
        self._dictionary, self._quality, self._next_id = dictionary, quality, next_id
        self._transfers: dict[int, SessionTransfer] = {}
        self._by_session: dict[int, int] = {}
        self._exchange = TransferExchange()
        self.line_is_up = False
        self._unit = ""

    @property
    def line_bytes_s(self) -> float | None:
        """Rate of the line in bytes per second; None while unknown (no pacing)."""
        return self._exchange.line_bytes_s

    @line_bytes_s.setter
    def line_bytes_s(self, rate: float | None) -> None:
        self._exchange.line_bytes_s = rate

    # --- requests of the owner ----------------------------------------------------------------------------------

    def skip_ids(self, next_id: int) -> None:
        """Set the next transfer id to at least ``next_id``."""
        self._next_id = max(self._next_id, next_id)

    def start_download(
        self,
        kind: str,
        slot: int,
        *,
        partial: HeldPart | None = None,
        chunk_bytes: int | None = None,
        part: Part | None = None,
        paused: str = "",
        unit: str = "",
    ) -> int:
        """Queue a download and return its transfer id. Raises BadInput if the dictionary does not define the kind.

        ``partial``: data of an earlier attempt; only missing chunks are requested if the content is unchanged.
        ``part``: the region, or the side of star windows. ``chunk_bytes``: fixed chunk size, not adapted to the line.
        ``paused``: reason to wait until the device has identified itself. ``unit``: name of the unit to which
        the transfer belongs, by default the unit that answered or the next one. Raises Conflict if another unit is on
        the line.
        """
        size = self._chunk_size(kind, chunk_bytes, Direction.DOWN)
        transfer = SessionTransfer(self._next_id, Direction.DOWN, kind, checked_target(slot), size)
        transfer.part, transfer.grid_is_fixed = part or Part(), chunk_bytes is not None
        if partial is not None:
            transfer.take_held(partial)
        return self._queue(transfer, paused, unit)

    def start_upload(
        self,
        kind: str,
        target: int,
        data: bytes,
        compatibility: Compatibility,
        *,
        chunk_bytes: int | None = None,
        paused: str = "",
        unit: str = "",
    ) -> int:
        """Queue an upload to a bank or slot number and return its transfer id; verify and commit follow automatically.

        After an interruption, an upload of the same data to the same target resumes with the chunks that the device has
        stored. ``chunk_bytes``, ``paused`` and ``unit`` as in ``start_download``.
        """
        if not data:
            raise BadInput("nothing to upload", expected="at least 1 byte", got="0 bytes")
        size = self._chunk_size(kind, chunk_bytes, Direction.UP)
        transfer = SessionTransfer(self._next_id, Direction.UP, kind, checked_target(target), size, compatibility)
        transfer.take_content(data)
        transfer.grid_is_fixed = chunk_bytes is not None
        return self._queue(transfer, paused, unit)

    def _chunk_size(self, kind: str, requested: int | None, direction: Direction) -> int:
        """Return the chunk size to request. Raises BadInput if the dictionary does not define the kind."""
        opening = self._dictionary.service("OPEN_DOWNLOAD")
        item = next(f for f in opening.fields if f.name == "kind")
        encode([item], {"kind": kind})  # type: ignore[list-item]  # an item of a service is an Item
        return requested or self._quality.chunk_bytes(direction)

    def _queue(self, transfer: SessionTransfer, paused: str, unit: str) -> int:
        transfer.unit = unit or self._unit
        self._check_unit(transfer)
        if paused and not self.line_is_up:
            transfer.waits_for_device = True
            transfer.to(TransferState.PAUSED, paused)
        self._transfers[transfer.id] = transfer
        self._next_id += 1
        return transfer.id

    def _check_unit(self, transfer: SessionTransfer) -> None:
        if self.line_is_up and transfer.unit != self._unit:
            raise Conflict("the transfer belongs to another unit", expected=transfer.unit, got=self._unit)

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]:
        """Return the data of a download (zeros for missing chunks) and the ranges of the stored chunks."""
        transfer = self.get(transfer_id)
        return bytes(transfer.data), transfer.stored()[0]

    def get(self, transfer_id: int) -> SessionTransfer:
        """Return a transfer by its id. Raises NotFound."""
        try:
            return self._transfers[transfer_id]
        except KeyError:
            raise NotFound("unknown transfer", got=str(transfer_id)) from None

    def pause(self, transfer_id: int) -> None:
        """Pause a transfer; the device keeps the stored chunks. Raises Conflict if it cannot be paused now."""
        transfer = self.get(transfer_id)
        if transfer.state in ENDED or transfer.state in (TransferState.PAUSED, TransferState.VERIFYING):
            raise Conflict(
                "the transfer cannot be paused now", expected="queued or transferring", got=transfer.state.value
            )
        if transfer.session is not None:
            self._exchange.out.append(ServiceMessage("PAUSE", transfer.request_id, {"session": transfer.session}))
        transfer.waits_for_device = False
        transfer.to(TransferState.PAUSED)

    def resume(self, transfer_id: int) -> None:
        """Queue a paused, link_lost or failed transfer again. Raises Conflict in another state, and if another unit is on the
        line."""
        transfer = self.get(transfer_id)
        if transfer.state not in (TransferState.PAUSED, TransferState.LINK_LOST, TransferState.FAILED):
            raise Conflict(
                "the transfer cannot be resumed", expected="paused, link_lost or failed", got=transfer.state.value
            )
        self._check_unit(transfer)
        transfer.waits_for_device = False
        transfer.to(TransferState.QUEUED)

    def abort(self, transfer_id: int) -> None:
        """Abort a transfer at both ends. Raises Conflict if it has ended."""
        transfer = self.get(transfer_id)
        if transfer.state in ENDED:
            raise Conflict("the transfer has ended", got=transfer.state.value)
        if transfer.session is not None:
            self._exchange.out.append(abort_message(transfer.session, transfer.request_id, "aborted"))
        transfer.to(TransferState.ABORTED, "by the operator")

    def forget(self, transfer_id: int) -> None:
        """Remove a transfer that has ended. Raises Conflict if it has not ended."""
        if self.get(transfer_id).state not in ENDED:
            raise Conflict("the transfer has not ended", got=self.get(transfer_id).state.value)
        del self._transfers[transfer_id]
        self._by_session = {s: t for s, t in self._by_session.items() if t != transfer_id}

    def lose_line(self) -> None:
        """Set active transfers to link_lost after the port was lost."""
        self.line_is_up = False
        self._exchange.out.clear()
        for transfer in self._transfers.values():
            if transfer.state in MOVING:
                self._exchange.lose(transfer, "the line was lost", 0.0)

    def identified(self, unit: str) -> None:
        """Set the transfers of other units to failed after the unit with this name has identified itself. Transfers
        without a unit now belong to it."""
        if self._unit not in ("", unit):
            self._exchange.out.clear()
            self._by_session.clear()
        self._unit = unit
        for transfer in self._transfers.values():
            transfer.unit = transfer.unit or unit
            if transfer.state not in ENDED and transfer.unit != unit:
                transfer.session = None
                transfer.to(TransferState.FAILED, f"unit {unit} answered, not {transfer.unit}")

    def line_back(self) -> None:
        """Reopen transfers interrupted by a line loss or a restart, after the device has identified itself and its dictionary
        has been accepted."""
        self.line_is_up = True
        for transfer in self._transfers.values():
            if transfer.state is TransferState.PAUSED and transfer.waits_for_device:
                transfer.waits_for_device = False
                transfer.to(TransferState.QUEUED)
            if transfer.state is TransferState.LINK_LOST:
                transfer.due_s = 0.0

    def device_restarted(self, now_s: float) -> None:
        """Reopen the active transfer: the device has lost its sessions, but not the stored chunks."""
        for transfer in self._transfers.values():
            if transfer.state in MOVING and transfer.request_id:
                self._exchange.lose(transfer, "the device restarted", now_s)
                transfer.due_s = now_s

    def bank_in_use(self, bank: int) -> None:
        """Mark a committed upload as ACTIVE once its bank is the active catalogue."""
        for transfer in self._transfers.values():
            if transfer.state is TransferState.COMMITTED and (transfer.kind, transfer.target) == ("catalogue", bank):
                transfer.to(TransferState.ACTIVE)

    # --- time ---------------------------------------------------------------------------------------------------

    def current(self) -> SessionTransfer | None:
        """Return the transfer that uses the line, or None."""
        return next((t for t in self._transfers.values() if t.state in MOVING), None)

    def step(self, now_s: float, take_request_id: RequestIds) -> list[ServiceMessage]:
        """Return the messages (not chunks) to send now."""
        if not self.line_is_up:
            return []
        transfer = self.current()
        if transfer is None:
            transfer = next((t for t in self._transfers.values() if t.state is TransferState.QUEUED), None)
            if transfer is not None:
                self._exchange.begin_open(transfer, now_s, take_request_id)
        elif transfer.state is TransferState.LINK_LOST and now_s >= transfer.due_s:
            self._exchange.begin_open(transfer, now_s, take_request_id)
        elif transfer.state is TransferState.OPENING and now_s >= transfer.due_s:
            self._exchange.open_again(transfer, now_s)
        elif transfer.state is TransferState.TRANSFERRING:
            if not self._exchange.adapt(transfer, now_s, take_request_id):
                self._exchange.keep_moving(transfer, now_s)
        elif transfer.state is TransferState.VERIFYING and now_s >= transfer.due_s:
            self._exchange.ask_verify(transfer, now_s)
        messages = list(self._exchange.out)
        self._exchange.out.clear()
        return messages

    def next_chunk(self, now_s: float) -> ServiceMessage | None:
        """Return the next chunk to send, or None."""
        transfer = self.current()
        if (
            transfer is None
            or transfer.state is not TransferState.TRANSFERRING
            or transfer.sender is None
            or transfer.session is None
        ):
            return None
        choice = transfer.sender.next_chunk(now_s)
        if choice is None:
            return None
        index, serial = choice
        data = bytes(transfer.data[index * transfer.chunk_bytes : (index + 1) * transfer.chunk_bytes])
        return ServiceMessage(
            "CHUNK", transfer.request_id, {"session": transfer.session, "index": index, "serial": serial, "data": data}
        )

    # --- messages from the device -------------------------------------------------------------------------------

    def receive(self, service: str, request_id: int, message: Decoded, now_s: float) -> None:
        """Process a transfer message; a message for an unknown transfer is ignored."""
        if service == "OPENED":
            self._opened(request_id, message, now_s)
            return
        session = int(message.values["session"])
        if service == "ABORT_TRANSFER":
            self._refused(request_id, session, message, now_s)
            return
        transfer = self._transfers.get(self._by_session.get(session, -1))
        if transfer is None:
            return
        if transfer.session != session:
            self._exchange.after_the_end(transfer, service, session)
        elif service == "STATUS" and transfer.sender is not None and transfer.state is TransferState.TRANSFERRING:
            transfer.sender.on_status(StatusPage.of(message), now_s)
            transfer.tries = 0
            if transfer.sender.complete:
                self._exchange.begin_verify(transfer, now_s)
        elif service == "CHUNK" and transfer.receiver is not None:
            self._exchange.chunk(transfer, message, now_s)
        elif service == "STATUS_REQUEST":
            self._exchange.status_requested(transfer, message, now_s)
        elif service == "VERIFIED" and transfer.state is TransferState.VERIFYING:
            self._exchange.verified(transfer, message, now_s)
        elif service == "COMMITTED" and transfer.state is TransferState.VERIFYING:
            transfer.to(TransferState.COMMITTED)
            self._exchange.finish(transfer)

    def _of_request(self, request_id: int) -> SessionTransfer | None:
        return next((t for t in self._transfers.values() if t.request_id == request_id), None)

    def _opened(self, request_id: int, message: Decoded, now_s: float) -> None:
        transfer = self._of_request(request_id)
        if (
            transfer is not None
            and transfer.state is TransferState.OPENING
            and self._exchange.opened(transfer, message, now_s)
        ):
            self._by_session[int(message.values["session"])] = transfer.id

    def _refused(self, request_id: int, session: int, message: Decoded, now_s: float) -> None:
        transfer = self._of_request(request_id)
        if transfer is not None:
            self._exchange.refused(transfer, session, message, now_s)

    # --- reports ------------------------------------------------------------------------------------------------

    def news(self, now_s: float) -> list[TransferUpdate | TransferDone]:
        """Return updates since the last call: each state change, and progress every ``REPORT_EVERY_S``."""
        events: list[TransferUpdate | TransferDone] = []
        for transfer in self._transfers.values():
            progressing = transfer.state is TransferState.TRANSFERRING and now_s - transfer.reported_s >= REPORT_EVERY_S
            if transfer.changed or progressing:
                events.append(transfer.update(now_s, self.line_bytes_s))
                transfer.changed, transfer.reported_s = False, now_s
        events += self._exchange.done
        self._exchange.done = []
        return events
