"""The services of all rooms, and the order in which they start and stop."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

from gss.operations.instruments.packages import InstrumentService
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.notifications.notifications import NotificationService
from gss.wiring.accounts import Accounts
from gss.wiring.base import BaseServices
from gss.wiring.catalogues import Catalogues
from gss.wiring.commanding import Commanding
from gss.wiring.contacts import Contacts
from gss.wiring.frames import Frames
from gss.wiring.heads import Heads
from gss.wiring.intake import Intake
from gss.wiring.line import Line
from gss.wiring.passes import Passes
from gss.wiring.procedures import Procedures
from gss.wiring.recordings import RecordingsRoom
from gss.wiring.studies import Studies
from gss.wiring.telemetry import TelemetryServices
from gss.wiring.transfers import Transfers
from gss.wiring.upkeep import Upkeep


@dataclass(frozen=True)
class Services:
    """All services that routers and commands can use, with one field per room of operations. If a room has only one service, the
    field is that service. ``dispatcher``: passes the events of the line to the services. ``stopping``: set when the server
    begins to stop."""

    base: BaseServices
    accounts: Accounts
    line: Line
    telemetry: TelemetryServices
    commanding: Commanding
    procedures: Procedures
    transfers: Transfers
    frames: Frames
    intake: Intake
    contacts: Contacts
    catalogues: Catalogues
    instruments: InstrumentService
    passes: Passes
    heads: Heads
    recordings: RecordingsRoom
    studies: Studies
    notifications: NotificationService
    upkeep: Upkeep
    dispatcher: Dispatcher
    stopping: threading.Event = field(default_factory=threading.Event)

    def start(self) -> None:
        """Resume or close the work that the previous server did not finish, start all services, and open the line."""
        self.accounts.audit.begin_anchors()
        self.accounts.intents.recover()
        self.base.jobs.start()
        self.transfers.transfers.start()
        self.commanding.commands.start()
        self.contacts.handover.start()
        self.procedures.runs.start()
        self.passes.runner.start()
        self.telemetry.alarms.start()
        self.notifications.start()
        self.upkeep.retention.start()
        self.upkeep.pages.start()
        self.upkeep.audit.start()
        self.dispatcher.start()
        self.line.link.start()
        self.upkeep.status.start()
        self.telemetry.telemetry.rollups.start()
        self.frames.compiler.start()
        if self.base.settings.device:
            self.line.link.open_later(self.base.settings.device)

    def announce_stop(self) -> None:
        """Interrupt the jobs, and end open streams and the parsing of files before the server closes its connections. This runs in
        a signal handler. A thread stores the state of the jobs, because storing can wait for the database."""
        if not self.stopping.is_set():
            threading.Thread(target=self.base.jobs.interrupt, name="interrupt jobs", daemon=True).start()
        self.stopping.set()
        self.base.bus.wake_all()
        self.base.parsing.stop()

    def stop(self) -> None:
        """Stop all services. Services that send commands stop first, then the line, then services that process received data."""
        self.announce_stop()
        self.upkeep.status.stop()
        self.heads.watch.stop()
        self.notifications.stop()
        self.upkeep.audit.stop()
        self.procedures.runs.shut_down()
        self.line.link.stop()
        self.dispatcher.stop()
        self.transfers.transfers.stop()
        self.frames.compiler.stop()
        self.contacts.replay.stop()
        self.frames.replay.stop()
        self.frames.frames.stop()
        self.base.jobs.stop()
        self.telemetry.telemetry.rollups.stop()
        self.studies.executor.stop()
        self.close_databases()

    def close_databases(self) -> None:
        """Close the databases, also of services that were not started. SQLite then writes its log to the file of the database,
        unless another process uses it."""
        self.accounts.intents.close()
        self.accounts.accounts.close()
        self.base.database.close()
