"""Rehearse a pass plan on a simulated unit. The director advances time, switches the signal on and off, and runs the
procedure steps that are waiting for a person."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from gss.domain.errors import GssError
from gss.operations.clock import Monotonic
from gss.operations.line.link import LinkService
from gss.operations.passes.plan_items import PlanItem
from gss.operations.passes.plan_runner import EARLY, PlanRunner
from gss.operations.passes.plans import ACTIVE, PlanService, items_of
from gss.operations.passes.spacecraft import SpacecraftService
from gss.operations.passes.stations import StationService, ground_station
from gss.operations.procedures.document import ProcedureStep, read_procedure
from gss.operations.procedures.run_record import entries_of
from gss.operations.procedures.runs import ProcedureRunner
from gss.operations.rehearsals.rehearsal_report import (
    MAX_DAYS,
    PersonStep,
    RehearsalOptions,
    RehearsalReport,
    RehearsedItem,
    RehearsedPass,
    RehearsedStep,
    Transition,
)
from gss.operations.rehearsals.stepped import URL, RehearsalLine, SteppedClock, SteppedUnit
from gss.operations.transfers.arrivals import Writer
from gss.orbit.passes import find_passes
from gss.store.models import PassPlan, ProcedureRun

PERSON, SECOND = "rehearsal", "second person"
BUSY_STEP_S, QUIET_STEP_S, NO_SIGNAL_STEP_S = 0.02, 0.1, 1.0
"""Lengths of a time step while the ground sends, while the ground waits, and while no signal is present."""
MIN_STEP_S = 0.001
BUSY_FOR_S = 1.0
"""Time advances in small steps for this long after the ground has sent something."""
YIELD_S = 0.0003
"""Pause in real time before simulated time advances, so that threads woken by an event can run."""
STORED_WITHIN_S = 30.0
PERSON_STEPS = ("question", "hold", "sign")
"""Types of the steps that only a person runs."""

Report = Callable[[float, str], None]
"""Called with the completed share, 0 to 1, and a text with the time and the state of the plan."""


@dataclass(frozen=True)
class Ground:
    """The ground's services that a rehearsal uses. ``tickers``: functions to call once a second; ``stopwatch_s``: clock
    of real time."""

    link: LinkService
    plans: PlanService
    runner: PlanRunner
    stations: StationService
    spacecraft: SpacecraftService
    procedures: ProcedureRunner
    writer: Writer
    tickers: Sequence[Callable[[], None]]
    stopwatch_s: Monotonic


class Director:
    """Rehearses one plan. Not reusable."""

    def __init__(
        self, ground: Ground, clock: SteppedClock, line: RehearsalLine, unit: SteppedUnit, options: RehearsalOptions
    ) -> None:
        self._ground, self._clock, self._line, self._unit, self._options = ground, clock, line, unit, options
        self._passes: list[RehearsedPass] = []
        self._edges: list[datetime] = []
        self._transitions: list[Transition] = []
        self._person_steps: list[PersonStep] = []
        self._active_s: dict[int, float] = {}
        self._busy_until_s = self._next_tick_s = self._procedures_ticked_s = 0.0
        self._waiting_step: tuple[tuple[int, str, int], float] | None = None

    def run(self, plan_id: int, report: Report) -> RehearsalReport:
        """Arm the plan, run it to its end, and return the report. Raises Conflict if the plan cannot be armed."""
        began_s, plans = self._ground.stopwatch_s(), self._ground.plans
        plan = plans.get(plan_id)
        end = plan.rise + timedelta(days=MAX_DAYS)
        self._passes = self._find_passes(plan, end)
        self._edges = self._signal_changes()
        plan = plans.arm(plan_id, plans.to_confirm(plan, user=PERSON), user=PERSON)
        self._ground.link.open_later(URL)
        while plan.state in ACTIVE and self._clock.now() < end:
            self._skip_to(plan)
            self._advance(plan)
            if self._clock.monotonic_s() >= self._next_tick_s:
                plan = self._tick(plan_id)
                report(_completed_share(plan), f"{self._clock.now():%Y-%m-%d %H:%M:%S} UTC, plan {plan.state}")
        simulated_s = (self._clock.now() - self._passes[0].rise).total_seconds()
        return self._report(plan, simulated_s, self._ground.stopwatch_s() - began_s)

    def _find_passes(self, plan: PassPlan, end: datetime) -> list[RehearsedPass]:
        """Return the passes over the plan's ground station. Rise and set refer to the horizon mask of the station."""
        station = ground_station(self._ground.stations.get(plan.station_id))
        orbit = self._ground.spacecraft.require().orbit
        return [
            RehearsedPass(station_pass.rise, station_pass.set, 0.0, 0, 0)
            for station_pass in find_passes(orbit, station, plan.rise - EARLY, min(end, orbit.end))
        ]

    # --- time ---------------------------------------------------------------------------------------------------

    def _skip_to(self, plan: PassPlan) -> None:
        """Skip to shortly before the plan's next pass, because nothing happens until then."""
        gap_s = (plan.rise - EARLY - self._clock.now()).total_seconds()
        if plan.state in ("armed", "waiting") and gap_s > QUIET_STEP_S:
            self._line.in_view = False
            self._clock.advance(gap_s)
            self._unit.skip(gap_s)
            self._settle()

    def _advance(self, plan: PassPlan) -> None:
        """Advance ground and unit by one step."""
        now_s = self._clock.monotonic_s()
        if self._line.wrote:
            self._line.wrote, self._busy_until_s = False, now_s + BUSY_FOR_S
        index = self._pass_index()
        self._line.in_view = index is not None and not self._in_outage(index)
        step_s = self._step_s(now_s < self._busy_until_s)
        up_before, down_before = self._line.up, self._line.down
        self._clock.advance(step_s)
        self._unit.step(step_s)
        self._settle()
        if now_s - self._procedures_ticked_s >= QUIET_STEP_S / 2:
            self._procedures_ticked_s = now_s
            self._ground.procedures.tick()
        if index is not None:
            current, used_s = self._passes[index], step_s if plan.state == "running" else 0.0
            self._passes[index] = replace(
                current,
                used_s=current.used_s + used_s,
                bytes_up=current.bytes_up + self._line.up - up_before,
                bytes_down=current.bytes_down + self._line.down - down_before,
            )
        if plan.state == "running":
            for k, item in enumerate(items_of(plan)):
                if item.state == "running":
                    self._active_s[k] = self._active_s.get(k, 0.0) + step_s

    def _settle(self) -> None:
        """Wait until the ground has read, handled and stored all received data."""
        self._line.round()
        if not self._ground.link.events.wait_until_handled(STORED_WITHIN_S):
            raise GssError("the rehearsal stopped", got=f"events were not handled within {STORED_WITHIN_S:g} s")
        self._ground.writer.finish(STORED_WITHIN_S)
        time.sleep(YIELD_S)

    def _step_s(self, busy: bool) -> float:
        """Return the length of the next time step, which ends no later than the next change of the signal."""
        now = self._clock.now()
        step_s = (
            BUSY_STEP_S if busy and self._line.in_view else QUIET_STEP_S if self._line.in_view else NO_SIGNAL_STEP_S
        )
        until_change_s = next(((edge - now).total_seconds() for edge in self._edges if edge > now), step_s)
        return max(MIN_STEP_S, min(step_s, until_change_s))

    def _signal_changes(self) -> list[datetime]:
        """Return the times at which the signal appears or disappears, in order."""
        edges = [edge for rehearsed in self._passes for edge in (rehearsed.rise, rehearsed.set)]
        for outage in self._options.outages:
            if outage.pass_number <= len(self._passes):
                lost_at = self._passes[outage.pass_number - 1].rise + timedelta(seconds=outage.after_s)
                edges += [lost_at, lost_at + timedelta(seconds=outage.for_s)]
        return sorted(edges)

    def _pass_index(self) -> int | None:
        now = self._clock.now()
        return next((k for k, rehearsed in enumerate(self._passes) if rehearsed.rise <= now < rehearsed.set), None)

    def _in_outage(self, index: int) -> bool:
        since_s = (self._clock.now() - self._passes[index].rise).total_seconds()
        return any(
            o.pass_number == index + 1 and o.after_s <= since_s < o.after_s + o.for_s for o in self._options.outages
        )

    # --- once a second ------------------------------------------------------------------------------------------

    def _tick(self, plan_id: int) -> PassPlan:
        self._next_tick_s = self._clock.monotonic_s() + 1.0
        for tick in self._ground.tickers:
            tick()
        plan = self._ground.plans.get(plan_id)
        if not self._transitions or self._transitions[-1].state != plan.state:
            self._transitions.append(Transition(self._clock.now(), plan.state, plan.reason))
        item = next((item for item in items_of(plan) if item.state == "running"), None)
        if plan.state == "running" and item is not None and item.kind == "procedure" and item.started_id is not None:
            self._act_for_person(plan, item, item.started_id)
            plan = self._ground.plans.get(plan_id)
        return plan

    def _act_for_person(self, plan: PassPlan, item: PlanItem, run_id: int) -> None:
        """Run a step ``person_s`` seconds after it began to wait for a person. Stop the plan if the step has
        failed."""
        row, waiting = self._ground.procedures.state(run_id)
        if not waiting:
            self._waiting_step = None
            return
        entries = entries_of(row)
        if entries and entries[-1].step == waiting and entries[-1].state == "failed":
            reason = f"{item.title}, step {waiting}: {entries[-1].detail}"
            self._ground.runner.stop(plan.id, user=PERSON, reason=reason)
            return
        key, now_s = (run_id, waiting, len(entries)), self._clock.monotonic_s()
        if self._waiting_step is None or self._waiting_step[0] != key:
            self._waiting_step = (key, now_s)
        if now_s - self._waiting_step[1] >= self._options.person_s:
            self._run_step(row, read_procedure(row.text).step(waiting))

    def _run_step(self, row: ProcedureRun, step: ProcedureStep) -> None:
        answer = self._options.answers.get(step.id, step.branches[0].when) if step.kind == "question" else ""
        user = SECOND if step.kind == "hold" else PERSON
        self._ground.procedures.run_step(row.id, step.id, user=user, answer=answer)
        if step.kind in PERSON_STEPS:
            self._person_steps.append(PersonStep(self._clock.now(), step.id, step.kind, answer, user))
        if self._ground.procedures.get(row.id).state == "running":
            self._ground.procedures.set_automatic(row.id, True, user=PERSON)

    # --- report -------------------------------------------------------------------------------------------------

    def _report(self, plan: PassPlan, simulated_s: float, real_s: float) -> RehearsalReport:
        items = [
            RehearsedItem(
                item.title,
                item.kind,
                item.state,
                item.detail,
                item.estimated_s,
                round(self._active_s.get(k, 0.0), 2),
                _parsed_time(item.started),
                _parsed_time(item.finished),
            )
            for k, item in enumerate(items_of(plan))
        ]
        runs = [item.started_id for item in items_of(plan) if item.kind == "procedure" and item.started_id is not None]
        now = self._clock.now()
        return RehearsalReport(
            plan_id=plan.id,
            plan=plan.name,
            station=plan.station,
            instrument=self._ground.link.dictionary.device_model,
            state=plan.state,
            reason=plan.reason,
            simulated_s=round(simulated_s, 1),
            real_s=round(real_s, 1),
            bytes_lost=self._line.lost,
            items=items,
            passes=[
                replace(rehearsed, used_s=round(rehearsed.used_s, 2))
                for rehearsed in self._passes
                if rehearsed.rise <= now
            ],
            transitions=self._transitions,
            person=self._person_steps,
            steps=[step for run_id in runs for step in _steps(self._ground.procedures.get(run_id))],
        )


def _steps(row: ProcedureRun) -> Sequence[RehearsedStep]:
    return [
        RehearsedStep(
            row.name, e.step, e.kind, e.state, e.detail, datetime.fromisoformat(e.began), _parsed_time(e.ended)
        )
        for e in entries_of(row)
    ]


def _completed_share(plan: PassPlan) -> float:
    items = items_of(plan)
    return sum(item.state == "done" for item in items) / len(items)


def _parsed_time(text: str) -> datetime | None:
    return datetime.fromisoformat(text) if text else None
