"""The services that routers and commands use, and the order in which they start and stop."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

from gss.domain.stars import StarTable
from gss.instruments.registry import Registry
from gss.operations.accounts.accounts import AccountService
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_intents import AuditIntents
from gss.operations.catalogues.build_catalogue import CatalogueService
from gss.operations.catalogues.design import DesignService
from gss.operations.catalogues.star_lists import StarListService
from gss.operations.clock import Clock
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.command_history import CommandHistory
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.commanding.stack_runs import StackRunner
from gss.operations.commanding.stacks import StackService
from gss.operations.contacts.contacts import ContactService
from gss.operations.contacts.replay_capture import CaptureReplay
from gss.operations.events import EventBus
from gss.operations.frames.frames import FrameService
from gss.operations.frames.place import PlaceService
from gss.operations.frames.replay import ReplayService
from gss.operations.frames.rerun_viewer import RerunViewer
from gss.operations.instruments.packages import InstrumentService
from gss.operations.intake.uploaded_images import UploadedImages
from gss.operations.jobs import JobService
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.line.link import LinkService
from gss.operations.metrics import StreamCounts
from gss.operations.notifications.notifications import NotificationService
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.operations.passes.room import Passes
from gss.operations.procedures.procedures import ProcedureService
from gss.operations.procedures.runs import ProcedureRunner
from gss.operations.recordings.live import LiveRecordings
from gss.operations.recordings.scope import Scopes
from gss.operations.recordings.stored import Recordings
from gss.operations.studies.analyses import AnalysisService
from gss.operations.studies.calibrations import CalibrationService
from gss.operations.studies.campaigns import CampaignService
from gss.operations.studies.executor import Executor
from gss.operations.studies.list_runs import ListRunService
from gss.operations.studies.reprocess import ReprocessService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.derived_history import DerivedHistory
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers.arrivals import Writer
from gss.operations.transfers.bank_history import BankHistoryService
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.device_tables import DeviceTableService
from gss.operations.transfers.downloads import Downloads
from gss.operations.transfers.transfers import TransferService
from gss.operations.upkeep.status import StatusService
from gss.operations.upkeep.upkeep import Upkeep
from gss.settings import Settings
from gss.store.engine import Database


@dataclass
class Services:
    """Everything a router may ask for. ``clock``: mission time."""

    settings: Settings
    clock: Clock
    instruments: Registry
    packages: InstrumentService
    stars: StarTable
    bus: EventBus
    link: LinkService
    commands: CommandService
    telemetry: TelemetryService
    derived_history: DerivedHistory
    transfers: TransferService
    frames: FrameService
    banks: BankService
    bank_history: BankHistoryService
    star_lists: StarListService
    catalogues: CatalogueService
    jobs: JobService
    status: StatusService
    viewer: RerunViewer
    database: Database
    replay: ReplayService
    alarms: AlarmService
    notifications: NotificationService
    downloads: Downloads
    tables: DeviceTableService
    images: UploadedImages
    authority: AuthorityService
    history: CommandHistory
    schedule: ScheduleService
    stacks: StackService
    stack_runs: StackRunner
    procedures: ProcedureService
    procedure_runs: ProcedureRunner
    campaigns: CampaignService
    reprocessing: ReprocessService
    list_runs: ListRunService
    executor: Executor
    contacts: ContactService
    passes: Passes
    dispatcher: Dispatcher
    writer: Writer
    capture_replay: CaptureReplay
    design: DesignService
    calibrations: CalibrationService
    analyses: AnalysisService
    place: PlaceService
    scopes: Scopes
    recordings: Recordings
    live_recordings: LiveRecordings
    accounts: AccountService
    audit: AuditService
    audit_intents: AuditIntents
    upkeep: Upkeep
    streams: StreamCounts
    parsing: ParseProcesses
    stopping: threading.Event = field(default_factory=threading.Event)

    def start(self) -> None:
        """Settle what the last server left behind, then open the line."""
        self.audit.begin_anchors()
        self.audit_intents.recover()
        self.jobs.start()
        self.transfers.start()
        self.commands.start()
        self.stack_runs.start()
        self.procedure_runs.start()
        self.passes.runner.start()
        self.alarms.start()
        self.notifications.start()
        self.upkeep.retention.start()
        self.upkeep.pages.start()
        self.upkeep.audit.start()
        self.dispatcher.start()
        self.link.start()
        self.status.start()
        self.telemetry.rollups.start()
        if self.settings.device:
            self.link.open_later(self.settings.device)

    def announce_stop(self) -> None:
        """Interrupt the jobs and end the open streams and the parsing of files, so that the server need not cut them off. Runs in
        a signal handler: storing the jobs' state may wait for the database, so that a thread does it."""
        if not self.stopping.is_set():
            threading.Thread(target=self.jobs.interrupt, name="interrupt jobs", daemon=True).start()
        self.stopping.set()
        self.bus.wake_all()
        self.parsing.stop()

    def stop(self) -> None:
        """Close the line first, so that nothing new comes; then end what still works."""
        self.announce_stop()
        self.status.stop()
        self.notifications.stop()
        self.upkeep.audit.stop()
        self.stack_runs.shut_down()
        self.procedure_runs.shut_down()
        self.link.stop()
        self.dispatcher.stop()
        self.transfers.stop()
        self.capture_replay.stop()
        self.replay.stop()
        self.frames.stop()
        self.jobs.stop()
        self.telemetry.rollups.stop()
        self.executor.stop()
        self.audit_intents.close()
        self.accounts.close()
        self.database.close()
