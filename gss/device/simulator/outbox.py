"""What the device has to say, framed and in order, until the line takes it."""

from __future__ import annotations

from collections import deque

from gss.device.dictionary import Dictionary
from gss.device.protocol.codec import encode
from gss.device.protocol.line import LineSender
from gss.device.protocol.packet import PacketType
from gss.device.simulator.reports import Report
from gss.device.simulator.sessions import Outgoing

MOST_WAITING = 400
LONGEST_TEXT = 200


def short_text(text: str) -> str:
    """Cut to what a text field may hold, never inside a character."""
    return text.encode()[:LONGEST_TEXT].decode(errors="ignore")


class Outbox:
    """Frames packets with the device's clock. ``time_s`` is set by its owner."""

    def __init__(self, dictionary: Dictionary, framing: str = "cobs") -> None:
        self._dictionary = dictionary
        self._sender = LineSender(to_device=False, prefix=dictionary.prefix, framing=framing)
        self._frames: deque[bytes] = deque()
        self.time_s = 0.0

    def telemetry(self, report: Report, request_id: int) -> None:
        """A telemetry packet."""
        name, values, lists = report
        packet = self._dictionary.packet(name)
        self._push(PacketType.TELEMETRY, packet.code, request_id, encode(packet.fields, values, lists))

    def event(self, name: str, text: str, request_id: int = 0) -> None:
        """An event."""
        payload = encode(self._dictionary.service("EVENT").fields, {"text": short_text(text)})
        self._push(PacketType.EVENT, self._dictionary.event_named(name).code, request_id, payload)

    def report(self, request_id: int, code: int, payload: bytes) -> None:
        """A report on a command."""
        self._push(PacketType.REPORT, code, request_id, payload)

    def transfer(self, message: Outgoing) -> None:
        """A transfer message."""
        self._add(self.transfer_frame(message))

    def transfer_frame(self, message: Outgoing) -> bytes:
        """A transfer message for the line at once: chunks do not wait here."""
        service = self._dictionary.service(message.service)
        payload = encode(service.fields, message.values, message.lists)
        return self._sender.packet(PacketType.TRANSFER, service.code, message.request_id, payload, self.time_s)

    def _push(self, kind: PacketType, code: int, request_id: int, payload: bytes) -> None:
        self._add(self._sender.packet(kind, code, request_id, payload, self.time_s))

    def _add(self, frame: bytes) -> None:
        """A line nobody drains must not fill the memory: the oldest goes."""
        self._frames.append(frame)
        if len(self._frames) > MOST_WAITING:
            self._frames.popleft()

    def take(self) -> bytes | None:
        """The next frame."""
        return self._frames.popleft() if self._frames else None

    def clear(self) -> None:
        """Power off."""
        self._frames.clear()
