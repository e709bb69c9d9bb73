"""History and plan of the catalogues in each bank of each device, recorded from the device's reports.

A row describes one state and content of a bank, from the first report with this state and content to the first report
that differs. Planned content is derived from uploads in progress and from activations in the device's schedule.
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
    """A row of the history and the catalogue with the same hash; None if the ground does not have this catalogue."""

    row: BankHistory
    catalogue: Catalogue | None


@dataclass(frozen=True)
class Planned:
    """Planned content of a bank. ``kind``: upload or activation; ``at``: time of the change, None for the end of the
    upload."""

    bank: str
    kind: str
    at: datetime | None
    sha256: str
    name: str
    catalogue_id: int | None
    valid_from: datetime | None
    valid_to: datetime | None
    text: str
    validity_known: bool = True


@dataclass(frozen=True)
class Timeline:
    """Content of the banks of one device over a time span, and the contacts with this device."""

    device: Device
    devices: Sequence[Device]
    start: datetime
    end: datetime
    stays: Sequence[BankPeriod]
    planned: Sequence[Planned]
    contacts: Sequence[Contact]


Planner = Callable[[Mapping[str, BankPeriod]], list[Planned]]


class BankHistoryService:
    """Records the device's reports. Can be read from any thread. ``planners``: functions that return the planned
    content for the current content."""

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
                self._handle_hello()
            elif isinstance(event, Telemetry) and event.packet == roles.quantities.bank.packet:
                self._update_from_report(roles.quantities.bank.read(event.values))
            elif isinstance(event, Telemetry) and event.packet == roles.quantities.status.packet:
                left_s = roles.quantities.status.read(event.values).get("confirm_left_s")
                self._set_trial(isinstance(left_s, int | float) and left_s > 0, "confirmed")
            elif isinstance(event, DeviceEvent):
                self._handle_event(event)
            elif isinstance(event, TransferDone) and event.direction is Direction.UP and event.kind == "catalogue":
                self._cause = ("upload", "")
            elif isinstance(event, CommandUpdate) and event.stage is Stage.COMPLETED:
                self._handle_completion(event)

    def _handle_hello(self) -> None:
        with self._lock:  # first, because the next reports are of another device also if the store fails
            self._device_id, self._trial, self._cause = None, False, ("", "")
        self._identify()

    def _identify(self) -> None:
        """Look up the device of the contact, if it is not known yet."""
        contact_id = self._link.contact_id
        if self._device_id is None and contact_id is not None:
            with self._database.unit_of_work() as session:
                device_id = store.device_of_contact(session, contact_id)
            with self._lock:
                self._device_id = device_id

    def _handle_event(self, event: DeviceEvent) -> None:
        events, operations = self._link.roles.events, self._link.roles.operations
        if event.name == events.bank_fell_back:
            self._cause = ("fell back", "")
            self._set_trial(False, "fell back")
        elif event.name == events.bank_activated:
            self._cause, self._trial = (operations.title(Operation.ACTIVATE), self._user_of(event.request_id)), True
        elif event.name == events.bank_confirmed:
            self._cause = (operations.title(Operation.CONFIRM), self._user_of(event.request_id))
            self._set_trial(False, operations.title(Operation.CONFIRM))

    def _user_of(self, request_id: int) -> str:
        with self._database.unit_of_work() as session:
            row = commands.by_request(session, request_id) if request_id else None
        return row.user if row else self._cause[1]

    def _handle_completion(self, event: CommandUpdate) -> None:
        """Store the command as the cause of the next reports."""
        operation = self._link.roles.operations.of_command(event.name, event.arguments)
        if operation is Operation.LIST_BANKS:
            self._cause = ("", "")
        elif operation in BANK_OPERATIONS:
            self._cause = (event.name, self._user_of(event.request_id))
            if operation is Operation.CONFIRM:
                self._set_trial(False, event.name)
            elif operation is Operation.ACTIVATE:
                self._trial = True

    def _set_trial(self, trial: bool, source: str) -> None:
        """Set the state of the active bank to trial or active, because bank reports do not distinguish them."""
        if trial == self._trial or self._device_id is None:
            return
        self._trial = trial
        with self._lock, self._database.unit_of_work() as session:
            for row in store.still_so(session, self._device_id):
                if row.state == (ACTIVE if trial else TRIAL) and source != "fell back":
                    unchanged = {"bank": row.bank, "state": TRIAL if trial else ACTIVE, "sha256": row.sha256}
                    activate = self._link.roles.operations.title(Operation.ACTIVATE)
                    cause = (activate if trial else source, self._cause[1])
                    store.add(session, self._end_and_follow(row, **unchanged, cause=cause))

    def _update_from_report(self, info: Mapping[str, Any]) -> None:
        self._identify()
        if self._device_id is None:
            return
        bank, reported_state = str(info["bank"]), str(info["state"])
        occupied = reported_state in ("loaded", "committed")
        sha256 = _hex(info.get("sha256")) if occupied else ""
        state = STATE_OF.get(reported_state, reported_state)
        if occupied and info["active"]:
            state = TRIAL if self._trial else ACTIVE
        with self._lock, self._database.unit_of_work() as session:
            rows = {row.bank: row for row in store.still_so(session, self._device_id)}
            row = rows.get(bank)
            if row is not None and (row.state, row.sha256) == (state, sha256):
                row.reported = self._now()
                return
            successor = self._end_and_follow(row, bank=bank, state=state, sha256=sha256, cause=self._cause)
            catalogue = catalogues.by_sha256(session, sha256) if sha256 else None
            if catalogue:
                successor.catalogue_id, successor.name = catalogue.id, catalogue.name[:NAME_LENGTH]
            store.add(session, successor)

    def _end_and_follow(
        self, row: BankHistory | None, *, bank: str, state: str, sha256: str, cause: tuple[str, str]
    ) -> BankHistory:
        """End ``row`` and return the row that follows it."""
        now = self._now()
        if row is not None:
            row.ended = now
        same_content = row is not None and row.sha256 == sha256
        return BankHistory(
            device_id=self._device_id,
            bank=bank,
            state=state,
            sha256=sha256,
            name=row.name if row is not None and same_content else "",
            catalogue_id=row.catalogue_id if row is not None and same_content else None,
            began=now,
            reported=now,
            ended=None,
            how=(cause[0] or "reported")[:HOW_LENGTH],
            user=cause[1],
            note="",
        )

    # --- queries ------------------------------------------------------------------------------------------------

    def timeline(self, start: datetime, end: datetime, device_id: int | None = None) -> Timeline:
        """Return the history of the banks of a device, by default the device that answered last. Raises BadInput for an
        invalid time span, and NotFound if no banks are recorded."""
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
            periods = [self._period(session, row) for row in store.between(session, device.id, start, end)]
            contacts = store.contacts_between(session, device.id, start, end)
        current_periods = {period.row.bank: period for period in periods if period.row.ended is None}
        is_current_device = device.id == self._device_id
        planned = [plan for planner in self._planners for plan in planner(current_periods)] if is_current_device else []
        return Timeline(device, devices, start, end, periods, planned, contacts)

    def active(self) -> BankPeriod | None:
        """Return the last reported active bank of the device that answered last; None if it is unknown."""
        with self._database.unit_of_work() as session:
            device_id = self._device_id or next((d.id for d in store.devices(session)), None)
            rows = [] if device_id is None else store.still_so(session, device_id)
            row = next((r for r in rows if r.state in (ACTIVE, TRIAL)), None)
            return None if row is None else self._period(session, row)

    @staticmethod
    def _period(session: Any, row: BankHistory) -> BankPeriod:
        """Return a row with its catalogue. Each query looks the catalogue up, because the catalogue can be stored later
        than the row."""
        return BankPeriod(row, catalogues.by_sha256(session, row.sha256) if row.sha256 else None)


def _hex(value: Any) -> str:
    return value.hex() if isinstance(value, bytes) else str(value or "")
