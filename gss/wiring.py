"""Composition root: creates all services from the settings and connects them. ``rooms`` creates the services of each room."""

from __future__ import annotations

from gss import rooms
from gss.operations.accounts.accounts import open_accounts
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import AnchorFile
from gss.operations.accounts.audit_intents import AuditIntents
from gss.operations.catalogues.build_catalogue import CatalogueService
from gss.operations.catalogues.design import DesignService
from gss.operations.catalogues.star_lists import StarListService
from gss.operations.clock import MACHINE_CLOCK, Clock, monotonic_s, utc_now
from gss.operations.commanding.command_history import CommandHistory
from gss.operations.contacts.contacts import ContactService
from gss.operations.contacts.replay_capture import CaptureReplay
from gss.operations.frames.place import PlaceService
from gss.operations.frames.rerun_viewer import RerunViewer
from gss.operations.instruments.packages import InstrumentService
from gss.operations.intake.uploaded_images import UploadedImages
from gss.operations.line.capture_packing import CapturePacking
from gss.operations.line.dispatcher import Dispatcher, LineEventQueue
from gss.operations.line.line_capture import CaptureSync
from gss.operations.line.link import OpenLine
from gss.operations.metrics import StreamCounts
from gss.operations.notifications.notifications import NotificationService
from gss.operations.notifications.rules_file import read_rules
from gss.operations.notifications.senders import Sender
from gss.operations.passes.room import open_passes
from gss.operations.recordings.live import LiveRecordings
from gss.operations.recordings.scope import Scopes
from gss.operations.recordings.stored import Recordings
from gss.operations.studies.analyses import AnalysisService
from gss.operations.studies.calibrations import CalibrationService
from gss.operations.studies.campaigns import CampaignService
from gss.operations.studies.dask_executor import make_executor
from gss.operations.studies.list_runs import ListRunService
from gss.operations.studies.night_frames import StoredShots
from gss.operations.studies.reprocess import WORKERS, ReprocessService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.derived_history import DerivedHistory
from gss.operations.telemetry.last_attitude import LastAttitude
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.transfers.downloads import Downloads
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.retention import RetentionService
from gss.services import Services
from gss.settings import Settings
from gss.store.engine import Database, open_engine


