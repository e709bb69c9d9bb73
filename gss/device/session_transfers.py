"""Transfers of a host session: one at a time on the line, any number queued. Produces messages; no I/O."""

from __future__ import annotations

from gss.device.protocol.codec import Decoded
from gss.device.protocol.transfer import StatusPage
from gss.device.session_events import TransferDone, TransferState, TransferUpdate
from gss.device.session_transfer import ENDED, MOVING, Message, RequestIds, Transfer
from gss.device.session_transfer_talk import TransferTalk, abort_message
from gss.domain.errors import Conflict, NotFound

REPORT_EVERY_S = 0.25


class TransferDesk:
    """All transfers of a session. Each opening takes a new request id, which identifies the transfer on the line."""

    def __init__(self) -> None:
        self._transfers: dict[int, Transfer] = {}
        self._by_session: dict[int, int] = {}
        self._talk = TransferTalk()
        self.line_is_up = False

    @property
    def line_bytes_s(self) -> float | None:
        """The line's rate; None while unknown (no pacing)."""
        return self._talk.line_bytes_s

    @line_bytes_s.setter
    def line_bytes_s(self, rate: float | None) -> None:
        self._talk.line_bytes_s = rate

    # --- requests of the owner ----------------------------------------------------------------------------------

    def add(self, transfer: Transfer) -> None:
        """Queue a transfer."""
        self._transfers[transfer.id] = transfer

    def get(self, transfer_id: int) -> Transfer:
        """Return the transfer of that id. Raises NotFound."""
        try:
            return self._transfers[transfer_id]
        except KeyError:
            raise NotFound("unknown transfer", got=str(transfer_id)) from None

    def pause(self, transfer_id: int) -> None:
        """Pause a transfer; the device keeps what it has stored. Raises Conflict."""
        transfer = self.get(transfer_id)
        if transfer.state in ENDED or transfer.state in (TransferState.PAUSED, TransferState.VERIFYING):
            raise Conflict(
                "the transfer cannot be paused now", expected="queued or transferring", got=transfer.state.value
            )
        if transfer.session is not None:
            self._talk.out.append(Message("PAUSE", transfer.request_id, {"session": transfer.session}))
        transfer.waits_for_device = False
        transfer.to(TransferState.PAUSED)

    def resume(self, transfer_id: int) -> None:
        """Queue a paused, link_lost or failed transfer again. Raises Conflict."""
        transfer = self.get(transfer_id)
        if transfer.state not in (TransferState.PAUSED, TransferState.LINK_LOST, TransferState.FAILED):
            raise Conflict(
                "the transfer cannot be resumed", expected="paused, link_lost or failed", got=transfer.state.value
            )
        transfer.waits_for_device = False
        transfer.to(TransferState.QUEUED)

    def abort(self, transfer_id: int) -> None:
        """Abort a transfer at both ends. Raises Conflict if it has ended."""
        transfer = self.get(transfer_id)
        if transfer.state in ENDED:
            raise Conflict("the transfer has ended", got=transfer.state.value)
        if transfer.session is not None:
            self._talk.out.append(abort_message(transfer.session, transfer.request_id, "aborted"))
        transfer.to(TransferState.ABORTED, "by the operator")

    def forget(self, transfer_id: int) -> None:
        """Remove a transfer that has ended. Raises Conflict."""
        if self.get(transfer_id).state not in ENDED:
            raise Conflict("the transfer has not ended", got=self.get(transfer_id).state.value)
        del self._transfers[transfer_id]
        self._by_session = {s: t for s, t in self._by_session.items() if t != transfer_id}

    def lose_line(self) -> None:
        """Set active transfers to link_lost after the port was lost."""
        self.line_is_up = False
        self._talk.out.clear()
        for transfer in self._transfers.values():
            if transfer.state in MOVING:
                self._talk.lose(transfer, "the line is gone", 0.0)

    def line_back(self, now_s: float) -> None:
        """Reopen transfers interrupted by a line loss or a restart, after the device has identified itself."""
        self.line_is_up = True
        for transfer in self._transfers.values():
            if transfer.state is TransferState.PAUSED and transfer.waits_for_device:
                transfer.waits_for_device = False
                transfer.to(TransferState.QUEUED)
            if transfer.state is TransferState.LINK_LOST:
                transfer.due_s = now_s

    def device_restarted(self, now_s: float) -> None:
        """Reopen the active transfer: the device lost its sessions, but not what it had stored."""
        for transfer in self._transfers.values():
            if transfer.state in MOVING and transfer.request_id:
                self._talk.lose(transfer, "the device restarted", now_s)
                transfer.due_s = now_s

    def bank_in_use(self, bank: int) -> None:
        """Mark a committed upload as ACTIVE once its bank is the active catalogue."""
        for transfer in self._transfers.values():
            if transfer.state is TransferState.COMMITTED and (transfer.kind, transfer.target) == ("catalogue", bank):
                transfer.to(TransferState.ACTIVE)

    # --- time ---------------------------------------------------------------------------------------------------

    def current(self) -> Transfer | None:
        """Return the transfer that uses the line, or None."""
        return next((t for t in self._transfers.values() if t.state in MOVING), None)

    def step(self, now_s: float, take_request_id: RequestIds) -> list[Message]:
        """Return the messages (not chunks) to send now."""
        if not self.line_is_up:
            return []
        transfer = self.current()
        if transfer is None:
            transfer = next((t for t in self._transfers.values() if t.state is TransferState.QUEUED), None)
            if transfer is not None:
                self._talk.begin_open(transfer, now_s, take_request_id)
        elif transfer.state is TransferState.LINK_LOST and now_s >= transfer.due_s:
            self._talk.begin_open(transfer, now_s, take_request_id)
        elif transfer.state is TransferState.OPENING and now_s >= transfer.due_s:
            self._talk.open_again(transfer, now_s)
        elif transfer.state is TransferState.TRANSFERRING:
            if not self._talk.adapt(transfer, now_s, take_request_id):
                self._talk.keep_moving(transfer, now_s)
        elif transfer.state is TransferState.VERIFYING and now_s >= transfer.due_s:
            self._talk.ask_verify(transfer, now_s)
        messages = list(self._talk.out)
        self._talk.out.clear()
        return messages

    def next_chunk(self, now_s: float) -> Message | None:
        """Return the next chunk to send, or None."""
        t = self.current()
        if t is None or t.state is not TransferState.TRANSFERRING or t.sender is None or t.session is None:
            return None
        choice = t.sender.next_chunk(now_s)
        if choice is None:
            return None
        index, serial = choice
        data = bytes(t.data[index * t.chunk_bytes : (index + 1) * t.chunk_bytes])
        return Message("CHUNK", t.request_id, {"session": t.session, "index": index, "serial": serial, "data": data})

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
        t = self._transfers.get(self._by_session.get(session, -1))
        if t is None:
            return
        if t.session != session:
            self._talk.after_the_end(t, service, session)
        elif service == "STATUS" and t.sender is not None and t.state is TransferState.TRANSFERRING:
            t.sender.on_status(StatusPage.of(message), now_s)
            t.tries = 0
            if t.sender.complete:
                self._talk.to_verify(t, now_s)
        elif service == "CHUNK" and t.receiver is not None:
            self._talk.chunk(t, message, now_s)
        elif service == "STATUS_REQUEST":
            self._talk.asked(t, message, now_s)
        elif service == "VERIFIED" and t.state is TransferState.VERIFYING:
            self._talk.verified(t, message, now_s)
        elif service == "COMMITTED" and t.state is TransferState.VERIFYING:
            t.to(TransferState.COMMITTED)
            self._talk.finish(t)

    def _of_request(self, request_id: int) -> Transfer | None:
        return next((t for t in self._transfers.values() if t.request_id == request_id), None)

    def _opened(self, request_id: int, message: Decoded, now_s: float) -> None:
        t = self._of_request(request_id)
        if t is not None and t.state is TransferState.OPENING and self._talk.opened(t, message, now_s):
            self._by_session[int(message.values["session"])] = t.id

    def _refused(self, request_id: int, session: int, message: Decoded, now_s: float) -> None:
        t = self._of_request(request_id)
        if t is not None:
            self._talk.refused(t, session, message, now_s)

    # --- reports ------------------------------------------------------------------------------------------------

    def news(self, now_s: float) -> list[TransferUpdate | TransferDone]:
        """Return updates since the last call: each state change, and progress every ``REPORT_EVERY_S``."""
        events: list[TransferUpdate | TransferDone] = []
        for t in self._transfers.values():
            progressing = t.state is TransferState.TRANSFERRING and now_s - t.reported_s >= REPORT_EVERY_S
            if t.changed or progressing:
                events.append(t.update(now_s, self.line_bytes_s))
                t.changed, t.reported_s = False, now_s
        events += self._talk.done
        self._talk.done = []
        return events
