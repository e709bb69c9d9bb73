"""Flash banks for catalogues and tables, as reported by the device, addressed by (kind, bank)."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gss.device.session_events import DeviceEvent, HelloReceived
from gss.domain.errors import Conflict
from gss.instruments.operations import BANK, BANK_OPERATIONS, TABLE_OPERATIONS, Operation, StandardOperations
from gss.instruments.roles import Roles
from gss.instruments.telemetry_roles import BankInfo, Quantities
from gss.operations.commanding.command_record import CommandCompleted
from gss.operations.line.line_events import LineEvent
from gss.operations.line.link import LinkService

CATALOGUE = "catalogue"
CATALOGUE_PARTS = (CATALOGUE, "star_list", "distance_table")
"""Kinds of content in a catalogue bank."""
FACTORY = "factory"
HOLDS_DATA = ("loaded", "committed")


@dataclass(frozen=True)
class BankFamily:
    """Banks with the same messages. ``query``: operation that requests their reports; ``verify``: operation whose
    argument defines their numbers; ``changes``: operations after which the reports can be out of date."""

    query: Operation
    verify: Operation
    changes: tuple[Operation, ...]

    def report(self, quantities: Quantities) -> BankInfo:
        """Return the quantities with which the instrument reports these banks."""
        return quantities.bank if self.query is Operation.LIST_BANKS else quantities.table

    def may_have_changed(self, event: LineEvent, roles: Roles) -> bool:
        """True if an event can mean that the banks have changed without a report."""
        if isinstance(event, CommandCompleted):
            return roles.operations.of_command(event.name, event.arguments) in self.changes
        fell_back = roles.events.bank_fell_back if self.query is Operation.LIST_BANKS else roles.events.table_fell_back
        return isinstance(event, DeviceEvent) and event.name == fell_back

    def number(self, operations: StandardOperations, bank: str) -> int:
        """Return the number of a bank in the protocol. Raises BadInput with the list of banks."""
        command = operations.dictionary.command(operations.command(self.verify))
        return command.argument(operations.argument(self.verify, BANK)).choice(bank).value


CATALOGUES = BankFamily(Operation.LIST_BANKS, Operation.VERIFY, BANK_OPERATIONS[1:])
TABLES = BankFamily(Operation.LIST_TABLES, Operation.VERIFY_TABLE, TABLE_OPERATIONS[1:])
FAMILIES = (CATALOGUES, TABLES)


def family_of(kind: str) -> BankFamily:
    """Return the family of banks that contain a kind of content."""
    return CATALOGUES if kind in CATALOGUE_PARTS else TABLES


@dataclass(frozen=True)
class BankReport:
    """A bank as reported by the device. ``sha256``: hash of its content, "" if it is empty; ``values``: the complete
    packet."""

    kind: str
    bank: str
    state: str
    active: bool
    sha256: str
    values: Mapping[str, Any]

    @property
    def holds_data(self) -> bool:
        """True if the bank is not empty."""
        return self.state in HOLDS_DATA


class FlashBanks:
    """Stores the latest report of each bank."""

    def __init__(self, link: LinkService) -> None:
        self._link = link
        self._reports: dict[tuple[str, str], BankReport] = {}
        self._lock = threading.Lock()

    def forget(self) -> None:
        """Discard all reports, because the device restarted."""
        with self._lock:
            self._reports.clear()

    def take(self, values: Mapping[str, Any]) -> BankReport:
        """Store a report and return it. ``values``: values by standard quantity."""
        kind, bank, state = str(values.get("table", CATALOGUE)), str(values["bank"]), str(values["state"])
        sha256 = _hex(values["sha256"]) if state in HOLDS_DATA else ""
        report = BankReport(kind, bank, state, bool(values["active"]), sha256, values)
        with self._lock:
            self._reports[kind, bank] = report
        return report

    def of(self, family: BankFamily) -> list[BankReport]:
        """Return the reports of a family of banks, in order of their first report."""
        with self._lock:
            return [report for report in self._reports.values() if family_of(report.kind) is family]

    def target(self, kind: str, bank: str) -> tuple[int, HelloReceived]:
        """Return the number of an inactive bank for an upload, and the device. Raises Conflict if no device has
        answered or the bank is active, and BadInput if the bank does not exist."""
        hello = self._link.hello
        if hello is None:
            raise Conflict("no device has answered", got=self._link.reason or "silence", hint="open the link first")
        number = family_of(kind).number(self._link.roles.operations, bank)
        with self._lock:
            report = self._reports.get((kind, bank))
        if report is not None and report.active:
            name = f"bank {bank}" if kind == CATALOGUE else f"{kind} bank {bank}"
            hint = "Activate another bank first."
            raise Conflict(f"{name} is active", expected="an inactive bank", got=bank, hint=hint)
        return number, hello


def _hex(value: Any) -> str:
    text = value.hex() if isinstance(value, bytes) else str(value or "")
    return "" if set(text) <= {"0"} else text
