"""Planned content of the banks, and the period for which valid catalogues are available."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.domain.limits import State
from gss.instruments.operations import BANK, Operation, StandardOperations
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.transfers.bank_history import ACTIVE, TRIAL, BankPeriod, Planned
from gss.operations.transfers.banks import days_left
from gss.operations.transfers.transfers import TransferService
from gss.store import catalogues
from gss.store.engine import Database

WATCHED_TRANSFERS = 20
WARNING_DAYS = 1.0


@dataclass(frozen=True)
class Cover:
    """Period for which valid catalogues are available, with its alarm level. ``until``: end of the period, None if
    there is no end or the end is unknown."""

    state: State
    text: str
    until: datetime | None


def uploads(transfers: TransferService, database: Database) -> Callable[[Mapping[str, BankPeriod]], list[Planned]]:
    """Return a planner for catalogue uploads in progress."""

    def planned(_periods: Mapping[str, BankPeriod]) -> list[Planned]:
        plans = []
        for view in transfers.newest(WATCHED_TRANSFERS):
            row = view.row
            if row.direction != "up" or row.kind != "catalogue" or row.finished is not None or row.catalogue_id is None:
                continue
            with database.unit_of_work() as session:
                catalogue = catalogues.get(session, row.catalogue_id)
            bank = str(row.options.get("name") or row.target)
            plans.append(
                Planned(
                    bank,
                    "upload",
                    None,
                    catalogue.sha256,
                    catalogue.name,
                    catalogue.id,
                    catalogue.valid_from,
                    catalogue.valid_to,
                    f"{catalogue.name}, {row.state}",
                    catalogue.validity_known,
                )
            )
        return plans

    return planned


def activations(
    schedule: ScheduleService, operations: StandardOperations
) -> Callable[[Mapping[str, BankPeriod]], list[Planned]]:
    """Return a planner for bank activations in the device's schedule."""

    def planned(periods: Mapping[str, BankPeriod]) -> list[Planned]:
        plans = []
        for entry in schedule.state().entries:
            if entry.command is None or entry.state != "waiting":
                continue
            if operations.of_command(entry.command, entry.arguments) is not Operation.ACTIVATE:
                continue
            bank = str(operations.given(Operation.ACTIVATE, entry.arguments).get(BANK, ""))
            period = periods.get(bank)
            catalogue = period.catalogue if period else None
            name = catalogue.name if catalogue else (period.row.name if period else "")
            sha256 = period.row.sha256 if period else ""
            text = f"activate {bank} planned"
            span = (catalogue.valid_from, catalogue.valid_to) if catalogue else (None, None)
            known = catalogue is not None and catalogue.validity_known
            number = catalogue.id if catalogue else None
            plans.append(Planned(bank, "activation", entry.at, sha256, name, number, *span, text, known))
        return plans

    return planned


def cover(periods: Sequence[BankPeriod], planned: Sequence[Planned], now: datetime, watch_days: float) -> Cover:
    """Return the period covered by the active catalogue and by the catalogues that are planned to follow it."""
    active = next((s for s in periods if s.row.ended is None and s.row.state in (ACTIVE, TRIAL)), None)
    if active is None:
        return Cover(State.WATCH, "the device has not reported an active bank", None)
    if active.catalogue is None:
        return Cover(State.WATCH, f"the ground does not have the content of bank {active.row.bank}", None)
    until, bank, subject = active.catalogue.valid_to, active.row.bank, "the active bank"
    known = active.catalogue.validity_known
    switches = [(plan.at, plan) for plan in planned if plan.kind == "activation" and plan.at is not None]
    for at, plan in sorted(switches, key=lambda switch: switch[0]):
        if plan.bank == bank:
            continue
        if until is not None and max(at, plan.valid_from or at) > until:
            break
        if plan.catalogue_id is None:
            text = f"the ground does not have the content of bank {plan.bank}, which is to be activated"
            return Cover(State.WATCH, text, None)
        until, bank, subject, known = plan.valid_to, plan.bank, f"bank {plan.bank} follows and", plan.validity_known
    if not known:
        text = f"the validity of bank {bank} is unknown (read back)"
        return Cover(State.WATCH, text, None)
    if until is None:
        return Cover(State.OK, f"{subject} does not expire", None)
    state = expiry_state(until, now, watch_days)
    if until <= now:
        return Cover(state, f"no cover since {until:%m-%d %H:%M}", until)
    ready = next((s for s in periods if _follows(s, until, now)), None)
    if state is State.OK:
        return Cover(state, f"cover until {until:%Y-%m-%d}", until)
    remedy = f"unless bank {ready.row.bank} is activated" if ready else "and no bank holds a successor"
    return Cover(state, f"no cover from {until:%m-%d %H:%M} {remedy}", until)


def expiry_state(valid_to: datetime | None, now: datetime, watch_days: float) -> State:
    """Return the alarm level for the end of a catalogue's validity."""
    remaining_days = days_left(valid_to, now)
    if remaining_days is None or remaining_days > watch_days:
        return State.OK
    return State.CRITICAL if remaining_days <= 0 else State.WARNING if remaining_days <= WARNING_DAYS else State.WATCH


def _follows(period: BankPeriod, until: datetime, now: datetime) -> bool:
    """True if an inactive bank contains a catalogue for the time after ``until``."""
    catalogue = period.catalogue
    if catalogue is None or not catalogue.validity_known:
        return False
    if period.row.ended is not None or period.row.state != "held":
        return False
    begins_in_time = catalogue.valid_from is None or catalogue.valid_from <= until + timedelta(days=1)
    return begins_in_time and (catalogue.valid_to is None or catalogue.valid_to > max(until, now))
