"""Records of the device interface: commands, telemetry, events and service messages.

The content is a YAML file such as ``gss-common.yaml``, read by :mod:`gss.instruments.dictionary.read_dictionary`.
Codec, forms, interface document and simulator use these records, so a new command needs only a new row in the file.
Units are those of the wire and the display (deg, ms, °C), as the file's header states.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from gss.domain.errors import NotFound
from gss.instruments.dictionary.items import (
    FLOATS,
    INTEGER_RANGES,
    Argument,
    Conversion,
    EnumChoice,
    Group,
    Hazard,
    Item,
    Layout,
    TelemetryField,
    Value,
    Values,
)

__all__ = [
    "FLOATS",
    "INTEGER_RANGES",
    "Argument",
    "CommandDefinition",
    "Conversion",
    "Dictionary",
    "EnumChoice",
    "EventDefinition",
    "Group",
    "Hazard",
    "Item",
    "Layout",
    "LimitSet",
    "PacketDefinition",
    "Precondition",
    "Service",
    "TelemetryField",
    "Value",
    "Values",
]


@dataclass(frozen=True)
class Precondition:
    """A condition on the latest housekeeping: ``field`` ``op`` ``value``, with op one of eq ne lt le gt ge."""

    field: str
    op: str
    value: Value
    text: str

    def met(self, housekeeping: Values | None) -> bool | None:
        """True if the condition holds; None if it cannot be evaluated, for example without housekeeping."""
        if housekeeping is None or self.field not in housekeeping:
            return None
        left, right = housekeeping[self.field], self.value
        if self.op in ("eq", "ne"):
            return (left == right) == (self.op == "eq")
        if isinstance(left, str | bytes) or isinstance(right, str | bytes):
            return None
        return {"lt": left < right, "le": left <= right, "gt": left > right, "ge": left >= right}[self.op]


@dataclass(frozen=True)
class CommandDefinition:
    """One command.

    ``any_dictionary``: True if the device accepts the command even if the dictionaries differ. ``simulator_only``: True
    if a real unit rejects the command with ``unknown_command``.
    """

    name: str
    code: int
    subsystem: str
    purpose: str
    arguments: tuple[Argument, ...]
    returns: Layout
    hazard: Hazard
    hazard_reason: str
    preconditions: tuple[Precondition, ...]
    idempotent: bool
    role: str
    favourite: bool
    accept_s: float
    complete_s: float
    any_dictionary: bool
    simulator_only: bool = False

    def hazard_for(self, arguments: Values) -> tuple[Hazard, str]:
        """Return the highest hazard of the command and of the selected enumeration values, with its reason."""
        worst, reason = self.hazard, self.hazard_reason
        for argument in self.arguments:
            chosen = arguments.get(argument.name, argument.default)
            for choice in argument.choices:
                if chosen in (choice.name, choice.value) and choice.hazard.rank > worst.rank:
                    worst, reason = choice.hazard, choice.note or f"{argument.name} = {choice.name}"
        return worst, reason

    def argument(self, name: str) -> Argument:
        """Return an argument by its name. Raises NotFound."""
        for argument in self.arguments:
            if argument.name == name:
                return argument
        raise NotFound(
            f"{self.name} has no argument {name}", expected=", ".join(a.name for a in self.arguments) or "none"
        )


@dataclass(frozen=True)
class PacketDefinition:
    """One telemetry packet."""

    name: str
    code: int
    purpose: str
    fields: Layout
    stale_after_s: float
    simulator_only: bool

    @cached_property
    def values(self) -> tuple[TelemetryField, ...]:
        """Fields of the packet that are not lists."""
        return tuple(f for f in self.fields if isinstance(f, TelemetryField))


@dataclass(frozen=True)
class EventDefinition:
    """One event. ``severity``: ok, watch, warning, critical. ``action``: what the operator should do when it occurs."""

    name: str
    code: int
    severity: str
    purpose: str
    action: str = ""


@dataclass(frozen=True)
class Service:
    """One message of the protocol below the level of commands. ``packet``: report, event or transfer."""

    name: str
    packet: str
    code: int
    purpose: str
    fields: Layout


@dataclass(frozen=True)
class LimitSet:
    """A named set of limits that the operator can select."""

    name: str
    note: str = ""


@dataclass(frozen=True)
class Dictionary:
    """Dictionary of the device interface, with look-up by name and code.

    ``hash``: SHA-256 of the content without descriptions. ``same_layout_as``: hashes of earlier versions with the same
    layout; packets with these hashes are decoded with this dictionary.
    """

    version: int
    device_model: str
    commands: tuple[CommandDefinition, ...]
    telemetry: tuple[PacketDefinition, ...]
    events: tuple[EventDefinition, ...]
    services: tuple[Service, ...]
    hash: bytes
    limit_sets: tuple[LimitSet, ...] = ()
    same_layout_as: frozenset[bytes] = frozenset()

    @property
    def hash_hex(self) -> str:
        """The hash as 64 hexadecimal digits."""
        return self.hash.hex()

    @cached_property
    def prefix(self) -> int:
        """First two bytes of the hash, which every packet contains."""
        return int.from_bytes(self.hash[:2], "big")

    def describes(self, dictionary_hash: bytes) -> bool:
        """True if a device with a dictionary hash uses this layout."""
        return dictionary_hash == self.hash or dictionary_hash in self.same_layout_as

    @cached_property
    def prefixes(self) -> frozenset[int]:
        """Prefixes of the packets that use this layout."""
        return frozenset(int.from_bytes(h[:2], "big") for h in (self.hash, *self.same_layout_as))

    def command(self, name: str) -> CommandDefinition:
        """Return a command by its name. Raises NotFound."""
        for command in self.commands:
            if command.name == name:
                return command
        raise NotFound("unknown command", expected=", ".join(c.name for c in self.commands), got=name)

    def command_of_code(self, code: int) -> CommandDefinition | None:
        """Return a command by its code. Return None for an unknown code, because codes are received from the line and
        can be wrong."""
        return next((c for c in self.commands if c.code == code), None)

    def packet(self, name: str) -> PacketDefinition:
        """Return a telemetry packet by its name. Raises NotFound."""
        for packet in self.telemetry:
            if packet.name == name:
                return packet
        raise NotFound("unknown telemetry packet", expected=", ".join(p.name for p in self.telemetry), got=name)

    def packet_of_code(self, code: int) -> PacketDefinition | None:
        """Return a telemetry packet by its code, or None."""
        return next((p for p in self.telemetry if p.code == code), None)

    def event_named(self, name: str) -> EventDefinition:
        """Return an event by its name. Raises NotFound."""
        for event in self.events:
            if event.name == name:
                return event
        raise NotFound("unknown event", expected=", ".join(e.name for e in self.events), got=name)

    def event_of_code(self, code: int) -> EventDefinition | None:
        """Return an event by its code, or None."""
        return next((e for e in self.events if e.code == code), None)

    def service(self, name: str) -> Service:
        """Return a service message by its name. Raises NotFound."""
        for service in self.services:
            if service.name == name:
                return service
        raise NotFound("unknown service message", expected=", ".join(s.name for s in self.services), got=name)

    def service_of_code(self, packet: str, code: int) -> Service | None:
        """Return a service message by packet type and code, or None."""
        return next((s for s in self.services if s.packet == packet and s.code == code), None)
