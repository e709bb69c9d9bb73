"""Creation and connection of the services of all folders of ``gss.operations``."""

from __future__ import annotations

from gss.operations.clock import MACHINE_CLOCK, Clock, monotonic_s
from gss.operations.instruments.packages import InstrumentService
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.line.link import OpenLine
from gss.operations.notifications.notifications import NotificationService
from gss.operations.notifications.rules_file import read_rules
from gss.operations.notifications.senders import Sender
from gss.settings import Settings
from gss.wiring.accounts import open_accounts
from gss.wiring.base import open_base
from gss.wiring.catalogues import open_catalogues
from gss.wiring.commanding import open_commanding
from gss.wiring.contacts import open_contacts
from gss.wiring.frames import open_frames
from gss.wiring.heads import open_heads
from gss.wiring.intake import open_intake
from gss.wiring.line import open_line_room
from gss.wiring.passes import open_passes
from gss.wiring.procedures import open_procedures
from gss.wiring.recordings import open_recordings
from gss.wiring.services import Services
from gss.wiring.studies import open_studies
from gss.wiring.telemetry import open_telemetry
from gss.wiring.transfers import open_transfers
from gss.wiring.upkeep import open_retention, open_upkeep


def build(
    settings: Settings, *, ready: bool = False, clock: Clock = MACHINE_CLOCK, open_line: OpenLine | None = None
) -> Services:
    """Create and connect all services without starting them. ``ready``: False to upgrade the database schema first; True in API
    workers, which use the schema that the link process has upgraded. ``clock``: mission time. ``open_line``: replaces the
    function that opens real ports."""
    base = open_base(settings, clock, ready=ready)
    accounts = open_accounts(base)
    line = open_line_room(base, open_line)
    commanding = open_commanding(base, line, accounts)
    telemetry = open_telemetry(base, line, commanding)
    procedures = open_procedures(base, line, commanding, telemetry)
    transfers = open_transfers(base, line, commanding)
    frames = open_frames(base, line, transfers)
    intake = open_intake(base, line, telemetry, commanding, transfers, frames)
    retention = open_retention(base, line)
    contacts = open_contacts(base, line, telemetry, retention)
    catalogues = open_catalogues(base, line, transfers)
    passes = open_passes(base, line, accounts, commanding, procedures, transfers, frames, catalogues)
    dispatcher = Dispatcher(
        line.events,
        base.bus,
        monotonic_s,
        subscribers=[
            line.link.handle,
            telemetry.telemetry.handle,
            telemetry.last_attitude.handle,
            commanding.commands.handle,
            transfers.progress.handle,
            intake.frames.handle,
            intake.results.handle,
            intake.banks.handle,
            intake.images.handle,
            transfers.bank_history.handle,
            telemetry.alarms.handle,
            contacts.contacts.handle,
            commanding.schedule.handle,
            procedures.runs.handle,
        ],
        periodic=[transfers.progress.finalise, line.capture_sync, line.capture_packing],
    )
    return Services(
        base=base,
        accounts=accounts,
        line=line,
        telemetry=telemetry,
        commanding=commanding,
        procedures=procedures,
        transfers=transfers,
        frames=frames,
        intake=intake,
        contacts=contacts,
        catalogues=catalogues,
        instruments=InstrumentService(base.instruments, base.unit, base.database, base.parsing, line.link, base.bus),
        passes=passes,
        heads=open_heads(base, telemetry),
        recordings=open_recordings(base, line, frames, passes),
        studies=open_studies(base, transfers, frames, contacts, passes),
        notifications=NotificationService(
            read_rules(settings.notifications),
            telemetry.alarms,
            base.bus,
            base.database,
            clock.now,
            clock.monotonic_s,
            Sender(settings.notifications_private).send,
        ),
        upkeep=open_upkeep(
            base,
            line,
            accounts,
            telemetry,
            commanding,
            transfers,
            frames,
            retention,
            dispatcher,
            passes,
        ),
        dispatcher=dispatcher,
    )
