"""The definitions that telemetry services need. The instrument's dictionary provides them; derived parameters are added
at run time."""

from __future__ import annotations

from typing import Protocol

from gss.instruments.dictionary.definitions import EventDefinition, LimitSet, PacketDefinition


class TelemetryDefinitions(Protocol):
    """Packets with their fields, and the events and limit sets of the same instrument."""

    @property
    def telemetry(self) -> tuple[PacketDefinition, ...]:
        """Every packet, in display order."""

    @property
    def events(self) -> tuple[EventDefinition, ...]:
        """Every event."""

    @property
    def limit_sets(self) -> tuple[LimitSet, ...]:
        """The selectable limit sets."""

    def packet(self, name: str) -> PacketDefinition:
        """Return the packet of that name. Raises NotFound."""
