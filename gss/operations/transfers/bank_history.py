"""History and plan of the catalogues in each bank of each device, recorded from the device's reports.

A row is one bank in one state with one content, from the first report of it until a report that differs. Planned content is
derived from uploads in progress and from activations in the device's schedule.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

from gss.device.session_events import (
    CommandUpdate,
    DeviceEvent,
    Direction,
    HelloReceived,
    Stage,
    Telemetry,
    TransferDone,
)
from gss.domain.errors import BadInput, NotFound
from gss.instruments.operations import BANK_OPERATIONS, Operation
from gss.operations.clock import Now
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.store import bank_history as store
from gss.store import catalogues, commands
from gss.store.engine import Database
from gss.store.models import BankHistory, Catalogue, Contact, Device

ACTIVE, TRIAL, HELD, LOADING, EMPTY, DAMAGED = "active", "trial", "held", "loading", "empty", "damaged"
STATE_OF = {"empty": EMPTY, "loading": LOADING, "loaded": LOADING, "committed": HELD, "corrupt": DAMAGED}
SPAN_MAX = timedelta(days=3660)
NAME_LENGTH, HOW_LENGTH = 60, 20


@dataclass(frozen=True)
class BankPeriod:
    """A row of the history with the catalogue of the same hash, if the ground has it."""

    row: BankHistory
    catalogue: Catalogue | None


@dataclass(frozen=True)
class Planned:
    """Planned content of a bank. ``kind``: upload or activation; ``at`` None: as soon as it has arrived."""

    bank: str
    kind: str
    at: datetime | None
    sha256: str
    name: str
    catalogue_id: int | None
    valid_from: datetime | None
    valid_to: datetime | None
    text: str


@dataclass(frozen=True)
class Timeline:
    """The banks of one device over a span, and the contacts with it."""

    device: Device
    devices: Sequence[Device]
    start: datetime
    end: datetime
    stays: Sequence[BankPeriod]
    planned: Sequence[Planned]
    contacts: Sequence[Contact]


Planner = Callable[[Mapping[str, BankPeriod]], list[Planned]]


class BankHistoryService:
    """Records the device's reports; readable from any thread. ``planners`` return the planned content, given the current
    one."""

    def __init__(self, link: LinkService, database: Database, now: Now, planners: Sequence[Planner]) -> None:
        self._link, self._database, self._now = link, database, now
        self._device_id: int | None = None
        self._trial = False
        self._cause = ("", "")
        self._lock = threading.Lock()
        self._planners = planners

    # --- reports from the device --------------------------------------------------------------------------------

    def handle(self, batch: LineBatch) -> None:
        """Process the events of a batch in order."""
        roles = self._link.roles
        for event in batch.events:
            if isinstance(event, HelloReceived):
                self._met()
            elif isinstance(event, Telemetry) and event.packet == roles.quantities.bank.packet:
                self._update_from_report(roles.quantities.bank.read(event.values))
            elif isinstance(event, Telemetry) and event.packet == roles.quantities.status.packet:
                left_s = roles.quantities.status.read(event.values).get("confirm_left_s")
                self._tried(isinstance(left_s, int | float) and left_s > 0, "confirmed")
            elif isinstance(event, DeviceEvent):
                self._happened(event)
            elif isinstance(event, TransferDone) and event.direction is Direction.UP and event.kind == "catalogue":
                self._cause = ("upload", "")
            elif isinstance(event, CommandUpdate) and event.stage is Stage.COMPLETED:
                self._completed(event)

    def _met(self) -> None:
        contact_id = self._link.contact_id
        with self._database.unit_of_work() as session:
            device_id = None if contact_id is None else store.device_of_contact(session, contact_id)
        with self._lock:
            self._device_id, self._trial, self._cause = device_id, False, ("", "")

    def _happened(self, event: DeviceEvent) -> None:
        events, operations = self._link.roles.events, self._link.roles.operations
        if event.name == events.bank_fell_back:
            self._cause = ("fell back", "")
            self._tried(False, "fell back")
        elif event.name == events.bank_activated:
            self._cause, self._trial = (operations.title(Operation.ACTIVATE), self._who(event.request_id)), True
        elif event.name == events.bank_confirmed:
            self._cause = (operations.title(Operation.CONFIRM), self._who(event.request_id))
            self._tried(False, operations.title(Operation.CONFIRM))

    def _who(self, request_id: int) -> str:
        with self._database.unit_of_work() as session:
            row = commands.by_request(session, request_id) if request_id else None
        return row.user if row else self._cause[1]

    def _completed(self, event: CommandUpdate) -> None:
        """Remember the command as the cause of the next reports."""
        operation = self._link.roles.operations.of_command(event.name)
        if operation is Operation.LIST_BANKS:
            self._cause = ("", "")
        elif operation in BANK_OPERATIONS:
            self._cause = (event.name, self._who(event.request_id))
            if operation is Operation.CONFIRM:
                self._tried(False, event.name)
            elif operation is Operation.ACTIVATE:
                self._trial = True

    def _tried(self, trial: bool, source: str) -> None:
        """Switch the active bank between trial and active, because bank reports do not say which one it is."""
        if trial == self._trial or self._device_id is None:
            return
        self._trial = trial
        with self._lock, self._database.unit_of_work() as session:
            for row in store.still_so(session, self._device_id):
                if row.state == (ACTIVE if trial else TRIAL) and source != "fell back":
                    again = {"bank": row.bank, "state": TRIAL if trial else ACTIVE, "sha256": row.sha256}
                    activate = self._link.roles.operations.title(Operation.ACTIVATE)
                    cause = (activate if trial else source, self._cause[1])
                    store.add(session, self._next(row, **again, cause=cause))

    def _update_from_report(self, info: Mapping[str, Any]) -> None:
        if self._device_id is None:
            return
        bank, word = str(info["bank"]), str(info["state"])
        occupied = word in ("loaded", "committed")
        sha256 = _hex(info.get("sha256")) if occupied else ""
        state = STATE_OF.get(word, word)
        if occupied and info["active"]:
            state = TRIAL if self._trial else ACTIVE
        with self._lock, self._database.unit_of_work() as session:
            rows = {row.bank: row for row in store.still_so(session, self._device_id)}
            row = rows.get(bank)
            if row is not None and (row.state, row.sha256) == (state, sha256):
                row.told = self._now()
                return
            added = self._next(row, bank=bank, state=state, sha256=sha256, cause=self._cause)
            catalogue = catalogues.by_sha256(session, sha256) if sha256 else None
            if catalogue:
                added.catalogue_id, added.name = catalogue.id, catalogue.name[:NAME_LENGTH]
            store.add(session, added)

    def _next(
        self, row: BankHistory | None, *, bank: str, state: str, sha256: str, cause: tuple[str, str]
    ) -> BankHistory:
        """Return the row that follows ``row``, and end ``row``."""
        now = self._now()
        if row is not None:
            row.ended = now
        same = row is not None and row.sha256 == sha256
        return BankHistory(
            device_id=self._device_id,
            bank=bank,
            state=state,
            sha256=sha256,
            name=row.name if row is not None and same else "",
            catalogue_id=row.catalogue_id if row is not None and same else None,
            began=now,
            told=now,
            ended=None,
            how=(cause[0] or "reported")[:HOW_LENGTH],
            user=cause[1],
            note="",
        )

    # --- queries ------------------------------------------------------------------------------------------------

    def timeline(self, start: datetime, end: datetime, device_id: int | None = None) -> Timeline:
        """Return the history of a device's banks; by default of the device that answered last. Raises BadInput for an
        invalid span, NotFound without a record."""
        if not timedelta(0) < end - start <= SPAN_MAX:
            raise BadInput(
                "invalid time span", expected="an end after the start, at most 10 years", got=f"{start} to {end}"
            )
        with self._database.unit_of_work() as session:
            devices = store.devices(session)
            device = next((d for d in devices if device_id in (None, d.id)), None)
            if device is None:
                raise NotFound(
                    "no banks recorded",
                    expected="a device that reported its banks",
                    got="none" if device_id is None else f"device {device_id}",
                    hint="open the line to a device",
                )
            stays = [self._stay(session, row) for row in store.between(session, device.id, start, end)]
            contacts = store.contacts_between(session, device.id, start, end)
        now_held = {stay.row.bank: stay for stay in stays if stay.row.ended is None}
        present = device.id == self._device_id
        planned = [plan for planner in self._planners for plan in planner(now_held)] if present else []
        return Timeline(device, devices, start, end, stays, planned, contacts)

    def active(self) -> BankPeriod | None:
        """Return the active bank of the device that answered last, as last reported; None if unknown."""
        with self._database.unit_of_work() as session:
            device_id = self._device_id or next((d.id for d in store.devices(session)), None)
            rows = [] if device_id is None else store.still_so(session, device_id)
            row = next((r for r in rows if r.state in (ACTIVE, TRIAL)), None)
            return None if row is None else self._stay(session, row)

    @staticmethod
    def _stay(session: Any, row: BankHistory) -> BankPeriod:
        """Look the catalogue up now, because a bank may be read back later than its row was written."""
        return BankPeriod(row, catalogues.by_sha256(session, row.sha256) if row.sha256 else None)


def _hex(value: Any) -> str:
    return value.hex() if isinstance(value, bytes) else str(value or "")
