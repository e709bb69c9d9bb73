"""The transfers of a host session: one at a time on the line, any number waiting. Decides messages; writes no bytes."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from gss.device.dictionary import Value
from gss.device.protocol.codec import Decoded
from gss.device.protocol.transfer import ChunkReceiver, ChunkSender, Compatibility, StatusPage, chunk_count
from gss.device.session_events import Direction, Ranges, TransferDone, TransferState, TransferUpdate
from gss.domain.errors import Conflict, NotFound

OPEN_AGAIN_S = 1.0
VERIFY_AGAIN_S = 2.5
POKE_S = 1.0
SILENT_TRIES = 6
RETRY_LOST_S = 4.0
REPORT_EVERY_S = 0.25
RATE_SPAN_S = 4.0
ENDED = (
    TransferState.VERIFIED,
    TransferState.COMMITTED,
    TransferState.ACTIVE,
    TransferState.FAILED,
    TransferState.ABORTED,
)
MOVING = (TransferState.OPENING, TransferState.TRANSFERRING, TransferState.VERIFYING, TransferState.LINK_LOST)
NO_HASH = bytes(32)


@dataclass(frozen=True)
class Message:
    """A service message to send."""

    service: str
    request_id: int
    values: Mapping[str, Value]
    lists: Mapping[str, list[Mapping[str, Value]]] = field(default_factory=dict)


@dataclass
class Transfer:
    """One transfer under way."""

    id: int
    direction: Direction
    kind: str
    target: int
    chunk_bytes: int
    compatibility: Compatibility
    data: bytearray
    size: int = 0
    sha256: bytes = NO_HASH
    state: TransferState = TransferState.QUEUED
    reason: str = ""
    request_id: int = 0
    session: int | None = None
    sender: ChunkSender | None = None
    receiver: ChunkReceiver | None = None
    due_s: float = 0.0
    tries: int = 0
    resent_before: int = 0
    frame_number: int = 0
    resumed: bool = False
    committing: bool = False
    history: deque[tuple[float, int]] = field(default_factory=deque)
    reported_s: float = -1e9
    changed: bool = True

    @property
    def chunks(self) -> int:
        """Number of chunks, 0 until the size is known."""
        return chunk_count(self.size, self.chunk_bytes) if self.size else 0

    def stored(self) -> tuple[Ranges, int]:
        """What the receiving side holds: ranges and bytes."""
        held = self.sender.stored if self.sender else self.receiver.held if self.receiver else None
        if held is None:
            return (), 0
        return held.ranges()[0], held.stored_bytes(self.size, self.chunk_bytes)

    @property
    def resent(self) -> int:
        """Chunks that went over the line more than once."""
        now = self.sender.resent if self.sender else self.receiver.repeated if self.receiver else 0
        return self.resent_before + now

    def to(self, state: TransferState, reason: str = "") -> None:
        """Go to a state; the next poll tells."""
        self.state, self.reason, self.changed = state, reason, True


class TransferDesk:
    """All transfers. Each opening takes a fresh request id, which names the transfer on the line."""

    def __init__(self) -> None:
        self._transfers: dict[int, Transfer] = {}
        self._by_session: dict[int, int] = {}
        self._out: deque[Message] = deque()
        self._done: list[TransferDone] = []
        self.line_bytes_s: float | None = None
        self.line_is_up = False

    # --- orders of the owner ------------------------------------------------------------------------------------

    def add(self, transfer: Transfer) -> None:
        """Queue a transfer."""
        self._transfers[transfer.id] = transfer

    def get(self, transfer_id: int) -> Transfer:
        """The transfer of that id; NotFound otherwise."""
        try:
            return self._transfers[transfer_id]
        except KeyError:
            raise NotFound("unknown transfer", got=str(transfer_id)) from None

    def pause(self, transfer_id: int) -> None:
        """Stop; the device keeps what it has."""
        transfer = self.get(transfer_id)
        if transfer.state in ENDED or transfer.state in (TransferState.PAUSED, TransferState.VERIFYING):
            raise Conflict(
                "the transfer cannot be paused now", expected="queued or transferring", got=transfer.state.value
            )
        if transfer.session is not None:
            self._out.append(Message("PAUSE", transfer.request_id, {"session": transfer.session}))
        transfer.to(TransferState.PAUSED)

    def resume(self, transfer_id: int) -> None:
        """Wait for the line and open again."""
        transfer = self.get(transfer_id)
        if transfer.state not in (TransferState.PAUSED, TransferState.LINK_LOST, TransferState.FAILED):
            raise Conflict(
                "the transfer cannot be resumed", expected="paused, link_lost or failed", got=transfer.state.value
            )
        transfer.to(TransferState.QUEUED)

    def abort(self, transfer_id: int) -> None:
        """Give up on both sides."""
        transfer = self.get(transfer_id)
        if transfer.state in ENDED:
            raise Conflict("the transfer has ended", got=transfer.state.value)
        if transfer.session is not None:
            self._out.append(self._abort_message(transfer.session, transfer.request_id, "aborted"))
        transfer.to(TransferState.ABORTED, "by the operator")

    @staticmethod
    def _abort_message(session: int, request_id: int, reason: str) -> Message:
        return Message("ABORT_TRANSFER", request_id, {"session": session, "reason": reason, "detail": ""})

    def forget(self, transfer_id: int) -> None:
        """Drop an ended transfer."""
        if self.get(transfer_id).state not in ENDED:
            raise Conflict("the transfer has not ended", got=self.get(transfer_id).state.value)
        del self._transfers[transfer_id]
        self._by_session = {s: t for s, t in self._by_session.items() if t != transfer_id}

    def lose_line(self) -> None:
        """The port is gone."""
        self.line_is_up = False
        self._out.clear()
        for transfer in self._transfers.values():
            if transfer.state in MOVING:
                self._lose(transfer, "the line is gone", 0.0)

    def line_back(self, now_s: float) -> None:
        """The device has introduced itself: open again what the loss of the line interrupted."""
        self.line_is_up = True
        for transfer in self._transfers.values():
            if transfer.state is TransferState.LINK_LOST:
                transfer.due_s = now_s

    def device_restarted(self, now_s: float) -> None:
        """The device lost its sessions; what it had stored is still there."""
        for transfer in self._transfers.values():
            if transfer.state in MOVING and transfer.request_id:
                self._lose(transfer, "the device restarted", now_s)
                transfer.due_s = now_s

    def bank_in_use(self, bank: int) -> None:
        """A committed upload became the active catalogue."""
        for transfer in self._transfers.values():
            if transfer.state is TransferState.COMMITTED and (transfer.kind, transfer.target) == ("catalogue", bank):
                transfer.to(TransferState.ACTIVE)

    # --- time ---------------------------------------------------------------------------------------------------

    def current(self) -> Transfer | None:
        """The transfer that has the line."""
        return next((t for t in self._transfers.values() if t.state in MOVING), None)

    def step(self, now_s: float, take_request_id: RequestIds) -> list[Message]:
        """Messages (not chunks) to send now."""
        if not self.line_is_up:
            return []
        transfer = self.current()
        if transfer is None:
            transfer = next((t for t in self._transfers.values() if t.state is TransferState.QUEUED), None)
            if transfer is not None:
                self._begin_open(transfer, now_s, take_request_id)
        elif transfer.state is TransferState.LINK_LOST and now_s >= transfer.due_s:
            self._begin_open(transfer, now_s, take_request_id)
        elif transfer.state is TransferState.OPENING and now_s >= transfer.due_s:
            self._open_again(transfer, now_s)
        elif transfer.state is TransferState.TRANSFERRING:
            self._keep_moving(transfer, now_s)
        elif transfer.state is TransferState.VERIFYING and now_s >= transfer.due_s:
            self._ask_verify(transfer, now_s)
        messages = list(self._out)
        self._out.clear()
        return messages

    def next_chunk(self, now_s: float) -> Message | None:
        """The next chunk to send, if a transfer wants to send one."""
        t = self.current()
        if t is None or t.state is not TransferState.TRANSFERRING or t.sender is None or t.session is None:
            return None
        choice = t.sender.next_chunk(now_s)
        if choice is None:
            return None
        index, serial = choice
        data = bytes(t.data[index * t.chunk_bytes : (index + 1) * t.chunk_bytes])
        return Message("CHUNK", t.request_id, {"session": t.session, "index": index, "serial": serial, "data": data})

    def _begin_open(self, t: Transfer, now_s: float, take_request_id: RequestIds) -> None:
        t.request_id = take_request_id()
        t.resent_before = t.resent
        t.session, t.tries, t.committing = None, 0, False
        t.to(TransferState.OPENING)
        self._open_again(t, now_s)

    def _open_again(self, t: Transfer, now_s: float) -> None:
        if t.tries >= SILENT_TRIES:
            self._lose(t, "no answer to the opening", now_s)
            return
        t.tries += 1
        t.due_s = now_s + OPEN_AGAIN_S * t.tries
        values: dict[str, Value] = {"kind": t.kind, "target": t.target, "chunk_bytes": t.chunk_bytes}
        if t.direction is Direction.DOWN:
            values["held_sha256"] = t.sha256
            self._out.append(Message("OPEN_DOWNLOAD", t.request_id, values))
            return
        c = t.compatibility
        values |= {"size_bytes": t.size, "sha256": t.sha256, "device_model": c.device_model, "profile": c.profile}
        values |= {"dictionary_hash": c.dictionary_hash, "format_version": c.format_version}
        values |= {"epoch_jyear": c.epoch_jyear, "stars": c.stars, "pairs": c.pairs}
        self._out.append(Message("OPEN_UPLOAD", t.request_id, values))

    def _keep_moving(self, t: Transfer, now_s: float) -> None:
        """A sender asks when it hears nothing; a receiver reports, and pokes when nothing comes."""
        if t.session is None:
            return
        if t.sender is not None:
            if t.sender.silent_requests >= SILENT_TRIES:
                self._lose(t, "the device is silent", now_s)
                return
            due = t.sender.request_due(now_s)
            if due is not None:
                serial, start = due
                values = {"session": t.session, "serial": serial, "from_index": start}
                self._out.append(Message("STATUS_REQUEST", t.request_id, values))
        elif t.receiver is not None and now_s >= t.due_s:
            t.tries += 1
            if t.tries > SILENT_TRIES:
                self._lose(t, "the device is silent", now_s)
                return
            self._send_status(t, t.receiver.status(), now_s)

    def _send_status(self, t: Transfer, page: StatusPage, now_s: float) -> None:
        assert t.session is not None  # noqa: S101 - callers have checked it
        t.due_s = now_s + max(POKE_S, 4 * self._chunk_time_s(t))
        self._out.append(Message("STATUS", t.request_id, page.values(t.session), page.lists()))

    def _chunk_time_s(self, t: Transfer) -> float:
        return (t.chunk_bytes + 64) / self.line_bytes_s if self.line_bytes_s else 0.0

    def _lose(self, t: Transfer, reason: str, now_s: float) -> None:
        t.due_s = now_s + RETRY_LOST_S
        t.session = None
        t.to(TransferState.LINK_LOST, reason)

    def _ask_verify(self, t: Transfer, now_s: float) -> None:
        if t.tries >= SILENT_TRIES or t.session is None:
            self._lose(t, "no answer to the verification", now_s)
            return
        t.tries += 1
        t.due_s = now_s + VERIFY_AGAIN_S
        self._out.append(Message("COMMIT" if t.committing else "VERIFY", t.request_id, {"session": t.session}))

    # --- messages of the device ---------------------------------------------------------------------------------

    def receive(self, service: str, request_id: int, message: Decoded, now_s: float) -> None:
        """Act on a transfer message; one for no known transfer is ignored."""
        if service == "OPENED":
            self._opened(request_id, message, now_s)
            return
        session = int(message.values["session"])
        if service == "ABORT_TRANSFER":
            self._refused(request_id, session, message, now_s)
            return
        t = self._transfers.get(self._by_session.get(session, -1))
        if t is None:
            return
        if t.session != session:
            self._after_the_end(t, service, session)
        elif service == "STATUS" and t.sender is not None and t.state is TransferState.TRANSFERRING:
            t.sender.on_status(StatusPage.of(message), now_s)
            t.tries = 0
            if t.sender.complete:
                self._to_verify(t, now_s)
        elif service == "CHUNK" and t.receiver is not None:
            self._chunk(t, message, now_s)
        elif service == "STATUS_REQUEST":
            self._asked(t, message, now_s)
        elif service == "VERIFIED" and t.state is TransferState.VERIFYING:
            self._verified(t, message, now_s)
        elif service == "COMMITTED" and t.state is TransferState.VERIFYING:
            t.to(TransferState.COMMITTED)
            self._finish(t)

    def _after_the_end(self, t: Transfer, service: str, session: int) -> None:
        """The device did not hear the last word of a session that is over here."""
        if service not in ("CHUNK", "STATUS_REQUEST"):
            return
        if t.state is TransferState.VERIFIED:
            self._out.append(Message("CLOSE", t.request_id, {"session": session}))
        elif t.state is TransferState.PAUSED:
            self._out.append(Message("PAUSE", t.request_id, {"session": session}))
        elif t.state in ENDED:
            self._out.append(self._abort_message(session, t.request_id, "aborted"))

    def _opened(self, request_id: int, message: Decoded, now_s: float) -> None:
        t = next((t for t in self._transfers.values() if t.request_id == request_id), None)
        if t is None or t.state is not TransferState.OPENING:
            return
        v = message.values
        session, size, chunk_bytes = int(v["session"]), int(v["size_bytes"]), int(v["chunk_bytes"])
        if chunk_bytes < 1 or (t.direction is Direction.UP and size != t.size):
            t.to(TransferState.FAILED, "the device opened another transfer than asked for")
            return
        window = max(1, int(v["window_chunks"]))
        t.session, t.tries, t.resumed = session, 0, bool(v["resumed"])
        self._by_session[session] = t.id
        if t.direction is Direction.UP:
            t.chunk_bytes = chunk_bytes
            patience_s = 0.5 + (window // 4 + 2) * self._chunk_time_s(t)
            t.sender = ChunkSender(t.chunks, window, patience_s, resumed=t.resumed)
        else:
            self._prepare_download(t, size, chunk_bytes, window, bytes(v["sha256"]))  # type: ignore[arg-type]
            t.frame_number = int(v["frame_number"])
        t.to(TransferState.TRANSFERRING)
        if t.receiver is not None:
            self._send_status(t, t.receiver.status(), now_s)
            if t.receiver.held.complete:
                self._check_download(t)

    def _prepare_download(self, t: Transfer, size: int, chunk_bytes: int, window: int, sha256: bytes) -> None:
        """Keep what is held if it is a part of the same content in the same chunks."""
        same = t.receiver is not None and (t.sha256, t.size, t.chunk_bytes) == (sha256, size, chunk_bytes)
        held = [i for first, last in t.stored()[0] for i in range(first, last + 1)] if same else []
        if not same:
            t.data = bytearray(size)
        t.size, t.chunk_bytes, t.sha256 = size, chunk_bytes, sha256
        t.receiver = ChunkReceiver(size, chunk_bytes, window, held)

    def _refused(self, request_id: int, session: int, message: Decoded, now_s: float) -> None:
        t = next((t for t in self._transfers.values() if t.request_id == request_id), None)
        if t is None or t.state in ENDED or t.state is TransferState.PAUSED:
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

    def _chunk(self, t: Transfer, message: Decoded, now_s: float) -> None:
        assert t.receiver is not None  # noqa: S101 - the caller has checked it
        index, data = int(message.values["index"]), bytes(message.values["data"])  # type: ignore[arg-type]
        t.tries = 0
        t.due_s = now_s + max(POKE_S, 4 * self._chunk_time_s(t))
        if t.receiver.accept(index, int(message.values["serial"]), len(data)):
            t.data[index * t.chunk_bytes : index * t.chunk_bytes + len(data)] = data
        if t.state is TransferState.TRANSFERRING and t.receiver.status_due():
            self._send_status(t, t.receiver.status(), now_s)
        if t.receiver.held.complete:
            self._check_download(t)

    def _asked(self, t: Transfer, message: Decoded, now_s: float) -> None:
        if t.receiver is None:
            return
        v = message.values
        t.tries = 0
        self._send_status(t, t.receiver.status(int(v["from_index"]), int(v["serial"])), now_s)

    def _check_download(self, t: Transfer) -> None:
        if t.state is not TransferState.TRANSFERRING or t.session is None:
            return
        self._out.append(Message("CLOSE", t.request_id, {"session": t.session}))
        if hashlib.sha256(t.data).digest() != t.sha256:
            t.to(TransferState.FAILED, "the hash of what arrived is not the device's")
            t.receiver = None
        else:
            t.to(TransferState.VERIFIED)
            self._finish(t)

    def _to_verify(self, t: Transfer, now_s: float) -> None:
        t.to(TransferState.VERIFYING)
        t.tries = 0
        self._ask_verify(t, now_s)

    def _verified(self, t: Transfer, message: Decoded, now_s: float) -> None:
        if not message.values["equal"] or message.values["sha256"] != t.sha256:
            t.to(TransferState.FAILED, "the device read back something else than was sent")
            t.session = None
            return
        t.committing, t.tries = True, 0
        self._ask_verify(t, now_s)

    def _finish(self, t: Transfer) -> None:
        t.session = None
        done = TransferDone(t.id, t.direction, t.kind, t.target, t.frame_number, bytes(t.data), t.sha256.hex())
        self._done.append(done)

    # --- what to tell -------------------------------------------------------------------------------------------

    def news(self, now_s: float) -> list[TransferUpdate | TransferDone]:
        """Updates since the last call: each change of state, progress a few times a second."""
        events: list[TransferUpdate | TransferDone] = []
        for t in self._transfers.values():
            progressing = t.state is TransferState.TRANSFERRING and now_s - t.reported_s >= REPORT_EVERY_S
            if t.changed or progressing:
                events.append(self.update(t, now_s))
                t.changed, t.reported_s = False, now_s
        events += self._done
        self._done = []
        return events

    def update(self, t: Transfer, now_s: float) -> TransferUpdate:
        """A transfer as it stands."""
        ranges, stored_bytes = t.stored()
        rate = self._rate_bytes_s(t, stored_bytes, now_s)
        return TransferUpdate(
            transfer_id=t.id,
            direction=t.direction,
            kind=t.kind,
            target=t.target,
            state=t.state,
            reason=t.reason,
            size=t.size,
            chunk_size=t.chunk_bytes,
            chunks=t.chunks,
            stored=ranges,
            stored_bytes=stored_bytes,
            in_flight=t.sender.in_flight if t.sender else 0,
            resent=t.resent,
            rate_bytes_s=rate,
            line_share=rate / self.line_bytes_s if self.line_bytes_s else None,
            left_s=(t.size - stored_bytes) / rate if rate > 0 else None,
            sha256=t.sha256.hex() if t.sha256 != NO_HASH else "",
            frame_number=t.frame_number,
            resumed=t.resumed,
        )

    @staticmethod
    def _rate_bytes_s(t: Transfer, stored_bytes: int, now_s: float) -> float:
        if t.state is not TransferState.TRANSFERRING:
            t.history.clear()
            return 0.0
        t.history.append((now_s, stored_bytes))
        while now_s - t.history[0][0] > RATE_SPAN_S:
            t.history.popleft()
        first_s, first_bytes = t.history[0]
        return (stored_bytes - first_bytes) / (now_s - first_s) if now_s > first_s else 0.0


class RequestIds:
    """Hands out request ids; 0 means unsolicited and is left out."""

    def __init__(self, following: int) -> None:
        self.following = following

    def __call__(self) -> int:
        taken = self.following
        self.following = taken % 0xFFFF_FFFF + 1
        return taken
