"""Handlers of the catalogue bank commands: list, verify, activate on trial, confirm, roll back, erase."""

from __future__ import annotations

from collections.abc import Generator

import numpy as np

from gss.device.simulator.command_processor import Arguments, Handler, Returns, Task
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.loader import Loader
from gss.device.simulator.memory import BANKS, GOLDEN, Memory
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.reports import Report
from gss.instruments.package_files import UnitTiming


class BankHandlers:
    """Handlers of the bank commands. An activated bank is on trial until CONFIRM_BANK; a timeout or a reset ends the
    trial."""

    def __init__(
        self, memory: Memory, tracker: StarTracker, loader: Loader, outbox: Outbox, timing: UnitTiming
    ) -> None:
        self._timing = timing
        self._memory, self._tracker, self._loader, self._outbox = memory, tracker, loader, outbox
        self._confirm_by_s: float | None = None
        self._now_s = 0.0

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers by command name."""
        return {
            "LIST_BANKS": self.list_banks,
            "VERIFY_BANK": self.verify_bank,
            "ACTIVATE_BANK": self.activate_bank,
            "CONFIRM_BANK": self.confirm_bank,
            "ROLLBACK_BANK": self.rollback_bank,
            "ERASE_BANK": self.erase_bank,
        }

    def restart(self) -> None:
        """Restart after a reset: end a trial and load the catalogue of the active bank."""
        self._confirm_by_s = None
        record = self._memory.record
        if record.unconfirmed:
            lost, active = record.active, self._memory.fall_back()
            self._outbox.event("BANK_FELL_BACK", f"bank {lost} was not confirmed before the reset; {active} is active")
        self._tracker.restart()
        self._report_problem(0)

    def advance(self, now_s: float) -> None:
        """Advance the time; a trial can end."""
        self._now_s = now_s
        if self._confirm_by_s is not None and now_s >= self._confirm_by_s:
            self._fall_back("was not confirmed in time", 0)

    @property
    def confirm_left_s(self) -> int:
        """Remaining time of a trial in whole seconds, 0 without a trial."""
        return max(0, int(np.ceil(self._confirm_by_s - self._now_s))) if self._confirm_by_s is not None else 0

    def _report_problem(self, request_id: int) -> None:
        problem = self._tracker.load_catalogue()
        if problem:
            self._outbox.event("BANK_CORRUPT", problem, request_id)

    def _bank_report(self, bank: str) -> Report:
        content, record = self._memory.record.banks[bank], self._memory.record
        values: Returns = {
            "bank": bank,
            "state": content.state,
            "active": record.active == bank,
            "write_protected": bank == GOLDEN,
            "size_bytes": content.size,
            "capacity_bytes": self._memory.bank_bytes,
            "stars": content.stars,
            "pairs": content.pairs,
            "epoch_jyear": content.epoch_jyear,
            "format_version": content.format_version,
            "profile": content.profile,
            "sha256": bytes.fromhex(content.sha256) if content.sha256 else bytes(32),
        }
        return "bank_info", values, {}

    def _report_banks(self, request_id: int, *banks: str) -> None:
        for bank in banks:
            self._outbox.telemetry(self._bank_report(bank), request_id)

    def list_banks(self, _: Arguments, request_id: int) -> Returns:
        self._report_banks(request_id, *BANKS)
        return {"count": len(BANKS)}

    def _read_back(self, bank: str, request_id: int) -> Generator[float, None, str]:
        """Read the bank and return its SHA-256. A bank that does not match its record becomes corrupt."""
        content = self._memory.record.banks[bank]
        if content.state not in ("committed", "corrupt"):
            raise Rejection("bank_empty", f"bank {bank} is {content.state}")
        with self._loader.reserved(bank):
            yield content.size / self._timing.flash_read_bytes_s
        digest = self._memory.hash_of(bank)
        state = "committed" if digest == content.sha256 else "corrupt"
        if state != content.state:
            self._memory.set_state(bank, state)
        if state == "corrupt":
            text = f"bank {bank} has the hash {digest[:12]}, expected {content.sha256[:12]}"
            self._outbox.event("BANK_CORRUPT", text, request_id)
            self._report_banks(request_id, bank)
            raise Rejection("bank_corrupt", f"bank {bank} does not match its checksum")
        return digest

    def verify_bank(self, arguments: Arguments, request_id: int) -> Task:
        digest = yield from self._read_back(str(arguments["bank"]), request_id)
        self._report_banks(request_id, str(arguments["bank"]))
        return {"sha256": bytes.fromhex(digest)}

    def activate_bank(self, arguments: Arguments, request_id: int) -> Task:
        bank, record, trial_s = str(arguments["bank"]), self._memory.record, int(arguments["confirm_within_s"])
        if bank == record.active:
            raise Rejection("bank_active", f"bank {bank} is already active")
        if record.unconfirmed:
            raise Rejection("wrong_state", f"bank {record.active} is waiting for CONFIRM_BANK")
        yield from self._read_back(bank, request_id)
        if record.banks[bank].profile != self._tracker.profile.name:
            raise Rejection("incompatible", f"bank {bank} is for {record.banks[bank].profile}")
        if problem := self._tracker.unsuitable(bank):
            raise Rejection("incompatible", f"bank {bank}: {problem}")
        self._memory.activate(bank)
        self._confirm_by_s = self._now_s + trial_s
        self._outbox.event("BANK_ACTIVATED", f"bank {bank}; confirm within {trial_s} s", request_id)
        self._report_problem(request_id)
        self._report_banks(request_id, record.previous, bank)
        return {}

    def confirm_bank(self, arguments: Arguments, request_id: int) -> Returns:
        record = self._memory.record
        if arguments["bank"] != record.active:
            raise Rejection("wrong_state", f"bank {record.active} is active")
        if record.unconfirmed:
            self._memory.confirm()
            self._confirm_by_s = None
            self._outbox.event("BANK_CONFIRMED", f"bank {record.active}", request_id)
        self._report_banks(request_id, record.active)
        return {}

    def _fall_back(self, why: str, request_id: int) -> None:
        self._confirm_by_s = None
        lost = self._memory.record.active
        active = self._memory.fall_back()
        self._outbox.event("BANK_FELL_BACK", f"bank {lost} {why}; {active} is active", request_id)
        self._report_problem(request_id)
        self._report_banks(request_id, lost, active)

    def rollback_bank(self, _: Arguments, request_id: int) -> Returns:
        if self._memory.record.previous == self._memory.record.active:
            raise Rejection("wrong_state", "there is no previous bank")
        self._fall_back("was rolled back", request_id)
        return {}

    def erase_bank(self, arguments: Arguments, request_id: int) -> Task:
        bank, record = str(arguments["bank"]), self._memory.record
        if bank == GOLDEN:
            raise Rejection("write_protected", "the golden bank cannot be erased")
        if bank == record.active or (record.unconfirmed and bank == record.previous):
            raise Rejection("bank_active", f"bank {bank} is in use")
        if self._loader.busy_with(bank):
            raise Rejection("busy", f"a transfer writes bank {bank}")
        with self._loader.reserved(bank):
            yield self._timing.erase_bank_s
        self._memory.erase_bank(bank)
        self._outbox.event("BANK_ERASED", f"bank {bank}", request_id)
        self._report_banks(request_id, bank)
        return {}
