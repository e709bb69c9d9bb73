"""Device tables: their reports, content read back, and the end of an upload."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gss.device.session_events import DeviceEvent, Direction, HelloReceived, Telemetry
from gss.operations.commanding.command_record import CommandCompleted
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch, LineEvent
from gss.operations.transfers.arrivals import Writer
from gss.operations.transfers.content_events import ContentArrived, Later
from gss.operations.transfers.device_tables import FACTORY, READ_BACK, DeviceTableService
from gss.operations.transfers.table_content import KINDS
from gss.operations.transfers.transfers import TransferService


class TableIntake:
    """Maintains the ground's view of the tables on board."""

    def __init__(
        self,
        tables: DeviceTableService,
        transfers: TransferService,
        commands: CommandService,
        writer: Writer,
        bus: EventBus,
    ) -> None:
        self._tables, self._transfers, self._commands = tables, transfers, commands
        self._writer, self._bus = writer, bus

    def handle(self, batch: LineBatch) -> None:
        """Process HELLO reports, table reports, completed commands and arrived content."""
        for event in batch.events:
            if isinstance(event, HelloReceived):
                self._tables.forget()
                if event.dictionary_match:
                    self._commands.query("LIST_TABLES")
            elif isinstance(event, Telemetry) and event.packet == "table_info":
                self._reported(event.values)
            elif _may_have_changed(event):
                self._commands.query("LIST_TABLES")
            elif isinstance(event, ContentArrived):
                self._arrived(event)

    def _reported(self, info: Mapping[str, Any]) -> None:
        if self._tables.told(info):
            # The factory table was not uploaded, even if an upload has the same bytes.
            sha256 = info["sha256"].hex() if isinstance(info["sha256"], bytes) else str(info["sha256"])
            self._transfers.in_use(str(info["table"]), "" if str(info["bank"]) == FACTORY else sha256)

    def _arrived(self, event: ContentArrived) -> None:
        transfer, done = event.transfer, event.done
        if done.direction is Direction.DOWN and done.kind in READ_BACK:
            event.answers.accept(
                lambda: Later(
                    self._writer.submit, lambda: self._tables.keep_read_back(transfer, done), lambda links: links
                )
            )
        elif done.direction is Direction.UP and done.kind in KINDS:
            text = f"{transfer.subject} is committed"
            self._bus.record("catalogue", "ok", text, transfer_id=transfer.id, table_id=transfer.table_id)
            self._commands.query("LIST_TABLES")


def _may_have_changed(event: LineEvent) -> bool:
    """True if the device's tables may have changed without a report of it."""
    if isinstance(event, CommandCompleted):
        return event.name.endswith("_TABLE")
    return isinstance(event, DeviceEvent) and event.name == "TABLE_FELL_BACK"
