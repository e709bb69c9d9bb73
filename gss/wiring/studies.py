"""Services of calibrations, analyses and reprocessing."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.clock import stopwatch_s
from gss.operations.studies.analyses import AnalysisService
from gss.operations.studies.calibrations import CalibrationService
from gss.operations.studies.campaigns import CampaignService
from gss.operations.studies.dask_executor import make_executor
from gss.operations.studies.executor import Executor
from gss.operations.studies.list_runs import ListRunService
from gss.operations.studies.new_instrument import NewInstrumentService
from gss.operations.studies.night_frames import StoredShots
from gss.operations.studies.reprocess import WORKERS, ReprocessService
from gss.wiring.base import BaseServices
from gss.wiring.contacts import Contacts
from gss.wiring.frames import Frames
from gss.wiring.passes import Passes
from gss.wiring.transfers import Transfers


@dataclass(frozen=True)
class Studies:
    """Services that analyse many frames, and the executor of their processes."""

    executor: Executor
    campaigns: CampaignService
    reprocessing: ReprocessService
    list_runs: ListRunService
    calibrations: CalibrationService
    analyses: AnalysisService
    new_instruments: NewInstrumentService


def open_studies(
    base: BaseServices, transfers: Transfers, frames: Frames, contacts: Contacts, passes: Passes
) -> Studies:
    """Create the study services."""
    settings, database, blobs, bus, jobs, now = (
        base.settings,
        base.database,
        base.blobs,
        base.bus,
        base.jobs,
        base.clock.now,
    )
    book, solver, epoch_jyear = frames.book, frames.solver, frames.epoch_jyear
    executor = make_executor(settings.cluster, WORKERS)
    shots = StoredShots(database, frames.frames)
    return Studies(
        executor,
        CampaignService(database, jobs, executor if settings.cluster else None),
        ReprocessService(
            database,
            settings.blobs_url,
            jobs,
            now,
            epoch_jyear,
            executor,
            settings.solve_chain,
            book,
            base.instruments,
        ),
        ListRunService(database, blobs, jobs, base.parsing, book, executor, now, epoch_jyear, base.upkeep_lock),
        CalibrationService(
            database,
            jobs,
            shots,
            solver,
            book,
            transfers.tables,
            bus,
            now,
            frames.darks,
            base.instruments,
        ),
        AnalysisService(database, jobs, shots, solver, book, contacts.contacts, passes.spacecraft.orbit_at, bus, now),
        NewInstrumentService(database, jobs, shots, solver, base.instruments, bus, now, stopwatch_s),
    )
