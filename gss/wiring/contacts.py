"""Services of contacts and of the replays of their captures."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.clock import monotonic_s
from gss.operations.contacts.contacts import ContactService
from gss.operations.contacts.handover import HandoverService
from gss.operations.contacts.replay_capture import CaptureReplay
from gss.operations.upkeep.retention import RetentionService
from gss.wiring.base import BaseServices
from gss.wiring.line import Line
from gss.wiring.telemetry import TelemetryServices


@dataclass(frozen=True)
class Contacts:
    """Services of contacts, of their checklists and hand-over notes, and of the replay of captures."""

    contacts: ContactService
    handover: HandoverService
    replay: CaptureReplay


def open_contacts(
    base: BaseServices, line: Line, telemetry: TelemetryServices, retention: RetentionService
) -> Contacts:
    """Create the contact services."""
    captures, limits = base.captures, telemetry.telemetry.limits
    return Contacts(
        ContactService(
            line.link, telemetry.alarms, base.database, base.bus, captures, base.clock.now, retention.removed_before
        ),
        HandoverService(base.database, base.bus, base.clock.now, base.unit.about.checklist),
        CaptureReplay(
            base.dictionary, captures, limits, base.bus, monotonic_s, base.unit.roles.quantities.status, base.framing
        ),
    )
