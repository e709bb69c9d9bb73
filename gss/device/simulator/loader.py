"""Device side of the transfer protocol: sessions, flash writing, read-back, commit and downloads."""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from gss.device.protocol.codec import Decoded
from gss.device.protocol.transfer import StatusPage
from gss.device.simulator.bank_writer import BankWriter
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.memory import FlashError, Memory
from gss.device.simulator.openings import Openings
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.sessions import WINDOW_CHUNKS, Outgoing, Session
from gss.instruments.dictionary.definitions import Dictionary, Value

SESSION_TIMEOUT_S = 15.0
MAX_SILENT_REQUESTS = 8
NO_SESSION_EVERY_S = 0.5
MAX_SESSIONS = 8


class Loader:
    """Manages all transfers of the device.

    ``pending_events``: events for the device to send, as (name, text). ``device_time``: converts line time to device
    time.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        memory: Memory,
        tracker: StarTracker,
        bytes_per_s: float,
        device_time: Callable[[float], float],
        image_memory: Callable[[], bool],
    ) -> None:
        self._memory, self._tracker = memory, tracker
        self._writer = BankWriter(dictionary, memory, tracker.profile)
        self.openings = Openings(memory, tracker, self._writer, bytes_per_s, image_memory)
        self._sessions: dict[int, Session] = {}
        self._outgoing: deque[Outgoing] = deque()
        self._next_sender = 0
        self._unknown_reported_s: dict[int, float] = {}
        self.pending_events: list[tuple[str, str]] = []
        self._device_time = device_time

    @property
    def open_sessions(self) -> int:
        """Number of unfinished sessions."""
        return sum(not s.committed for s in self._sessions.values())

    def restart(self) -> None:
        """Restart after a reset: sessions and partial images are lost; partial uploads in flash stay suspended."""
        self._sessions.clear()
        self.openings.parts.clear()
        self._outgoing.clear()

    def take_messages(self) -> list[Outgoing]:
        """Return and remove the messages to send now."""
        messages = list(self._outgoing)
        self._outgoing.clear()
        return messages

    def abort_all(self) -> int:
        """Abort every open session and notify the ground (ABORT). Returns the number of aborted sessions."""
        open_now = [s for s in self._sessions.values() if not s.committed]
        for session in open_now:
            self._abort(session.id, session.request_id, "aborted", "stopped by ABORT")
            del self._sessions[session.id]
        return len(open_now)

    def busy_with(self, area: str) -> bool:
        """True if an open upload writes to this area."""
        return any(s.receiver and s.area == area and not s.committed for s in self._sessions.values())

    @contextmanager
    def reserved(self, area: str) -> Iterator[None]:
        """Reject uploads to this area while a command erases it or reads it back."""
        self.openings.reserved.add(area)
        try:
            yield
        finally:
            self.openings.reserved.discard(area)

    def drop_images(self) -> None:
        """Abort image transfers in both directions after the image memory has lost power."""
        self.openings.parts.clear()
        for session in list(self._sessions.values()):
            if not session.committed and not session.area and (session.receiver or session.frame_number):
                self._abort(session.id, session.request_id, "powered_off", "the image memory lost power")
                del self._sessions[session.id]

    # --- messages -----------------------------------------------------------------------------------------------

    def receive(self, service: str, request_id: int, message: Decoded, now_s: float) -> None:
        """Process a transfer message from the ground."""
        if service in ("OPEN_UPLOAD", "OPEN_DOWNLOAD"):
            self._open(service, request_id, message.values, now_s)
            return
        session = self._sessions.get(int(message.values["session"]))
        if session is None:
            self._no_session(int(message.values["session"]), request_id, now_s)
            return
        session.received_s = now_s
        if service == "CHUNK" and session.receiver:
            self._chunk(session, message.values)
        elif service == "STATUS_REQUEST" and session.receiver:
            page = session.receiver.status(int(message.values["from_index"]), int(message.values["serial"]))
            self._status(session, page)
        elif service == "STATUS" and session.sender:
            session.sender.on_status(StatusPage.of(message), now_s)
        elif service == "VERIFY" and session.receiver:
            self._verify(session)
        elif service == "COMMIT" and session.receiver:
            self._commit(session, now_s)
        elif service in ("CLOSE", "PAUSE", "ABORT_TRANSFER"):
            self._end(session, service)

    def reject(self, request_id: int, reason: str, detail: str) -> None:
        """Reject a request to open a transfer."""
        self._abort(0, request_id, reason, detail)

    def _no_session(self, session_id: int, request_id: int, now_s: float) -> None:
        """Report an unknown session. The rate of reports is limited, because the ground can send a window of chunks
        before it receives the first report."""
        if now_s - self._unknown_reported_s.get(session_id, -1e9) >= NO_SESSION_EVERY_S:
            self._unknown_reported_s = {session_id: now_s}
            self._abort(session_id, request_id, "no_session", "this session is not open")

    def _abort(self, session_id: int, request_id: int, reason: str, detail: str) -> None:
        values: dict[str, Value] = {"session": session_id, "reason": reason, "detail": detail[:120]}
        self._outgoing.append(Outgoing("ABORT_TRANSFER", request_id, values))

    def _open(self, service: str, request_id: int, values: Mapping[str, Value], now_s: float) -> None:
        session = next((s for s in self._sessions.values() if s.request_id == request_id), None)
        if session is None:
            try:
                make = self.openings.upload if service == "OPEN_UPLOAD" else self.openings.download
                session = make(request_id, values, now_s)
            except Rejection as rejection:
                self.reject(request_id, rejection.reason, rejection.detail)
                return
            self._supersede(session)
            self._sessions[session.id] = session
            self._forget_oldest()
        session.received_s = now_s
        self._outgoing.append(
            Outgoing(
                "OPENED",
                request_id,
                {
                    "session": session.id,
                    "window_chunks": WINDOW_CHUNKS,
                    "chunk_bytes": session.chunk_bytes,
                    "size_bytes": session.size,
                    "sha256": session.sha256,
                    "frame_number": session.frame_number,
                    "resumed": session.resumed,
                },
            )
        )

    def _supersede(self, new: Session) -> None:
        """Close older uploads to the same target, so that only the latest one writes to it."""
        for old in list(self._sessions.values()):
            same = old.area == new.area if new.area else (old.kind, old.target) == (new.kind, new.target)
            if new.receiver and old.receiver and same and (new.area or not old.committed):
                del self._sessions[old.id]

    def _forget_oldest(self) -> None:
        for session_id in sorted(self._sessions)[:-MAX_SESSIONS]:
            del self._sessions[session_id]

    # --- uploads ------------------------------------------------------------------------------------------------

    def _chunk(self, session: Session, values: Mapping[str, Value]) -> None:
        receiver = session.receiver
        assert receiver is not None  # noqa: S101 - the caller has checked it
        index, data = int(values["index"]), bytes(values["data"])  # type: ignore[arg-type]  # bytes decode to bytes
        if receiver.accept(index, int(values["serial"]), len(data)) and not session.committed:
            at = index * session.chunk_bytes
            if not session.area:
                session.data[at : at + len(data)] = data
            else:
                try:
                    self._writer.program(session, at, data)
                except FlashError as error:
                    self._fail_flash(session, "flash_error", str(error))
                    return
        if receiver.status_due():
            self._status(session, receiver.status())

    def _fail_flash(self, session: Session, reason: str, detail: str) -> None:
        self._abort(session.id, session.request_id, reason, detail)
        self._sessions.pop(session.id, None)
        self._writer.erase(session)
        self.pending_events.append(("FLASH_ERROR", detail))

    def _status(self, session: Session, page: StatusPage) -> None:
        if session.area and not session.committed:
            self._writer.keep_progress(session)
        self._outgoing.append(Outgoing("STATUS", session.request_id, page.values(session.id), page.lists()))

    def _content(self, session: Session) -> bytes:
        """Return the stored content; an upload to flash is read back."""
        if not session.area:
            return bytes(session.data)
        return self._writer.read(session)

    def _verify(self, session: Session) -> None:
        assert session.receiver is not None  # noqa: S101 - the caller has checked it
        if not session.receiver.stored.complete:
            self._status(session, session.receiver.status())
            return
        digest = hashlib.sha256(self._content(session)).digest()
        equal = digest == session.sha256
        self._outgoing.append(
            Outgoing("VERIFIED", session.request_id, {"session": session.id, "equal": equal, "sha256": digest})
        )
        if not equal:
            # The wrong chunk is not known, so the next attempt starts without stored chunks.
            del self._sessions[session.id]
            self.openings.parts.pop((session.kind, session.target), None)
            if session.area:
                self._writer.erase(session)

    def _commit(self, session: Session, now_s: float) -> None:
        if not session.committed:
            content = self._content(session)
            if session.receiver is None or hashlib.sha256(content).digest() != session.sha256:
                self._abort(session.id, session.request_id, "incomplete", "not verified")
                return
            if session.area:
                try:
                    self._writer.commit(session, content)
                except Rejection as rejection:
                    self._abort(session.id, session.request_id, rejection.reason, rejection.detail)
                    return
            else:
                tracker = self._tracker
                frame = tracker.imager.put_image(
                    session.target, content, tracker.exposure_ms, self._device_time(now_s), tracker.mode
                )
                self.openings.parts.pop(("image", session.target), None)
                session.frame_number = frame.number
            session.committed = True
        self._outgoing.append(Outgoing("COMMITTED", session.request_id, {"session": session.id}))

    def _end(self, session: Session, service: str) -> None:
        if session.area and session.receiver and not session.committed:
            self._writer.keep_progress(session)
        del self._sessions[session.id]
        if service == "ABORT_TRANSFER":
            self.pending_events.append(("TRANSFER_ABORTED", session.name))

    # --- downloads ----------------------------------------------------------------------------------------------

    def next_chunk(self, now_s: float) -> Outgoing | None:
        """Return the next chunk to send; None if no session has one. Sessions take turns."""
        senders = [s for s in self._sessions.values() if s.sender is not None]
        for step in range(len(senders)):
            session = senders[(self._next_sender + step) % len(senders)]
            choice = session.sender.next_chunk(now_s) if session.sender else None
            if choice is not None:
                self._next_sender += step + 1
                index, serial = choice
                data = bytes(session.data[index * session.chunk_bytes : (index + 1) * session.chunk_bytes])
                values: dict[str, Value] = {"session": session.id, "index": index, "serial": serial, "data": data}
                return Outgoing("CHUNK", session.request_id, values)
        return None

    def step(self, now_s: float) -> None:
        """Queue due STATUS_REQUESTs. Suspend or remove sessions that received no message for ``SESSION_TIMEOUT_S``."""
        for session in list(self._sessions.values()):
            if session.sender is not None:
                due = session.sender.request_due(now_s)
                if due is not None and session.sender.silent_requests <= MAX_SILENT_REQUESTS:
                    values = {"session": session.id, "serial": due[0], "from_index": due[1]}
                    self._outgoing.append(Outgoing("STATUS_REQUEST", session.request_id, values))
            if now_s - session.received_s > SESSION_TIMEOUT_S:
                if not session.committed and not (session.sender and session.sender.complete):
                    self._end(session, "silence")
                    self.pending_events.append(("TRANSFER_SUSPENDED", f"{session.name}: no message received"))
                else:
                    del self._sessions[session.id]
