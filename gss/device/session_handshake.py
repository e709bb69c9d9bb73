"""Who is at the other end: asking until somebody answers, comparing dictionaries, and what is allowed meanwhile."""

from __future__ import annotations

from collections.abc import Mapping

from gss.device.dictionary import Dictionary, Value
from gss.device.protocol.line import LineSender
from gss.device.session_events import HelloReceived
from gss.device.session_reading import read_hello
from gss.domain.errors import Conflict

HELLO_AGAIN_S = 3.0


class Handshake:
    """The last HELLO and what follows from it. The sender's prefix is the dictionary's that both ends know."""

    def __init__(self, dictionary: Dictionary, sender: LineSender) -> None:
        self._dictionary, self._sender = dictionary, sender
        self.hello: HelloReceived | None = None
        self._due_s: float | None = None
        self.acknowledged = False
        self.greeted = False
        """Has somebody answered on the present line?"""

    def begin(self, now_s: float) -> None:
        """A line was opened: whoever is at its end must say so before anything else is sent."""
        self.greeted = False
        self.ask_at(now_s)

    def ask_at(self, now_s: float | None) -> None:
        """Ask from this moment on until it is answered; None: do not ask."""
        self._due_s = now_s

    def is_due(self, now_s: float) -> bool:
        """Shall HELLO go out now? Asks again after a while."""
        if self._due_s is None or now_s < self._due_s:
            return False
        self._due_s = now_s + HELLO_AGAIN_S
        return True

    def met(self, values: Mapping[str, Value], device_time_s: float) -> HelloReceived:
        """The answer. An acknowledgement holds until the dictionaries match again."""
        self.hello = read_hello(values, device_time_s, self._dictionary.hash)
        if self.hello.dictionary_match:
            self._sender.prefix, self.acknowledged = self._dictionary.prefix, False
        self._due_s, self.greeted = None, True
        return self.hello

    def acknowledge(self) -> None:
        """The operator accepts the difference; packets go out with the device's prefix."""
        self.acknowledged = True
        if self.hello is not None:
            self._sender.prefix = int(self.hello.dictionary_hash[:4], 16)

    @property
    def agreed(self) -> bool:
        """Somebody answered, with our dictionary or with one whose difference was accepted."""
        return self.hello is not None and (self.hello.dictionary_match or self.acknowledged)

    def check_allowed(self, name: str) -> None:
        """Conflict while the dictionaries differ and nobody acknowledged it; NotFound without such a command."""
        command = self._dictionary.command(name)
        if self.hello is None or self.agreed or command.any_dictionary:
            return
        raise Conflict(
            "the device has another dictionary",
            expected=self._dictionary.hash_hex[:12],
            got=self.hello.dictionary_hash[:12],
            hint="install the version that fits the device, or acknowledge the mismatch",
        )
