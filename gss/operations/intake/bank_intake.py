"""Catalogue banks: their reports, content read back, and the end of an upload."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gss.device.session_events import DeviceEvent, Direction, HelloReceived, Telemetry
from gss.domain.errors import GssError
from gss.operations.commanding.command_record import CommandCompleted
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch, LineEvent
from gss.operations.transfers.arrivals import Writer
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.content_events import ContentArrived, Later
from gss.operations.transfers.transfers import TransferService


class BankIntake:
    """Maintains the ground's view of the banks; an active bank whose content the ground lacks is read back."""

    def __init__(
        self, banks: BankService, transfers: TransferService, commands: CommandService, writer: Writer, bus: EventBus
    ) -> None:
        self._banks, self._transfers, self._commands = banks, transfers, commands
        self._writer, self._bus = writer, bus

    def handle(self, batch: LineBatch) -> None:
        """Process HELLO reports, bank reports, completed commands and arrived content."""
        for event in batch.events:
            if isinstance(event, HelloReceived):
                self._banks.forget()
                if event.dictionary_match:
                    self._commands.query("LIST_BANKS", "GET_STATUS")  # housekeeping names the active bank
            elif isinstance(event, Telemetry) and event.packet == "bank_info":
                self._reported(event.values)
            elif _may_have_changed(event):
                self._commands.query("LIST_BANKS")
            elif isinstance(event, ContentArrived) and event.done.kind == "catalogue":
                self._arrived(event)

    def _reported(self, info: Mapping[str, Any]) -> None:
        unknown = self._banks.told(info)
        if info["active"]:
            sha256 = info["sha256"]
            self._transfers.in_use("catalogue", sha256.hex() if isinstance(sha256, bytes) else str(sha256))
        if unknown is not None and not self._transfers.busy(Direction.DOWN):
            try:
                self._transfers.download("catalogue", unknown, f"content of bank {info['bank']}")
            except GssError as error:
                self._bus.record("transfer", "watch", f"bank {info['bank']} was not read back: {error}")

    def _arrived(self, event: ContentArrived) -> None:
        if event.done.direction is Direction.DOWN:
            event.answers.accept(
                lambda: Later(
                    self._writer.submit,
                    lambda: self._banks.adopt(event.done.data),
                    lambda kept: {"catalogue_id": kept.id} if kept else {},
                )
            )
            return
        text = f"{event.transfer.subject} is committed in bank {event.transfer.target}"
        self._bus.record("catalogue", "ok", text, transfer_id=event.transfer.id)
        self._commands.query("LIST_BANKS")


def _may_have_changed(event: LineEvent) -> bool:
    """True if the device's banks may have changed without a report of it."""
    if isinstance(event, CommandCompleted):
        return event.name.endswith("_BANK")
    return isinstance(event, DeviceEvent) and event.name == "BANK_FELL_BACK"
