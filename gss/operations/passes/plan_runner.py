"""Execution of armed pass plans. A plan starts at acquisition of signal and pauses at loss of signal. If ``resume`` is set, it
continues in the next pass. It ends at ABORT, when an item fails, or when a user stops it.

Each item is stored as *starting* before it is started. If the server restarts while an item is *starting* or *running*, the item
becomes *unknown* and the plan stops. Nothing is sent again.
"""

from __future__ import annotations

import threading
from dataclasses import replace
from datetime import timedelta

from gss.domain.errors import Conflict, GssError
from gss.operations.clock import Now
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.line.link import LinkService
from gss.operations.passes.pass_table import PassService
from gss.operations.passes.plan_items import ItemControl, PlanItem
from gss.operations.passes.plans import ACTIVE, PlanService, items_of
from gss.store.models import PassPlan

SIGNAL_S = 5.0
"""Maximum age of the last good packet while a signal is considered present. Units send a packet every second."""
EARLY = timedelta(minutes=2)
"""A signal that appears up to this time before the predicted rise belongs to the pass, because predictions and horizon
masks are not exact."""
NEXT_DAYS = 7.0
IN_PROGRESS = ("starting", "running")
ABORTED = "ABORT was sent"
NOT_RECORDED = "it is not known whether an item was started; check the unit and create a new plan"
RESTARTED = "the server restarted while an item was in progress; check the unit and create a new plan"