def build(
    settings: Settings, *, ready: bool = False, clock: Clock = MACHINE_CLOCK, open_line: OpenLine | None = None
) -> Services:
    """Create and connect all services without starting them. The database schema is upgraded unless ``ready`` is true: API
    workers use the schema that the link process has upgraded. ``clock``: mission time. ``open_line``: opens every line instead
    of the real ports."""
    base, now = rooms.open_base(settings, clock, ready=ready), clock.now
    database, bus, jobs, stars = base.database, base.bus, base.jobs, base.stars
    events = LineEventQueue(now, clock.monotonic_s)
    link = rooms.open_link(base, events, open_line)
    shared = Database(open_engine(settings.accounts)) if settings.accounts else database
    accounts = open_accounts(shared, settings, utc_now, monotonic_s)
    audit = AuditService(database, utc_now, AnchorFile(settings.audit_anchor_file))
    commanding = rooms.open_commanding(base, link, accounts)
    telemetry = TelemetryService(
        base.dictionary, database, bus, now, lambda: link.contact_id, base.disk.has_room_for_rows
    )
    attitude = LastAttitude(base.unit.roles.quantities.attitude, clock.monotonic_s)
    procedures = rooms.open_procedures(base, link, commanding.commands, telemetry)
    alarms = AlarmService(telemetry.derived, telemetry, link, database, bus, now)
    transfers = rooms.open_transfers(base, link, commanding.schedule)
    frames = rooms.open_frames(base, transfers)
    images = UploadedImages(link, commanding.commands, transfers.transfers, frames.frames, bus)
    share = settings.retention_share_percent / 100
    removal = RetentionService(database, base.blobs, jobs, bus, link, base.upkeep_lock, utc_now, base.trust, share)
    contacts = ContactService(link, alarms, database, bus, base.captures, now, removal.removed_before)
    dispatcher = Dispatcher(
        events,
        bus,
        monotonic_s,
        subscribers=[
            link.handle,
            telemetry.handle,
            attitude.handle,
            commanding.commands.handle,
            transfers.progress.handle,
            *rooms.open_intake(base, link, telemetry, commanding, transfers, frames, images),
            images.handle,
            transfers.bank_history.handle,
            alarms.handle,
            contacts.handle,
            commanding.schedule.handle,
            commanding.stack_runs.handle,
            procedures.runs.handle,
        ],
        periodic=[
            transfers.progress.finalise,
            CaptureSync(link.capture, monotonic_s),
            CapturePacking(link.capture, monotonic_s),
        ],
    )
    star_lists = StarListService(database, base.blobs, now, base.parsing, base.instruments)
    catalogues = CatalogueService(
        database,
        base.blobs,
        jobs,
        transfers.transfers,
        transfers.flash,
        link,
        star_lists,
        stars,
        now,
        base.instruments,
        base.unit.name,
    )
    downloads = Downloads(link, transfers.transfers, frames.frames)
    passes = open_passes(
        database,
        bus,
        now,
        link,
        commanding.commands,
        procedures.procedures,
        procedures.runs,
        commanding.stacks,
        commanding.stack_runs,
        downloads,
        transfers.transfers,
        catalogues,
        accounts.require,
    )
    shots = StoredShots(database, frames.frames)
    executor = make_executor(settings.cluster, WORKERS)
    place = PlaceService(
        base.unit.roles.operations,
        database,
        transfers.bank_history,
        commanding.schedule.clock,
        passes.spacecraft.orbit_at,
    )
    recordings = Recordings(database, frames.frames, stars, place.at)
    streams = StreamCounts()
    clocks = ClockWatch(bus, now, clock.monotonic_s, [alarms.clock_jumped, commanding.schedule.clock_jumped])
    upkeep = rooms.open_upkeep(
        base, link, telemetry, frames.frames, transfers.writer, removal, clocks, dispatcher, streams, alarms, audit
    )
    notifications = NotificationService(
        read_rules(settings.notifications), alarms, bus, database, now, Sender(settings.notifications_private).send
    )
    return Services(
        settings=settings,
        clock=clock,
        instruments=base.instruments,
        packages=InstrumentService(base.instruments, base.unit, database, base.parsing, link, bus),
        stars=stars,
        bus=bus,
        link=link,
        commands=commanding.commands,
        telemetry=telemetry,
        derived_history=DerivedHistory(telemetry.derived, database, jobs, now),
        transfers=transfers.transfers,
        frames=frames.frames,
        banks=transfers.banks,
        bank_history=transfers.bank_history,
        star_lists=star_lists,
        catalogues=catalogues,
        jobs=jobs,
        status=rooms.open_status(
            base, link, telemetry, alarms, commanding.authority, attitude, transfers, removal, clocks, passes, place
        ),
        viewer=RerunViewer(settings.data / "rerun-viewer"),
        database=database,
        replay=frames.replay,
        alarms=alarms,
        notifications=notifications,
        downloads=downloads,
        tables=transfers.tables,
        images=images,
        authority=commanding.authority,
        history=CommandHistory(database),
        schedule=commanding.schedule,
        stacks=commanding.stacks,
        stack_runs=commanding.stack_runs,
        procedures=procedures.procedures,
        procedure_runs=procedures.runs,
        campaigns=CampaignService(database, jobs, executor if settings.cluster else None),
        reprocessing=ReprocessService(
            database,
            settings.blobs_url,
            jobs,
            now,
            frames.epoch_jyear,
            executor,
            settings.solve_chain,
            frames.book,
            base.instruments,
        ),
        list_runs=ListRunService(
            database, base.blobs, jobs, base.parsing, frames.book, executor, now, frames.epoch_jyear
        ),
        executor=executor,
        contacts=contacts,
        passes=passes,
        dispatcher=dispatcher,
        writer=transfers.writer,
        capture_replay=CaptureReplay(base.dictionary, base.captures, telemetry.limits, bus, monotonic_s, base.framing),
        design=DesignService(jobs, stars, base.instruments, base.unit.name),
        calibrations=CalibrationService(
            database,
            jobs,
            shots,
            frames.solver,
            frames.book,
            transfers.tables,
            bus,
            now,
            frames.darks,
            base.instruments,
        ),
        analyses=AnalysisService(
            database, jobs, shots, frames.solver, frames.book, contacts, passes.spacecraft.orbit_at, bus, now
        ),
        accounts=accounts,
        audit=audit,
        audit_intents=AuditIntents(settings.data / "audit-intents", audit),
        upkeep=upkeep,
        streams=streams,
        parsing=base.parsing,
        place=place,
        scopes=Scopes(database, now),
        recordings=recordings,
        live_recordings=LiveRecordings(recordings, database, bus, now),
    )
