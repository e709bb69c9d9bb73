"""Handlers of the table commands. Triplets, calibration and parameters have the same life cycle as catalogue banks."""

from __future__ import annotations

import numpy as np

from gss.device.simulator.command_processor import Arguments, Handler, Returns, Task
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.flash_record import area_name
from gss.device.simulator.loader import Loader
from gss.device.simulator.memory import FACTORY, TABLE_BANKS, TABLES, Memory
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.reports import Report
from gss.instruments.package_files import UnitTiming


class TableHandlers:
    """Handlers of the table commands. An activated table is on trial until CONFIRM_TABLE; a timeout or a reset ends the
    trial."""

    def __init__(
        self, memory: Memory, tracker: StarTracker, loader: Loader, outbox: Outbox, timing: UnitTiming
    ) -> None:
        self._timing = timing
        self._memory, self._tracker, self._loader, self._outbox = memory, tracker, loader, outbox
        self._confirm_by_s: dict[str, float] = {}
        self._now_s = 0.0

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers by command name."""
        return {
            "LIST_TABLES": self.list_tables,
            "VERIFY_TABLE": self.verify_table,
            "ACTIVATE_TABLE": self.activate_table,
            "CONFIRM_TABLE": self.confirm_table,
            "ROLLBACK_TABLE": self.rollback_table,
            "ERASE_TABLE": self.erase_table,
        }

    def restart(self) -> None:
        """End all trials after a reset. The caller reads the tables afterwards."""
        self._confirm_by_s.clear()
        for table, used in list(self._memory.record.tables.items()):
            if used.unconfirmed:
                active = self._memory.fall_back_table(table)
                text = f"{table} {used.active} was not confirmed before the reset; {active} is active"
                self._outbox.event("TABLE_FELL_BACK", text)

    def advance(self, now_s: float) -> None:
        """Advance the time; trials can end."""
        self._now_s = now_s
        for table in [t for t, by_s in self._confirm_by_s.items() if now_s >= by_s]:
            self._fall_back(table, "was not confirmed in time", 0)

    def _left_s(self, table: str) -> int:
        by_s = self._confirm_by_s.get(table)
        return max(0, int(np.ceil(by_s - self._now_s))) if by_s is not None else 0

    def _read(self, request_id: int) -> None:
        """Load the active tables into the tracker."""
        for problem in self._tracker.load_tables():
            self._outbox.event("TABLE_CORRUPT", problem, request_id)

    def _report(self, table: str, bank: str) -> Report:
        area, active = area_name(table, bank), self._memory.record.tables[table].active == bank
        content = self._memory.record.banks[area]
        values: Returns = {
            "table": table,
            "bank": bank,
            "state": content.state,
            "active": active,
            "size_bytes": content.size,
            "capacity_bytes": self._memory.capacity(area),
            "format_version": content.format_version,
            "profile": content.profile,
            "confirm_left_s": self._left_s(table) if active else 0,
            "sha256": bytes.fromhex(content.sha256) if content.sha256 else bytes(32),
        }
        return "table_info", values, {}

    def _report_status(self, request_id: int, table: str, *banks: str) -> None:
        for bank in banks:
            self._outbox.telemetry(self._report(table, bank), request_id)

    def list_tables(self, _: Arguments, request_id: int) -> Returns:
        for table in TABLES:
            self._report_status(request_id, table, *TABLE_BANKS)
        return {"count": len(TABLES) * len(TABLE_BANKS)}

    def _read_back(self, table: str, bank: str, request_id: int) -> Task:
        """Read the bank and return its SHA-256. A table that does not match its record becomes corrupt."""
        area = area_name(table, bank)
        content = self._memory.record.banks[area]
        if content.state not in ("committed", "corrupt"):
            raise Rejection("bank_empty", f"{table} {bank} is {content.state}")
        with self._loader.reserved(area):
            yield content.size / self._timing.flash_read_bytes_s
        digest = self._memory.hash_of(area)
        state = "committed" if digest == content.sha256 else "corrupt"
        if state != content.state:
            self._memory.set_state(area, state)
        self._report_status(request_id, table, bank)
        if state == "corrupt":
            text = f"{table} {bank} has the hash {digest[:12]}, expected {content.sha256[:12]}"
            self._outbox.event("TABLE_CORRUPT", text, request_id)
            raise Rejection("bank_corrupt", f"{table} {bank} does not match its checksum")
        return {"sha256": bytes.fromhex(digest)}

    def verify_table(self, arguments: Arguments, request_id: int) -> Task:
        return (yield from self._read_back(str(arguments["table"]), str(arguments["bank"]), request_id))

    def activate_table(self, arguments: Arguments, request_id: int) -> Task:
        table, bank, trial_s = str(arguments["table"]), str(arguments["bank"]), int(arguments["confirm_within_s"])
        used = self._memory.record.tables[table]
        if bank == used.active:
            raise Rejection("bank_active", f"{table} {bank} is already active")
        if used.unconfirmed:
            raise Rejection("wrong_state", f"{table} {used.active} is waiting for CONFIRM_TABLE")
        yield from self._read_back(table, bank, request_id)
        content = self._memory.record.banks[area_name(table, bank)]
        if content.profile != self._tracker.profile.name:
            raise Rejection("incompatible", f"{table} {bank} is for {content.profile}")
        self._memory.activate_table(table, bank)
        self._confirm_by_s[table] = self._now_s + trial_s
        self._outbox.event("TABLE_ACTIVATED", f"{table} {bank}; confirm within {trial_s} s", request_id)
        self._read(request_id)
        self._report_status(request_id, table, used.active, bank)
        return {}

    def confirm_table(self, arguments: Arguments, request_id: int) -> Returns:
        table = str(arguments["table"])
        used = self._memory.record.tables[table]
        if used.unconfirmed:
            self._memory.confirm_table(table)
            self._confirm_by_s.pop(table, None)
            self._outbox.event("TABLE_CONFIRMED", f"{table} {used.active}", request_id)
        self._report_status(request_id, table, used.active)
        return {}

    def _fall_back(self, table: str, why: str, request_id: int) -> None:
        self._confirm_by_s.pop(table, None)
        lost = self._memory.record.tables[table].active
        active = self._memory.fall_back_table(table)
        self._outbox.event("TABLE_FELL_BACK", f"{table} {lost} {why}; {active} is active", request_id)
        self._read(request_id)
        self._report_status(request_id, table, lost, active)

    def rollback_table(self, arguments: Arguments, request_id: int) -> Returns:
        table = str(arguments["table"])
        used = self._memory.record.tables[table]
        if used.previous == used.active:
            raise Rejection("wrong_state", f"there is no previous {table} table")
        self._fall_back(table, "was rolled back", request_id)
        return {}

    def erase_table(self, arguments: Arguments, request_id: int) -> Task:
        table, bank = str(arguments["table"]), str(arguments["bank"])
        used, area = self._memory.record.tables[table], area_name(table, bank)
        if bank == FACTORY:
            raise Rejection("write_protected", "the factory tables cannot be erased")
        if bank == used.active or (used.unconfirmed and bank == used.previous):
            raise Rejection("bank_active", f"{table} {bank} is in use")
        if self._loader.busy_with(area):
            raise Rejection("busy", f"a transfer writes {table} {bank}")
        with self._loader.reserved(area):
            yield self._timing.erase_table_s
        self._memory.erase_bank(area)
        self._outbox.event("TABLE_ERASED", f"{table} {bank}", request_id)
        self._report_status(request_id, table, bank)
        return {}