class PlanRunner:
    """Runs pass plans. The status thread calls ``tick`` once a second. Request threads call ``stop``."""

    def __init__(
        self,
        plans: PlanService,
        control: ItemControl,
        table: PassService,
        link: LinkService,
        commands: CommandService,
        bus: EventBus,
        now: Now,
    ) -> None:
        self._plans, self._control, self._table = plans, control, table
        self._link, self._commands, self._bus, self._now = link, commands, bus, now
        self._lock = threading.Lock()
        self._aborts = commands.aborts
        self._begun: dict[int, int] = {}
        """Id of the run or transfer of the item that a plan has started, until it is stored."""

    def start(self) -> None:
        """Stop the plans that had an item in progress when the previous server ended. Armed and waiting plans remain
        active."""
        for row in self._plans.active():
            items = items_of(row)
            if any(item.state in IN_PROGRESS for item in items):
                items = [self._interrupted(item) if item.state in IN_PROGRESS else item for item in items]
                self._end(row, items, "stopped", RESTARTED)

    def _interrupted(self, item: PlanItem) -> PlanItem:
        """Interrupt an item that was in progress when the previous server ended, and return it as unknown."""
        return item.at(
            "unknown", self._now(), self._control.interrupt(item, "the server restarted during its pass plan")
        )

    def stop(self, plan_id: int, *, user: str, reason: str = "") -> PassPlan:
        """Stop a plan. No further item is started. Raises Conflict if the plan is not active."""
        with self._lock:
            row = self._plans.get(plan_id)
            if row.state not in ACTIVE:
                raise Conflict("the plan is not active", expected=" or ".join(ACTIVE), got=row.state)
            return self._halt(row, "stopped", reason or f"stopped by {user}")

    def tick(self) -> None:
        """Advance all active plans."""
        with self._lock:
            aborts = self._commands.aborts
            for row in self._plans.active():
                if aborts != self._aborts:
                    self._halt(row, "stopped", ABORTED)
                else:
                    self._advance(row)
            self._aborts = aborts

    def _advance(self, row: PassPlan) -> None:
        now, signal = self._now(), self._signal()
        if row.state in ("armed", "waiting"):
            if now > row.set:
                self._wait_or_end(row, "no signal was acquired in the pass")
            elif signal and now >= row.rise - EARLY:
                self._begin(row)
        elif row.state == "paused":
            if now > row.set:
                self._wait_or_end(row, "the signal was lost and the pass ended")
            elif signal:
                self._begin(row)
        elif not signal:
            self._pause(row, "paused", "loss of signal")
        elif now > row.set:
            self._wait_or_end(row, "the pass ended before the plan was complete")
        else:
            self._follow(row)

    def _signal(self) -> bool:
        last_s = self._link.counters.last_good_s
        return self._link.connected and last_s is not None and self._link.monotonic_s() - last_s < SIGNAL_S

    def _begin(self, row: PassPlan) -> None:
        """Start or continue a plan after acquisition of signal."""
        first = row.started is None
        try:
            self._commands.check_user(row.armed_by)
            for item in self._items(row):
                if item.state == "running":
                    self._control.resume(item)
        except GssError as error:
            self._halt(row, "failed", str(error))
            return
        row = self._plans.change(row.id, state="running", reason="", started=row.started or self._now())
        self._record(row, "ok", "starts: signal acquired" if first else "continues: signal acquired")
        self._follow(row)

    def _follow(self, row: PassPlan) -> None:
        """Check the running item, and start the next item when it is done."""
        items = self._items(row)
        for k, item in enumerate(items):
            if item.state == "running":
                state, detail = self._control.state(item)
                if state == "running":
                    if detail != item.detail:
                        items[k] = replace(item, detail=detail)
                        self._plans.change(row.id, items)
                    return
                items[k] = item.at(state, self._now(), detail)
                row = self._plans.change(row.id, items)
                if state == "stopped":  # ABORT was sent after the check in tick, and has ended the procedure
                    self._end(row, items, "stopped", ABORTED)
                    return
                if state != "done":
                    self._end(row, items, "failed", f"item {k + 1}, {item.title}: {detail}")
                    return
            elif item.state == "waiting":
                self._start(row, items, k)
                return
            elif item.state == "unknown":
                self._end(row, items, "stopped", NOT_RECORDED)
                return
        self._end(row, items, "completed", "")

    def _items(self, row: PassPlan) -> list[PlanItem]:
        """Return the items of a plan. If the store failed when an item was started, store now that it is running. If it is not
        known whether it was started, it is unknown."""
        items = items_of(row)
        for k, item in enumerate(items):
            if item.state == "starting":
                started_id = self._begun.get(row.id)
                items[k] = (
                    item.at("unknown", self._now(), NOT_RECORDED)
                    if started_id is None
                    else replace(item, state="running", started_id=started_id)
                )
                self._plans.change(row.id, items)
        self._begun.pop(row.id, None)
        return items

    def _start(self, row: PassPlan, items: list[PlanItem], index: int) -> None:
        """Start an item. The state *starting* is stored first, so that a restart of the server does not start the item twice."""
        items[index] = items[index].at("starting", self._now())
        self._plans.change(row.id, items)
        try:
            self._commands.check_user(row.armed_by)
            started_id = self._control.start(items[index], row.confirm, user=row.armed_by, aborts=self._aborts)
        except GssError as error:
            items[index] = items[index].at("failed", self._now(), str(error))
            self._end(row, items, "failed", f"item {index + 1}, {items[index].title}: {error}")
            return
        self._begun[row.id] = started_id
        items[index] = replace(items[index], state="running", started_id=started_id)
        row = self._plans.change(row.id, items)
        del self._begun[row.id]
        if self._commands.aborts != self._aborts:  # ABORT was sent between the check in tick and the start
            self._halt(row, "stopped", ABORTED)

    def _pause(self, row: PassPlan, state: str, reason: str) -> None:
        for item in self._items(row):
            if item.state == "running":
                self._control.pause(item)
        row = self._plans.change(row.id, state=state, reason=reason)
        self._record(row, "watch", f"{state}: {reason}")

    def _wait_or_end(self, row: PassPlan, reason: str) -> None:
        """If ``resume`` is set, let the plan wait for the next pass over the same station that has no other plan; otherwise end
        the plan."""
        if row.resume:
            try:
                upcoming = self._table.upcoming(NEXT_DAYS, row.station_id).passes
            except GssError:
                upcoming = []
            others = [other for other in self._plans.active() if other.id != row.id]
            free = (
                coming_pass
                for coming_pass in upcoming
                if coming_pass.at.rise > row.set
                and not any(other.rise < coming_pass.at.set and coming_pass.at.rise < other.set for other in others)
            )
            later = next(free, None)
            if later is not None:
                self._pause(row, "waiting", f"{reason}; continues at {later.at.rise:%Y-%m-%d %H:%M:%S} UTC")
                self._plans.change(row.id, rise=later.at.rise, set=later.at.set)
                return
            reason += "; there is no later pass without another plan"
        self._halt(row, "missed" if row.started is None else "stopped", reason)

    def _halt(self, row: PassPlan, state: str, reason: str) -> PassPlan:
        """Stop the running item of a plan, then end the plan. If all items have been done meanwhile, the plan is completed."""
        items = self._items(row)
        for k, item in enumerate(items):
            if item.state == "running":
                reached, detail = self._control.state(item)
                if reached == "running":
                    self._control.stop(item, user=row.armed_by)
                    reached, detail = "stopped", reason
                items[k] = item.at(reached, self._now(), detail)
        if all(item.state == "done" for item in items):
            state, reason = "completed", ""
        return self._end(row, items, state, reason)

    def _end(self, row: PassPlan, items: list[PlanItem], state: str, reason: str) -> PassPlan:
        row = self._plans.change(row.id, items, state=state, reason=reason, finished=self._now())
        done = sum(item.state == "done" for item in items)
        message = f"{state}, {done} of {len(items)} items done" + (f": {reason}" if reason else "")
        self._record(row, "ok" if state == "completed" else "warning", message)
        return row

    def _record(self, row: PassPlan, severity: str, message: str) -> None:
        self._bus.record("pass", severity, f"Plan {row.name} {message}", plan_id=row.id)
