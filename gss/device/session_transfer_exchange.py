"""Host side of a transfer's message exchange: open, transfer, check, verify, commit, close."""

from __future__ import annotations

import hashlib
from collections import deque

from gss.device.protocol.chunk_size import regrid
from gss.device.protocol.codec import Decoded
from gss.device.protocol.transfer import ChunkReceiver, ChunkSender, StatusPage, request_patience_s
from gss.device.session_events import Direction, TransferDone, TransferState
from gss.device.session_transfer import ENDED, NO_HASH, RequestIds, ServiceMessage, SessionTransfer
from gss.instruments.dictionary.definitions import Value

OPEN_AGAIN_S = 0.5
VERIFY_AGAIN_S = 1.5
POKE_S = 0.4
SILENT_TRIES = 6
RETRY_LOST_S = 4.0


STARTED_OVER = {
    Direction.UP: "the device no longer has the stored chunks: started over",
    Direction.DOWN: "the content on board has changed: started over",
}


def abort_message(session: int, request_id: int, reason: str) -> ServiceMessage:
    """Return ABORT_TRANSFER for a session of the device."""
    return ServiceMessage("ABORT_TRANSFER", request_id, {"session": session, "reason": reason, "detail": ""})


class TransferExchange:
    """Host side of the transfer protocol.

    ``out``: messages to send. ``done``: finished transfers. ``line_bytes_s``: line rate, None if unknown (no pacing).
    """

    def __init__(self) -> None:
        self.out: deque[ServiceMessage] = deque()
        self.done: list[TransferDone] = []
        self.line_bytes_s: float | None = None

    def begin_open(self, transfer: SessionTransfer, now_s: float, take_request_id: RequestIds) -> None:
        """Open the transfer with a new request id."""
        transfer.request_id = take_request_id()
        transfer.session, transfer.tries, transfer.committing = None, 0, False
        transfer.to(TransferState.OPENING)
        self.open_again(transfer, now_s)

    def open_again(self, transfer: SessionTransfer, now_s: float) -> None:
        """Send the opening message. Called again until it is answered; after too many tries the state becomes
        link_lost."""
        if transfer.tries >= SILENT_TRIES:
            self.lose(transfer, "no answer to the opening", now_s)
            return
        transfer.tries += 1
        transfer.due_s = now_s + (OPEN_AGAIN_S + 2 * self._chunk_time_s(transfer)) * transfer.tries
        values: dict[str, Value] = {
            "kind": transfer.kind,
            "target": transfer.target,
            "chunk_bytes": transfer.wanted_chunk_bytes,
        }
        if transfer.direction is Direction.DOWN:
            part = transfer.part
            values["held_sha256"] = transfer.sha256
            values |= {"col_px": part.col_px, "row_px": part.row_px, "columns": part.columns, "rows": part.rows}
            self.out.append(ServiceMessage("OPEN_DOWNLOAD", transfer.request_id, values))
            return
        compatibility = transfer.compatibility
        values |= {
            "size_bytes": transfer.size,
            "sha256": transfer.sha256,
            "device_model": compatibility.device_model,
            "profile": compatibility.profile,
        }
        values |= {"dictionary_hash": compatibility.dictionary_hash, "format_version": compatibility.format_version}
        values |= {"epoch_jyear": compatibility.epoch_jyear, "stars": compatibility.stars, "pairs": compatibility.pairs}
        self.out.append(ServiceMessage("OPEN_UPLOAD", transfer.request_id, values))

    def adapt(self, transfer: SessionTransfer, now_s: float, take_request_id: RequestIds) -> bool:
        """Reopen the transfer with smaller chunks if losses are high; stored data are kept. Returns True if
        reopened."""
        smaller = transfer.smaller_chunks()
        if smaller is None or transfer.session is None:
            return False
        self.out.append(ServiceMessage("PAUSE", transfer.request_id, {"session": transfer.session}))
        transfer.wanted_chunk_bytes, transfer.note = smaller, f"the line is noisy: chunk size reduced to {smaller} B"
        self.begin_open(transfer, now_s, take_request_id)
        return True

    def keep_moving(self, transfer: SessionTransfer, now_s: float) -> None:
        """Request a STATUS (as sender) or repeat it (as receiver) if no message arrives. After too many tries the state
        becomes link_lost."""
        if transfer.session is None:
            return
        if transfer.sender is not None:
            if transfer.sender.silent_requests >= SILENT_TRIES:
                self.lose(transfer, "the device is silent", now_s)
                return
            due = transfer.sender.request_due(now_s)
            if due is not None:
                serial, start = due
                values = {"session": transfer.session, "serial": serial, "from_index": start}
                self.out.append(ServiceMessage("STATUS_REQUEST", transfer.request_id, values))
        elif transfer.receiver is not None and now_s >= transfer.due_s:
            transfer.tries += 1
            if transfer.tries > SILENT_TRIES:
                self.lose(transfer, "the device is silent", now_s)
                return
            self._send_status(transfer, transfer.receiver.status(), now_s)

    def _send_status(self, transfer: SessionTransfer, page: StatusPage, now_s: float) -> None:
        assert transfer.session is not None  # noqa: S101 - callers have checked it
        transfer.due_s = now_s + self._poke_after_s(transfer)
        self.out.append(ServiceMessage("STATUS", transfer.request_id, page.values(transfer.session), page.lists()))

    def _poke_after_s(self, transfer: SessionTransfer) -> float:
        """Return the time without a message after which a receiver repeats its STATUS. Several chunks can arrive in
        this time. It grows with each unsuccessful attempt.
        """
        return max(POKE_S, 4 * self._chunk_time_s(transfer)) * (1 + transfer.tries)

    def _chunk_time_s(self, transfer: SessionTransfer) -> float:
        return (transfer.chunk_bytes + 64) / self.line_bytes_s if self.line_bytes_s else 0.0

    def lose(self, transfer: SessionTransfer, reason: str, now_s: float) -> None:
        """Set the transfer to link_lost; it is reopened after ``RETRY_LOST_S`` or when the line is open again."""
        transfer.due_s = now_s + RETRY_LOST_S
        transfer.session = None
        transfer.to(TransferState.LINK_LOST, reason)

    def ask_verify(self, transfer: SessionTransfer, now_s: float) -> None:
        """Request the read-back, or the commit if the read-back is verified."""
        if transfer.tries >= SILENT_TRIES or transfer.session is None:
            self.lose(transfer, "no answer to the verification", now_s)
            return
        transfer.tries += 1
        transfer.due_s = now_s + VERIFY_AGAIN_S
        self.out.append(
            ServiceMessage(
                "COMMIT" if transfer.committing else "VERIFY", transfer.request_id, {"session": transfer.session}
            )
        )

    def after_the_end(self, transfer: SessionTransfer, service: str, session: int) -> None:
        """Repeat the closing message of a session that has ended on the host but not on the device."""
        if service not in ("CHUNK", "STATUS_REQUEST"):
            return
        if transfer.state is TransferState.VERIFIED:
            self.out.append(ServiceMessage("CLOSE", transfer.request_id, {"session": session}))
        elif transfer.state is TransferState.PAUSED:
            self.out.append(ServiceMessage("PAUSE", transfer.request_id, {"session": session}))
        elif transfer.state in ENDED:
            self.out.append(abort_message(session, transfer.request_id, "aborted"))

    def opened(self, transfer: SessionTransfer, message: Decoded, now_s: float) -> bool:
        """Process OPENED. Returns False and fails the transfer if the upload's size differs or the chunk size is
        invalid."""
        reply = message.values
        session, size, chunk_bytes = int(reply["session"]), int(reply["size_bytes"]), int(reply["chunk_bytes"])
        if chunk_bytes < 1 or (transfer.direction is Direction.UP and size != transfer.size):
            transfer.to(TransferState.FAILED, "the device opened another transfer than requested")
            return False
        window = max(1, int(reply["window_chunks"]))
        complete = transfer.receiver is not None and transfer.receiver.stored.complete
        had_some, resent = transfer.holds_any and not complete, transfer.resent
        transfer.session, transfer.tries, transfer.resumed = session, 0, bool(reply["resumed"])
        transfer.resent_before = resent
        transfer.grid_is_fixed |= chunk_bytes != transfer.wanted_chunk_bytes
        if transfer.direction is Direction.UP:
            transfer.chunk_bytes = chunk_bytes
            transfer.sender = ChunkSender(
                transfer.chunks,
                window,
                request_patience_s(window, chunk_bytes, self.line_bytes_s),
                resumed=transfer.resumed,
            )
        else:
            self._prepare_download(transfer, size, chunk_bytes, window, bytes(reply["sha256"]))  # type: ignore[arg-type]  # bytes fields decode to bytes
            transfer.frame_number = int(reply["frame_number"])
        started_over = had_some and (
            not transfer.resumed if transfer.direction is Direction.UP else not transfer.holds_any
        )
        transfer.to(TransferState.TRANSFERRING, STARTED_OVER[transfer.direction] if started_over else transfer.note)
        if transfer.receiver is not None:
            self._send_status(transfer, transfer.receiver.status(), now_s)
            if transfer.receiver.stored.complete:
                self._check_download(transfer)
        return True

    def _prepare_download(
        self, transfer: SessionTransfer, size: int, chunk_bytes: int, window: int, sha256: bytes
    ) -> None:
        """Prepare the receiver. If the content is unchanged, stored data are kept and mapped to the new chunk size."""
        same = transfer.receiver is not None and (transfer.sha256, transfer.size) == (sha256, size)
        received = regrid(transfer.stored()[0], size, transfer.chunk_bytes, chunk_bytes) if same else []
        if not same:
            transfer.data = bytearray(size)
        transfer.size, transfer.chunk_bytes, transfer.sha256 = size, chunk_bytes, sha256
        transfer.receiver = ChunkReceiver(size, chunk_bytes, window, received)

    def refused(self, transfer: SessionTransfer, session: int, message: Decoded, now_s: float) -> None:
        """Process ABORT_TRANSFER: reopen after no_session or busy, otherwise end the transfer."""
        if transfer.state in ENDED or transfer.state is TransferState.PAUSED:
            return
        if transfer.session is not None and session not in (0, transfer.session):
            return
        reason, detail = str(message.values["reason"]), str(message.values["detail"])
        if reason in ("no_session", "busy"):
            transfer.session = None
            transfer.to(TransferState.LINK_LOST, detail or reason)
            transfer.due_s = now_s + (0.2 if reason == "no_session" else 1.0)
            return
        state = TransferState.ABORTED if reason == "aborted" else TransferState.FAILED
        transfer.to(state, f"{reason}: {detail}" if detail else reason)
        transfer.session = None

    def chunk(self, transfer: SessionTransfer, message: Decoded, now_s: float) -> None:
        """Store a received chunk."""
        assert transfer.receiver is not None  # noqa: S101 - the caller has checked it
        index, data = int(message.values["index"]), bytes(message.values["data"])  # type: ignore[arg-type]  # bytes fields decode to bytes
        transfer.tries = 0
        transfer.due_s = now_s + self._poke_after_s(transfer)
        if transfer.receiver.accept(index, int(message.values["serial"]), len(data)):
            transfer.data[index * transfer.chunk_bytes : index * transfer.chunk_bytes + len(data)] = data
        if transfer.state is TransferState.TRANSFERRING and transfer.receiver.status_due():
            self._send_status(transfer, transfer.receiver.status(), now_s)
        if transfer.receiver.stored.complete:
            self._check_download(transfer)

    def status_requested(self, transfer: SessionTransfer, message: Decoded, now_s: float) -> None:
        """Answer the device's STATUS_REQUEST."""
        if transfer.receiver is None:
            return
        request = message.values
        transfer.tries = 0
        self._send_status(transfer, transfer.receiver.status(int(request["from_index"]), int(request["serial"])), now_s)

    def _check_download(self, transfer: SessionTransfer) -> None:
        if transfer.state is not TransferState.TRANSFERRING or transfer.session is None:
            return
        self.out.append(ServiceMessage("CLOSE", transfer.request_id, {"session": transfer.session}))
        if hashlib.sha256(transfer.data).digest() == transfer.sha256:
            transfer.to(TransferState.VERIFIED)
            self.finish(transfer)
            return
        # The data of an earlier attempt can be corrupt, so a resumed download starts again from the beginning. Without
        # earlier data, the device sent wrong data.
        kept_part, transfer.receiver, transfer.sha256, transfer.session = transfer.resumed, None, NO_HASH, None
        if kept_part:
            transfer.note = "the stored and received data do not match the device's hash: started over"
            transfer.to(TransferState.QUEUED, transfer.note)
        else:
            transfer.to(TransferState.FAILED, "the received data do not match the device's hash")

    def begin_verify(self, transfer: SessionTransfer, now_s: float) -> None:
        """Request the read-back after the device has stored all chunks."""
        transfer.to(TransferState.VERIFYING)
        transfer.tries = 0
        self.ask_verify(transfer, now_s)

    def verified(self, transfer: SessionTransfer, message: Decoded, now_s: float) -> None:
        """Process the result of the device's read-back: request the commit, or fail."""
        if not message.values["equal"] or message.values["sha256"] != transfer.sha256:
            transfer.to(TransferState.FAILED, "the data that the device read back differ from the sent data")
            transfer.session = None
            return
        transfer.committing, transfer.tries = True, 0
        self.ask_verify(transfer, now_s)

    def finish(self, transfer: SessionTransfer) -> None:
        """Report the transfer as done."""
        transfer.session = None
        done = TransferDone(
            transfer.id,
            transfer.direction,
            transfer.kind,
            transfer.target,
            transfer.frame_number,
            bytes(transfer.data),
            transfer.sha256.hex(),
        )
        self.done.append(done)
