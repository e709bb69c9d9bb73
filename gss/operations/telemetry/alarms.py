"""Latching alarms: an alarm stays open until its value is back in limits *and* an operator has acknowledged it.

raised: out of limits, not acknowledged. acked: out of limits, acknowledged. cleared: back in limits, not acknowledged. closed:
back in limits and acknowledged; a closed alarm never reopens. A worse level resets the acknowledgement. A shelved alarm
follows its value like any other alarm and is only hidden until the shelving time ends. Every change updates the row, records an
event and publishes a message.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from datetime import datetime, timedelta
from functools import partial
from typing import Any

from gss.device.session_events import DeviceEvent
from gss.domain.errors import BadInput, Conflict
from gss.domain.limits import ORDER, State, worst
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarm_text import (
    CATALOGUE,
    EVENT,
    HEADS,
    LINK,
    MARGIN,
    STORE,
    UNMEASURED,
    AlarmView,
    action_of,
    cut,
    field_of,
    limit_text,
    text_of,
    title_of,
    unit_of,
    with_unit,
)
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.operations.telemetry.limit_check import Judgement, Key
from gss.operations.telemetry.silence import SilenceCheck
from gss.operations.telemetry.telemetry import Judged, TelemetryService
from gss.store import alarms as store
from gss.store.engine import Database
from gss.store.models import Alarm

SEVERE = (State.WARNING, State.CRITICAL)
SHELF_MAX = timedelta(hours=24)


class AlarmService:
    """Raises, updates, acknowledges, shelves and closes alarms. Safe to call from link, status and request threads. An alarm of
    an event waits while the store is down, because the device reports an event once; values are reported again."""

    def __init__(
        self,
        dictionary: TelemetryDefinitions,
        telemetry: TelemetryService,
        link: LinkService,
        database: Database,
        bus: EventBus,
        now: Now,
    ) -> None:
        self._dictionary, self._telemetry, self._link = dictionary, telemetry, link
        self._database, self._bus, self._now = database, bus, now
        self._open = telemetry.open_alarms
        self._silence = SilenceCheck(link, telemetry, now)
        self._lock = threading.RLock()
        self._writes = DeferredWrites()

    def start(self) -> None:
        """Load the alarms that were open when the server stopped. Values that were out of limits still count as out of limits."""
        with self._database.unit_of_work() as session:
            rows = store.still_open(session)
        with self._lock:
            self._open.update({(row.packet, row.field): row for row in rows})
        for row in rows:
            if row.state in ("raised", "acked") and row.packet not in UNMEASURED:
                self._telemetry.board.limits.seed((row.packet, row.field), State(row.worst))

    # --- inputs -------------------------------------------------------------------------------------------------

    def judged(self, judgements: Sequence[Judgement]) -> None:
        """Update alarms from the judged samples of a batch of telemetry."""
        with self._lock:
            for j in judgements:
                key = (j.packet, j.field.name)
                if j.state is State.OK and key not in self._open:
                    continue
                reading = f"{j.field.title} {with_unit(j.value, j.field)}"
                limit = limit_text(j.rule, j.state, j.value) if j.state is not State.OK else ""
                self._update(key, j.state, j.value, f"{reading}, {limit}", limit, judged=j.judged)

    def handle(self, batch: LineBatch) -> None:
        """Update alarms from judged telemetry, and raise an alarm, cleared immediately, for each severe event."""
        for event in batch.events:
            if isinstance(event, Judged):
                self.judged(event.judgements)
            elif isinstance(event, DeviceEvent) and event.severity in SEVERE:
                text = f"{event.name}: {event.text}" if event.text else event.name
                self._writes.add(partial(self._count_event, (EVENT, event.name), State(event.severity), text))
        self._writes.run()

    def tick(self) -> None:
        """End shelving whose time is over, and detect loss of signal. Called about once a second."""
        now = self._now()
        with self._lock:
            for row in list(self._open.values()):
                if row.shelved_until is not None and row.shelved_until <= now:
                    self._change(row, "ok", f"{title_of(self._dictionary, row)}: no longer shelved", shelved_until=None)
            self._check_signal()

    def clock_jumped(self, jump_s: float) -> None:
        """Correct the stored times of reception after the server's clock jumped by ``jump_s``."""
        now = self._now()
        with self._lock:
            self._silence.clock_jumped(now, jump_s)
            self._telemetry.board.clock_jumped(now, jump_s)

    def watch(self, key: Key, state: State, value: float, text: str, limit: str, *, judged: bool = True) -> None:
        """Update an alarm of another service. OK without ``judged`` ends an alarm that cannot be checked any more."""
        with self._lock:
            if state is not State.OK or key in self._open:
                self._update(key, state, value, text, limit, judged=judged)

    def _check_signal(self) -> None:
        for found in self._silence.check():
            if found.missing or found.key in self._open:
                state, limit = (State.WARNING, found.limit) if found.missing else (State.OK, "")
                self._update(found.key, state, found.silent_s, found.text, limit, judged=True)

    def _update(self, key: Key, state: State, value: float, text: str, limit: str, *, judged: bool) -> None:
        row = self._open.get(key)
        if row is None:
            if state is not State.OK:
                self._raise(key, state, value, text, limit)
        elif state is State.OK:
            self._end_violation(row, judged=judged)
        elif row.state == "cleared" or ORDER[state] > ORDER[State(row.worst)]:
            self._raise_again(row, state, value, text, limit)
        elif row.packet == MARGIN and row.value is not None and value < row.value:
            with self._database.unit_of_work() as session:
                self._open[key] = store.set_value(session, row.id, value)  # telemetry has the value of other alarms

    def _raise(
        self, key: Key, level: State, value: float, text: str, limit: str, *, over: datetime | None = None
    ) -> None:
        alarm = Alarm(
            packet=key[0],
            field=key[1],
            state="raised" if over is None else "cleared",
            worst=level.value,
            value=value,
            limit_text=cut(limit),
            limit_set=self._telemetry.limits.chosen,
            raised=self._now(),
            cleared=over,
        )
        with self._database.unit_of_work() as session:
            store.add(session, alarm)
        self._open[key] = alarm
        self._record_event(alarm, level.value, text)

    def _raise_again(self, row: Alarm, state: State, value: float, text: str, limit: str) -> None:
        """Raise an alarm again and reset its acknowledgement, because its value is out of limits again or worse than before."""
        peak = worst((state, State(row.worst)))
        changes: dict[str, object] = {"state": "raised", "cleared": None, "acknowledged": None, "acknowledged_by": ""}
        if peak is state:
            changes |= {"worst": state.value, "value": value, "limit_text": cut(limit)}
        self._change(row, state.value, text, **changes)

    def _end_violation(self, row: Alarm, *, judged: bool) -> None:
        if row.state not in ("raised", "acked"):
            return
        now = self._now()
        unchecked = "not checked, the orbit is unknown" if row.packet == MARGIN else "not checked, the cycle is stopped"
        why = "back in limits" if judged else unchecked
        if row.state == "acked":
            self._change(
                row, "ok", f"{title_of(self._dictionary, row)}: {why}; closed", state="closed", cleared=now, closed=now
            )
        else:
            self._change(
                row, "ok", f"{title_of(self._dictionary, row)}: {why}; not acknowledged", state="cleared", cleared=now
            )

    def _count_event(self, key: Key, state: State, text: str) -> None:
        with self._lock:
            row, now = self._open.get(key), self._now()
            if row is None:
                self._raise(key, state, 1.0, text, text, over=now)
            else:
                changes = {"value": (row.value or 0.0) + 1.0, "limit_text": cut(text), "cleared": now}
                # The event is already recorded. The alarm only counts its repetitions.
                self._change(row, None, "", **changes)

    # --- operator actions ---------------------------------------------------------------------------------------

    def acknowledge(self, alarm_id: int, *, user: str, note: str = "") -> AlarmView:
        """Acknowledge an alarm. It closes as soon as it is also cleared. Raises Conflict if it is acknowledged or closed."""
        with self._lock:
            row = self._require_open(alarm_id)
            if row.state == "acked":
                raise Conflict("the alarm is already acknowledged", got=f"by {row.acknowledged_by}")
            now = self._now()
            over = row.state == "cleared"
            changes: dict[str, object] = {"acknowledged": now, "acknowledged_by": user, "state": "acked"}
            if over:
                changes |= {"state": "closed", "closed": now}
            return self._record_action(row, user, "acknowledged" + (" and closed" if over else ""), note, **changes)

    def shelve(self, alarm_id: int, until: datetime, *, user: str, note: str) -> AlarmView:
        """Hide an alarm until a time at most 24 h ahead. ``note``: the reason. Raises BadInput."""
        now = self._now()
        if not now < until <= now + SHELF_MAX:
            raise BadInput("the end of shelving is out of range", expected="a time within 24 h", got=until.isoformat())
        if not note.strip():
            raise BadInput("shelving an alarm needs a reason", expected="a note")
        with self._lock:
            row = self._require_open(alarm_id)
            action = f"shelved until {until:%H:%M:%S} UTC"
            return self._record_action(row, user, action, note, shelved_until=until, shelved_by=user)

    def unshelve(self, alarm_id: int, *, user: str, note: str = "") -> AlarmView:
        """End the shelving of an alarm. Raises Conflict if it is not shelved."""
        with self._lock:
            row = self._require_open(alarm_id)
            if row.shelved_until is None:
                raise Conflict("the alarm is not shelved", got=row.state)
            return self._record_action(row, user, "unshelved", note, shelved_until=None, shelved_by="")

    def clear(self, alarm_id: int, *, user: str, note: str = "") -> AlarmView:
        """Close an alarm manually. Raises Conflict while current telemetry is out of limits."""
        with self._lock:
            row = self._require_open(alarm_id)
            if row.state in ("raised", "acked") and self._is_fresh(row):
                raise Conflict(
                    "the cause of the alarm persists",
                    expected="a value back in limits",
                    got=f"{title_of(self._dictionary, row)}: {self._level(row)}",
                    hint="acknowledge or shelve it",
                )
            now = self._now()
            changes: dict[str, object] = {"state": "closed", "closed": now, "cleared": row.cleared or now}
            if row.acknowledged is None:
                changes |= {"acknowledged": now, "acknowledged_by": user}
            if row.packet not in UNMEASURED:
                self._telemetry.board.limits.seed((row.packet, row.field), State.OK)
            return self._record_action(row, user, "closed manually", note, **changes)

    def _require_open(self, alarm_id: int) -> Alarm:
        with self._database.unit_of_work() as session:
            row = store.get(session, alarm_id)
        if row.closed is not None:
            raise Conflict("the alarm is closed", got=f"closed {row.closed:%Y-%m-%d %H:%M:%S} UTC")
        return row

    def _is_fresh(self, row: Alarm) -> bool:
        """True if the value of the alarm is still being received."""
        if row.packet in (LINK, CATALOGUE, STORE):
            return row.packet != LINK or self._link.connected
        latest, field = self._telemetry.board.latest(row.packet), field_of(self._dictionary, row)
        if field is None:  # a derived parameter that was deleted
            return False
        stale_s = self._dictionary.packet(row.packet).stale_after_s or float("inf")
        return latest is not None and (self._now() - latest[0]).total_seconds() <= stale_s

    def _record_action(self, row: Alarm, user: str, action: str, note: str, **changes: Any) -> AlarmView:
        if note.strip():
            line = f"{self._now():%Y-%m-%d %H:%M:%S} {user}, {action}: {note.strip()}"
            changes["note"] = f"{row.note}\n{line}".strip()
        text = f"{title_of(self._dictionary, row)}: {action} by {user}" + (f": {note.strip()}" if note.strip() else "")
        return self.view(self._change(row, "ok", text, **changes))

    # --- rows ---------------------------------------------------------------------------------------------------

    def _change(self, row: Alarm, severity: str | None, text: str, **changes: Any) -> Alarm:
        with self._database.unit_of_work() as session:
            stored = store.get(session, row.id)
            for name, value in changes.items():
                setattr(stored, name, value)
        key = (stored.packet, stored.field)
        if stored.closed is None:
            self._open[key] = stored
        else:
            self._open.pop(key, None)
        self._record_event(stored, severity, text)
        return stored

    def _record_event(self, row: Alarm, severity: str | None, text: str) -> None:
        if severity is not None:
            self._bus.record("alarm", severity, text, alarm_id=row.id, state=row.state)
        self._bus.publish("alarm", self.view(row))

    def _level(self, row: Alarm) -> State:
        if row.state not in ("raised", "acked"):
            return State.OK
        if row.packet in (LINK, CATALOGUE, STORE, MARGIN, HEADS):
            return State(row.worst)
        return self._telemetry.board.limits.counted((row.packet, row.field))

    def view(self, row: Alarm) -> AlarmView:
        """Return the alarm for display."""
        shelved = row.shelved_until is not None and row.shelved_until > self._now()
        texts = title_of(self._dictionary, row), unit_of(self._dictionary, row), text_of(self._dictionary, row)
        return AlarmView(row, self._level(row), *texts, shelved, action_of(self._dictionary, row))

    def get(self, alarm_id: int) -> AlarmView:
        """Return the alarm with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return self.view(store.get(session, alarm_id))

    def opened(self) -> list[AlarmView]:
        """Return open alarms: most severe first; at the same severity, unacknowledged alarms first, then oldest first."""
        with self._lock:
            views = [self.view(row) for row in self._open.values()]
        return sorted(views, key=_sort_key)

    def newest(self, limit: int) -> list[AlarmView]:
        """Return up to ``limit`` alarms, latest first, including closed alarms."""
        with self._database.unit_of_work() as session:
            rows = store.newest(session, limit)
        return [self.view(row) for row in rows]

    def between(self, start: datetime, end: datetime) -> list[AlarmView]:
        """Return the alarms that were open at some time within a time span."""
        with self._database.unit_of_work() as session:
            rows = store.between(session, start, end)
        return [self.view(row) for row in rows]

    def open_keys(self) -> list[Key]:
        """Return the fields and conditions that have an open alarm."""
        with self._lock:
            return list(self._open)


def _sort_key(view: AlarmView) -> tuple[bool, int, bool, datetime, int]:
    """Return the sort key of an open alarm. Alarms latch, so an unacknowledged alarm has its worst level."""
    row = view.row
    level = view.level if row.state == "acked" else State(row.worst)
    return view.shelved, -ORDER[level], row.state == "acked", row.raised, row.id
