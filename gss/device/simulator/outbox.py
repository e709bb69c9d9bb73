"""Output queue of the device: framed packets in order, until the line accepts them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from gss.device.protocol.codec import encode
from gss.device.protocol.packet import PacketType
from gss.device.protocol.sender import LineSender
from gss.device.simulator.reports import Report
from gss.device.simulator.sessions import Outgoing
from gss.instruments.dictionary.definitions import Dictionary

MAX_WAITING = 400
MAX_TEXT_LENGTH = 200


def short_text(text: str) -> str:
    """Return the text truncated to the length of a text field, without splitting a character."""
    return text.encode()[:MAX_TEXT_LENGTH].decode(errors="ignore")


class Outbox:
    """Queue of framed packets. ``time_s``: device time of the packets, set by the owner. ``listener``: also receives every
    telemetry packet, as the spacecraft does."""

    def __init__(self, dictionary: Dictionary, listener: Callable[[Report], None], framing: str = "cobs") -> None:
        self._dictionary, self._listener = dictionary, listener
        self._sender = LineSender(to_device=False, prefix=dictionary.prefix, framing=framing)
        self._frames: deque[bytes] = deque()
        self.time_s = 0.0

    def telemetry(self, report: Report, request_id: int) -> None:
        """Queue a telemetry packet."""
        name, values, lists = report
        packet = self._dictionary.packet(name)
        self._listener(report)
        self._push(PacketType.TELEMETRY, packet.code, request_id, encode(packet.fields, values, lists))

    def event(self, name: str, text: str, request_id: int = 0) -> None:
        """Queue an event."""
        payload = encode(self._dictionary.service("EVENT").fields, {"text": short_text(text)})
        self._push(PacketType.EVENT, self._dictionary.event_named(name).code, request_id, payload)

    def report(self, request_id: int, code: int, payload: bytes) -> None:
        """Queue a report on a command."""
        self._push(PacketType.REPORT, code, request_id, payload)

    def transfer(self, message: Outgoing) -> None:
        """Queue a transfer message."""
        self._add(self.transfer_frame(message))

    def transfer_frame(self, message: Outgoing) -> bytes:
        """Return the frame of a transfer message without queueing it, for chunks."""
        service = self._dictionary.service(message.service)
        payload = encode(service.fields, message.values, message.lists)
        return self._sender.packet(PacketType.TRANSFER, service.code, message.request_id, payload, self.time_s)

    def _push(self, kind: PacketType, code: int, request_id: int, payload: bytes) -> None:
        self._add(self._sender.packet(kind, code, request_id, payload, self.time_s))

    def _add(self, frame: bytes) -> None:
        """Queue a frame. Drops the oldest frame if the queue is full, to limit memory use."""
        self._frames.append(frame)
        if len(self._frames) > MAX_WAITING:
            self._frames.popleft()

    def take(self) -> bytes | None:
        """Remove and return the next frame; None if the queue is empty."""
        return self._frames.popleft() if self._frames else None

    def clear(self) -> None:
        """Discard all frames, for example at power-off."""
        self._frames.clear()
