"""Identify the device: repeat HELLO until it is answered, compare the dictionaries, and restrict commands until they
match."""

from __future__ import annotations

from collections.abc import Mapping

from gss.device.protocol.sender import LineSender
from gss.device.session_events import HelloReceived
from gss.device.session_reading import read_hello
from gss.domain.errors import Conflict
from gss.instruments.dictionary.definitions import Dictionary, Value

HELLO_AGAIN_S = 3.0
"""Default pause between two HELLO commands."""


class Handshake:
    """State of the identification. Sets the sender's prefix to that of the device's dictionary. ``again_s``: pause
    between two HELLO commands."""

    def __init__(self, dictionary: Dictionary, sender: LineSender, again_s: float = HELLO_AGAIN_S) -> None:
        self._dictionary, self._sender, self._again_s = dictionary, sender, again_s
        self.hello: HelloReceived | None = None
        self._due_s: float | None = None
        self.acknowledged = False
        self.greeted = False
        """True if a device has answered on the current line."""

    def begin(self, now_s: float) -> None:
        """Start on a newly opened line: only HELLO and ABORT are sent until the device has identified itself."""
        self.greeted = False
        self.ask_at(now_s)

    def ask_at(self, now_s: float | None) -> None:
        """Send HELLO from ``now_s`` on until it is answered. If ``now_s`` is None, stop sending HELLO."""
        self._due_s = now_s

    def is_due(self, now_s: float) -> bool:
        """True if HELLO must be sent now. Schedules the next HELLO."""
        if self._due_s is None or now_s < self._due_s:
            return False
        self._due_s = now_s + self._again_s
        return True

    def met(self, values: Mapping[str, Value], device_time_s: float) -> HelloReceived:
        """Process the answer to HELLO. The acknowledgement of a mismatch is valid until another dictionary answers."""
        previous, self.hello = self.hello, read_hello(values, device_time_s, self._dictionary)
        self.acknowledged &= previous is not None and previous.dictionary_hash == self.hello.dictionary_hash
        self._sender.prefix = self._prefix_of(self.hello) if self.agreed else self._dictionary.prefix
        self._due_s, self.greeted = None, True
        return self.hello

    def acknowledge(self) -> None:
        """Accept the mismatch of the dictionary that answered last; packets are sent with the device's prefix. Without
        an answer there is no effect."""
        if self.hello is not None:
            self.acknowledged, self._sender.prefix = True, self._prefix_of(self.hello)

    @staticmethod
    def _prefix_of(hello: HelloReceived) -> int:
        return int(hello.dictionary_hash[:4], 16)

    def can_decode(self, prefix: int) -> bool:
        """True if packets with this prefix have the session's dictionary, or the dictionary that was acknowledged."""
        return prefix in self._dictionary.prefixes or (self.acknowledged and prefix == self._sender.prefix)

    @property
    def agreed(self) -> bool:
        """True if a device answered, with the same dictionary or with an acknowledged mismatch."""
        return self.hello is not None and (self.hello.dictionary_match or self.acknowledged)

    def check_allowed(self, name: str) -> None:
        """Raise Conflict while a dictionary mismatch is unacknowledged, NotFound if there is no such command."""
        command = self._dictionary.command(name)
        if self.hello is None or self.agreed or command.any_dictionary:
            return
        raise Conflict(
            "the device has another dictionary",
            expected=self._dictionary.hash_hex[:12],
            got=self.hello.dictionary_hash[:12],
            hint="install the version that fits the device, or acknowledge the mismatch",
        )
