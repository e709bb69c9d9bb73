"""Raises an alarm before the active catalogue's validity ends."""

from __future__ import annotations

from datetime import datetime

from gss.domain.limits import State
from gss.operations.clock import Now
from gss.operations.telemetry.alarm_text import CATALOGUE
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.limit_check import Key
from gss.operations.transfers.bank_history import BankHistoryService
from gss.operations.transfers.bank_plans import expiry_state
from gss.operations.transfers.banks import days_left
from gss.store.models import Catalogue

NAME_LENGTH = 60


class ExpiryWatch:
    """Checks how long the active catalogue is valid, even while the line is closed."""

    def __init__(self, history: BankHistoryService, alarms: AlarmService, now: Now, watch_days: float) -> None:
        self._history, self._alarms, self._now, self._watch_days = history, alarms, now, watch_days

    def tick(self) -> None:
        """Raise, update or end the alarm of the active catalogue, and end the alarms of other catalogues."""
        period, now = self._history.active(), self._now()
        catalogue = period.catalogue if period else None
        current = _key(catalogue) if catalogue else None
        for key in self._alarms.open_keys():
            if key[0] == CATALOGUE and key != current:
                self._alarms.watch(key, State.OK, 0.0, "", "")
        if catalogue is None or current is None:
            return
        state, limit = _judged(catalogue, now, self._watch_days)
        remaining_days = days_left(catalogue.valid_to, now)
        self._alarms.watch(
            current, state, round(remaining_days or 0.0, 2), f"Catalogue {catalogue.name} {limit}", limit
        )


def _key(catalogue: Catalogue) -> Key:
    return CATALOGUE, catalogue.name[:NAME_LENGTH]


def _judged(catalogue: Catalogue, now: datetime, watch_days: float) -> tuple[State, str]:
    state = expiry_state(catalogue.valid_to, now, watch_days)
    if state is not State.OK and catalogue.valid_to is not None:
        verb = "expired" if state is State.CRITICAL else "expires"
        return state, f"{verb} {catalogue.valid_to:%Y-%m-%d %H:%M} UTC ({state})"
    if catalogue.valid_from is not None and catalogue.valid_from > now:
        return State.WATCH, f"is valid only from {catalogue.valid_from:%Y-%m-%d %H:%M} UTC (watch)"
    return State.OK, ""
