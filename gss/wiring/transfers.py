"""Services of transfers, banks and tables."""

from __future__ import annotations

from dataclasses import dataclass

from gss.operations.clock import monotonic_s
from gss.operations.transfers.arrivals import Writer
from gss.operations.transfers.bank_history import BankHistoryService
from gss.operations.transfers.bank_plans import activations, uploads
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.device_tables import DeviceTableService
from gss.operations.transfers.flash_banks import FlashBanks
from gss.operations.transfers.transfer_parts import PartStore
from gss.operations.transfers.transfer_progress import TransferProgress
from gss.operations.transfers.transfers import TransferService
from gss.wiring.base import BaseServices
from gss.wiring.commanding import Commanding
from gss.wiring.line import Line


@dataclass(frozen=True)
class Transfers:
    """Services for transfers and for the content of the sensor's flash. ``writer``: thread that stores downloads."""

    writer: Writer
    progress: TransferProgress
    transfers: TransferService
    flash: FlashBanks
    tables: DeviceTableService
    banks: BankService
    bank_history: BankHistoryService


def open_transfers(base: BaseServices, line: Line, commanding: Commanding) -> Transfers:
    """Create the transfer services."""
    database, blobs, bus, stars, now, link = base.database, base.blobs, base.bus, base.stars, base.clock.now, line.link
    writer, parts = Writer(monotonic_s, bus), PartStore(base.settings.data / "parts")
    progress = TransferProgress(link, database, bus, now, parts, writer)
    transfers = TransferService(link, database, bus, now, blobs, parts, writer, progress, base.disk.check)
    flash = FlashBanks(link)
    planners = [uploads(transfers, database), activations(commanding.schedule, base.unit.roles.operations)]
    return Transfers(
        writer,
        progress,
        transfers,
        flash,
        DeviceTableService(link, flash, transfers, database, blobs, bus, stars, now, base.instruments),
        BankService(flash, database, blobs, bus, stars, now, base.instruments),
        BankHistoryService(link, database, now, planners),
    )
