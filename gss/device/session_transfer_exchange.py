"""Message exchange of one transfer on the host: open, transfer, check, verify, commit, close."""

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
    Direction.UP: "the device no longer holds what it had: started over",
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

    def begin_open(self, t: SessionTransfer, now_s: float, take_request_id: RequestIds) -> None:
        """Open the transfer with a new request id."""
        t.request_id = take_request_id()
        t.session, t.tries, t.committing = None, 0, False
        t.to(TransferState.OPENING)
        self.open_again(t, now_s)

    def open_again(self, t: SessionTransfer, now_s: float) -> None:
        """Send the opening message, again until it is answered or the tries are used up (link_lost)."""
        if t.tries >= SILENT_TRIES:
            self.lose(t, "no answer to the opening", now_s)
            return
        t.tries += 1
        t.due_s = now_s + (OPEN_AGAIN_S + 2 * self._chunk_time_s(t)) * t.tries
        values: dict[str, Value] = {"kind": t.kind, "target": t.target, "chunk_bytes": t.wanted_chunk_bytes}
        if t.direction is Direction.DOWN:
            p = t.part
            values["held_sha256"] = t.sha256
            values |= {"col_px": p.col_px, "row_px": p.row_px, "columns": p.columns, "rows": p.rows}
            self.out.append(ServiceMessage("OPEN_DOWNLOAD", t.request_id, values))
            return
        c = t.compatibility
        values |= {"size_bytes": t.size, "sha256": t.sha256, "device_model": c.device_model, "profile": c.profile}
        values |= {"dictionary_hash": c.dictionary_hash, "format_version": c.format_version}
        values |= {"epoch_jyear": c.epoch_jyear, "stars": c.stars, "pairs": c.pairs}
        self.out.append(ServiceMessage("OPEN_UPLOAD", t.request_id, values))

    def adapt(self, t: SessionTransfer, now_s: float, take_request_id: RequestIds) -> bool:
        """Reopen with smaller chunks if losses are high; stored data is kept. Returns True if reopened."""
        smaller = t.smaller_chunks()
        if smaller is None or t.session is None:
            return False
        self.out.append(ServiceMessage("PAUSE", t.request_id, {"session": t.session}))
        t.wanted_chunk_bytes, t.note = smaller, f"the line is noisy: chunks of {smaller} B"
        self.begin_open(t, now_s, take_request_id)
        return True

    def keep_moving(self, t: SessionTransfer, now_s: float) -> None:
        """Request a STATUS as sender, or repeat it as receiver, when nothing arrives; link_lost after too many tries."""
        if t.session is None:
            return
        if t.sender is not None:
            if t.sender.silent_requests >= SILENT_TRIES:
                self.lose(t, "the device is silent", now_s)
                return
            due = t.sender.request_due(now_s)
            if due is not None:
                serial, start = due
                values = {"session": t.session, "serial": serial, "from_index": start}
                self.out.append(ServiceMessage("STATUS_REQUEST", t.request_id, values))
        elif t.receiver is not None and now_s >= t.due_s:
            t.tries += 1
            if t.tries > SILENT_TRIES:
                self.lose(t, "the device is silent", now_s)
                return
            self._send_status(t, t.receiver.status(), now_s)

    def _send_status(self, t: SessionTransfer, page: StatusPage, now_s: float) -> None:
        assert t.session is not None  # noqa: S101 - callers have checked it
        t.due_s = now_s + self._poke_after_s(t)
        self.out.append(ServiceMessage("STATUS", t.request_id, page.values(t.session), page.lists()))

    def _poke_after_s(self, t: SessionTransfer) -> float:
        """Return the silence after which a receiver repeats its STATUS.

        Several chunks should have arrived in that time; it grows with each unsuccessful try.
        """
        return max(POKE_S, 4 * self._chunk_time_s(t)) * (1 + t.tries)

    def _chunk_time_s(self, t: SessionTransfer) -> float:
        return (t.chunk_bytes + 64) / self.line_bytes_s if self.line_bytes_s else 0.0

    def lose(self, t: SessionTransfer, reason: str, now_s: float) -> None:
        """Set the transfer to link_lost; it is reopened after ``RETRY_LOST_S`` or when the line is back."""
        t.due_s = now_s + RETRY_LOST_S
        t.session = None
        t.to(TransferState.LINK_LOST, reason)

    def ask_verify(self, t: SessionTransfer, now_s: float) -> None:
        """Request the read-back, or the commit once the read-back is verified."""
        if t.tries >= SILENT_TRIES or t.session is None:
            self.lose(t, "no answer to the verification", now_s)
            return
        t.tries += 1
        t.due_s = now_s + VERIFY_AGAIN_S
        self.out.append(ServiceMessage("COMMIT" if t.committing else "VERIFY", t.request_id, {"session": t.session}))

    def after_the_end(self, t: SessionTransfer, service: str, session: int) -> None:
        """Repeat the closing message of a session that has ended here but not on the device."""
        if service not in ("CHUNK", "STATUS_REQUEST"):
            return
        if t.state is TransferState.VERIFIED:
            self.out.append(ServiceMessage("CLOSE", t.request_id, {"session": session}))
        elif t.state is TransferState.PAUSED:
            self.out.append(ServiceMessage("PAUSE", t.request_id, {"session": session}))
        elif t.state in ENDED:
            self.out.append(abort_message(session, t.request_id, "aborted"))

    def opened(self, t: SessionTransfer, message: Decoded, now_s: float) -> bool:
        """Process OPENED. Returns False, with the transfer failed, if the upload's size differs or the chunk size is invalid."""
        v = message.values
        session, size, chunk_bytes = int(v["session"]), int(v["size_bytes"]), int(v["chunk_bytes"])
        if chunk_bytes < 1 or (t.direction is Direction.UP and size != t.size):
            t.to(TransferState.FAILED, "the device opened another transfer than requested")
            return False
        window = max(1, int(v["window_chunks"]))
        complete = t.receiver is not None and t.receiver.stored.complete
        had_some, resent = t.holds_any and not complete, t.resent
        t.session, t.tries, t.resumed = session, 0, bool(v["resumed"])
        t.resent_before = resent
        t.grid_is_fixed |= chunk_bytes != t.wanted_chunk_bytes
        if t.direction is Direction.UP:
            t.chunk_bytes = chunk_bytes
            t.sender = ChunkSender(
                t.chunks, window, request_patience_s(window, chunk_bytes, self.line_bytes_s), resumed=t.resumed
            )
        else:
            self._prepare_download(t, size, chunk_bytes, window, bytes(v["sha256"]))  # type: ignore[arg-type]  # bytes fields decode to bytes
            t.frame_number = int(v["frame_number"])
        started_over = had_some and (not t.resumed if t.direction is Direction.UP else not t.holds_any)
        t.to(TransferState.TRANSFERRING, STARTED_OVER[t.direction] if started_over else t.note)
        if t.receiver is not None:
            self._send_status(t, t.receiver.status(), now_s)
            if t.receiver.stored.complete:
                self._check_download(t)
        return True

    def _prepare_download(self, t: SessionTransfer, size: int, chunk_bytes: int, window: int, sha256: bytes) -> None:
        """Keep stored data if the content is unchanged, mapping it to the new chunk size."""
        same = t.receiver is not None and (t.sha256, t.size) == (sha256, size)
        received = regrid(t.stored()[0], size, t.chunk_bytes, chunk_bytes) if same else []
        if not same:
            t.data = bytearray(size)
        t.size, t.chunk_bytes, t.sha256 = size, chunk_bytes, sha256
        t.receiver = ChunkReceiver(size, chunk_bytes, window, received)

    def refused(self, t: SessionTransfer, session: int, message: Decoded, now_s: float) -> None:
        """Process ABORT_TRANSFER: reopen after no_session or busy, otherwise end the transfer."""
        if t.state in ENDED or t.state is TransferState.PAUSED:
            return
        if t.session is not None and session not in (0, t.session):
            return
        reason, detail = str(message.values["reason"]), str(message.values["detail"])
        if reason in ("no_session", "busy"):
            t.session = None
            t.to(TransferState.LINK_LOST, detail or reason)
            t.due_s = now_s + (0.2 if reason == "no_session" else 1.0)
            return
        state = TransferState.ABORTED if reason == "aborted" else TransferState.FAILED
        t.to(state, f"{reason}: {detail}" if detail else reason)
        t.session = None

    def chunk(self, t: SessionTransfer, message: Decoded, now_s: float) -> None:
        """Store a received chunk."""
        assert t.receiver is not None  # noqa: S101 - the caller has checked it
        index, data = int(message.values["index"]), bytes(message.values["data"])  # type: ignore[arg-type]  # bytes fields decode to bytes
        t.tries = 0
        t.due_s = now_s + self._poke_after_s(t)
        if t.receiver.accept(index, int(message.values["serial"]), len(data)):
            t.data[index * t.chunk_bytes : index * t.chunk_bytes + len(data)] = data
        if t.state is TransferState.TRANSFERRING and t.receiver.status_due():
            self._send_status(t, t.receiver.status(), now_s)
        if t.receiver.stored.complete:
            self._check_download(t)

    def status_requested(self, t: SessionTransfer, message: Decoded, now_s: float) -> None:
        """Answer the device's STATUS_REQUEST."""
        if t.receiver is None:
            return
        v = message.values
        t.tries = 0
        self._send_status(t, t.receiver.status(int(v["from_index"]), int(v["serial"])), now_s)

    def _check_download(self, t: SessionTransfer) -> None:
        if t.state is not TransferState.TRANSFERRING or t.session is None:
            return
        self.out.append(ServiceMessage("CLOSE", t.request_id, {"session": t.session}))
        if hashlib.sha256(t.data).digest() == t.sha256:
            t.to(TransferState.VERIFIED)
            self.finish(t)
            return
        # A kept part may be corrupt, so a resumed download starts over; otherwise the device sent wrong data.
        kept_part, t.receiver, t.sha256, t.session = t.resumed, None, NO_HASH, None
        if kept_part:
            t.note = "the stored and received data do not match the device's hash: started over"
            t.to(TransferState.QUEUED, t.note)
        else:
            t.to(TransferState.FAILED, "the received data do not match the device's hash")

    def to_verify(self, t: SessionTransfer, now_s: float) -> None:
        """Request the read-back after the device has stored everything."""
        t.to(TransferState.VERIFYING)
        t.tries = 0
        self.ask_verify(t, now_s)

    def verified(self, t: SessionTransfer, message: Decoded, now_s: float) -> None:
        """Process the result of the device's read-back: request the commit, or fail."""
        if not message.values["equal"] or message.values["sha256"] != t.sha256:
            t.to(TransferState.FAILED, "the device read back other data than were sent")
            t.session = None
            return
        t.committing, t.tries = True, 0
        self.ask_verify(t, now_s)

    def finish(self, t: SessionTransfer) -> None:
        """Report the transfer as done."""
        t.session = None
        done = TransferDone(t.id, t.direction, t.kind, t.target, t.frame_number, bytes(t.data), t.sha256.hex())
        self.done.append(done)
