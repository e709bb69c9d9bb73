"""Services that process data received without a request."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.intake.bank_intake import BankIntake
from gss.operations.intake.frame_intake import FrameIntake
from gss.operations.intake.frame_records import FrameRecords
from gss.operations.intake.result_intake import ResultIntake
from gss.operations.intake.sensor_knowledge import SensorKnowledge
from gss.operations.intake.uploaded_images import UploadedImages
from gss.wiring.base import BaseServices
from gss.wiring.commanding import Commanding
from gss.wiring.frames import Frames
from gss.wiring.line import Line
from gss.wiring.telemetry import TelemetryServices
from gss.wiring.transfers import Transfers


@dataclass(frozen=True)
class Intake:
    """Services that store data which the sensor sends without a request, and the service that uploads images."""

    frames: FrameIntake
    results: ResultIntake
    banks: BankIntake
    images: UploadedImages


def open_intake(
    base: BaseServices,
    line: Line,
    telemetry: TelemetryServices,
    commanding: Commanding,
    transfers: Transfers,
    frames: Frames,
) -> Intake:
    """Create the intake services."""
    bus, link, commands = base.bus, line.link, commanding.commands
    images = UploadedImages(link, commands, transfers.transfers, frames.frames, bus)
    records = FrameRecords(link, transfers.tables, frames.frames, frames.replay)
    knowledge = SensorKnowledge(base.unit.roles.operations)
    return Intake(
        FrameIntake(
            link,
            telemetry.telemetry,
            transfers.transfers,
            frames.frames,
            images,
            records,
            transfers.writer,
            commanding.schedule.clock,
            bus,
            base.clock.now,
            automatic=base.settings.auto_download,
        ),
        ResultIntake(base.unit.roles.quantities, records, transfers.banks, knowledge, base.stars),
        BankIntake(
            link,
            transfers.flash,
            transfers.banks,
            transfers.tables,
            transfers.transfers,
            commands,
            transfers.writer,
            bus,
        ),
        images,
    )
