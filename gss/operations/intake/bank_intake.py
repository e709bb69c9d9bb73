"""Intake of flash bank data (catalogues and tables): bank reports, content that was read back, and completed uploads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gss.device.session_events import Direction, HelloReceived, Telemetry
from gss.domain.errors import GssError
from gss.instruments.operations import Operation
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.transfers.arrivals import ContentArrived, Later, Links, Writer
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.device_tables import READ_BACK, DeviceTableService
from gss.operations.transfers.flash_banks import CATALOGUE, CATALOGUES, FACTORY, FAMILIES, FlashBanks, family_of
from gss.operations.transfers.table_content import KINDS
from gss.operations.transfers.transfers import TransferService


class BankIntake:
    """Updates the ground's information about the banks. If the ground does not have the content of the active catalogue, it is
    read back."""

    def __init__(
        self,
        link: LinkService,
        flash: FlashBanks,
        banks: BankService,
        tables: DeviceTableService,
        transfers: TransferService,
        commands: CommandService,
        writer: Writer,
        bus: EventBus,
    ) -> None:
        self._link, self._flash, self._banks, self._tables = link, flash, banks, tables
        self._transfers, self._commands, self._writer, self._bus = transfers, commands, writer, bus

    def handle(self, batch: LineBatch) -> None:
        """Process HELLO reports, bank reports, completed commands and received content."""
        roles = self._link.roles
        reports = (family.report(roles.quantities) for family in FAMILIES)
        packets = {report.packet: report for report in reports}
        for event in batch.events:
            if isinstance(event, HelloReceived):
                self._flash.forget()
                if event.dictionary_match:
                    # Housekeeping names the active bank.
                    self._query(CATALOGUES.query, Operation.GET_STATUS, *(f.query for f in FAMILIES[1:]))
            elif isinstance(event, Telemetry) and event.packet in packets:
                self._reported(packets[event.packet].read(event.values))
            elif isinstance(event, ContentArrived):
                self._arrived(event)
            else:
                self._query(*(family.query for family in FAMILIES if family.may_have_changed(event, roles)))

    def _query(self, *queries: Operation) -> None:
        """Send the queries that the sensor supports."""
        operations = self._link.roles.operations
        self._commands.query(*(operations.command(query) for query in queries if operations.has(query)))

    def _reported(self, values: Mapping[str, Any]) -> None:
        report = self._flash.take(values)
        if family_of(report.kind) is not CATALOGUES:
            self._bus.publish("tables", self._tables.on_board())
        if report.active and report.holds_data:
            # The factory table is never an upload, even if an upload has the same content.
            self._transfers.in_use(report.kind, "" if report.bank == FACTORY else report.sha256)
        can_read = self._link.roles.operations.has(Operation.READ_BACK)
        if can_read and self._banks.lacks(report) and not self._transfers.busy(Direction.DOWN):
            self._read_back(report.bank)

    def _read_back(self, bank: str) -> None:
        try:
            number = CATALOGUES.number(self._link.roles.operations, bank)
            self._transfers.download(CATALOGUE, number, f"content of bank {bank}")
        except GssError as error:
            self._bus.record("transfer", "watch", f"Bank {bank} was not read back: {error}")

    def _arrived(self, event: ContentArrived) -> None:
        transfer, kind = event.transfer, event.done.kind
        if event.done.direction is Direction.DOWN and kind in (CATALOGUE, *READ_BACK):
            event.answers.accept(lambda: Later(self._writer.submit, lambda: self._keep(event), lambda links: links))
        elif event.done.direction is Direction.UP and kind in (CATALOGUE, *KINDS):
            text = f"{transfer.subject} is committed"
            self._bus.record("catalogue", "ok", text, transfer_id=transfer.id, table_id=transfer.table_id)
            self._query(family_of(kind).query)

    def _keep(self, event: ContentArrived) -> Links:
        """Store content that was read back. Return the links from the transfer's row to it."""
        if event.done.kind != CATALOGUE:
            return self._tables.keep_read_back(event.transfer, event.done)
        row = self._banks.adopt(event.done.data)
        return {"catalogue_id": row.id} if row else {}
