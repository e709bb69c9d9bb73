"""Pass plans. A plan is created for a pass, checked, and armed by a user with command authority. Any user can stop it.
``plan_runner`` executes plans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from datetime import datetime
from typing import Any

from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import Now
from gss.operations.commanding.commanding import CommandService
from gss.operations.events import EventBus
from gss.operations.passes.pass_table import PassService
from gss.operations.passes.plan_items import MAX_ITEMS, ItemControl, PlanItem
from gss.operations.passes.spacecraft import SpacecraftService
from gss.store import passes as store
from gss.store.engine import Database
from gss.store.models import PassPlan

ACTIVE = store.ACTIVE


class PlanService:
    """Stores plans. Each change of state is stored before a command is sent."""

    def __init__(
        self,
        table: PassService,
        spacecraft: SpacecraftService,
        control: ItemControl,
        commands: CommandService,
        database: Database,
        bus: EventBus,
        now: Now,
    ) -> None:
        self._table, self._spacecraft, self._control, self._commands = table, spacecraft, control, commands
        self._database, self._bus, self._now = database, bus, now

    def newest(self, limit: int) -> list[PassPlan]:
        """Return the latest plans, newest first."""
        with self._database.unit_of_work() as session:
            return store.newest_plans(session, limit)

    def active(self) -> list[PassPlan]:
        """Return the plans that are armed or in progress, in order of rise."""
        with self._database.unit_of_work() as session:
            return store.active_plans(session)

    def get(self, plan_id: int) -> PassPlan:
        """Return the plan with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get_plan(session, plan_id)

    def create(
        self, name: str, station_id: int, at: datetime, items: Sequence[PlanItem], *, resume: bool, user: str
    ) -> PassPlan:
        """Store a plan for the pass over a station at time ``at``. Raises BadInput, NotFound or Conflict."""
        if not 1 <= len(items) <= MAX_ITEMS:
            raise BadInput("invalid number of items", expected=f"1 – {MAX_ITEMS}", got=str(len(items)))
        planned_pass, checked = self._table.at(station_id, at), [self._control.checked(item) for item in items]
        row = PassPlan(
            name=" ".join(name.split())[:80] or f"Pass over {planned_pass.station.name}",
            station_id=station_id,
            station=planned_pass.station.name,
            spacecraft=self._spacecraft.require().row.spacecraft,
            rise=planned_pass.at.rise,
            set=planned_pass.at.set,
            resume=resume,
            items=[asdict(item) for item in checked],
            confirm=[],
            state="draft",
            reason="",
            author=user,
            created=self._now(),
            armed_by="",
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
        return row

    def delete(self, plan_id: int) -> None:
        """Delete a plan that was never armed. Raises Conflict for other plans, because they are part of the record."""
        row = self.get(plan_id)
        if row.state != "draft":
            raise Conflict("only a draft can be deleted", expected="draft", got=row.state)
        with self._database.unit_of_work() as session:
            store.delete_plan(session, row)

    def problems(self, row: PassPlan) -> list[str]:
        """Return all reasons why a plan cannot be armed now."""
        needed_s, length_s = sum(item.estimated_s for item in items_of(row)), (row.set - row.rise).total_seconds()
        problem_texts = []
        if needed_s > length_s and not row.resume:
            problem_texts.append(
                f"The items need {needed_s:.0f} s, the pass has {length_s:.0f} s. Remove items, or continue in the next pass."
            )
        if row.set <= self._now():
            problem_texts.append("The pass is over. Create a plan for a coming pass.")
        problem_texts += [
            f"{problem}. Review the present procedure, create a new plan, and delete this draft."
            for problem in map(self._control.problem, items_of(row))
            if problem
        ]
        current = self._spacecraft.current()
        if current is None or not current.plannable:
            problem_texts.append(current.advice if current else "No orbit was imported.")
        problem_texts += [
            f"It overlaps the {other.state} plan {other.name} over {other.station}. Stop that plan first."
            for other in self.active()
            if other.id != row.id and other.rise < row.set and row.rise < other.set
        ]
        return problem_texts

    def to_confirm(self, row: PassPlan, *, user: str) -> list[str]:
        """Return the names that the user must type before the plan is armed. Raises NotPermitted if the user does not have the
        permission for an item."""
        return self._control.confirm(items_of(row), user=user)

    def arm(self, plan_id: int, confirm: Sequence[str], *, user: str) -> PassPlan:
        """Arm a draft. It starts at the first good packet of its pass. If no user has command authority, the user takes it.
        Raises Conflict with the first problem or if another user has command authority, BadInput with the names that must still
        be typed, NotPermitted."""
        row = self.get(plan_id)
        if row.state != "draft":
            raise Conflict("only a draft can be armed", expected="draft", got=row.state, hint="Create a new plan.")
        missing = [name for name in self.to_confirm(row, user=user) if name not in confirm]
        problems = self.problems(row)
        if problems:
            raise Conflict("the plan cannot be armed", got=problems[0])
        if missing:
            raise BadInput("the plan has commands that need confirmation", expected=f"typed: {', '.join(missing)}")
        self._commands.require_user(user)
        row = self.change(plan_id, state="armed", armed_by=user, armed=self._now(), confirm=list(confirm))
        self._bus.record("pass", "watch", f"{user} armed the plan {row.name} for {row.rise:%Y-%m-%d %H:%M:%S} UTC")
        return row

    def change(self, plan_id: int, items: Sequence[PlanItem] | None = None, **values: Any) -> PassPlan:
        """Change columns of a plan, and also its items unless ``items`` is None. Return the row."""
        with self._database.unit_of_work() as session:
            row = store.get_plan(session, plan_id)
            for name, value in values.items():
                setattr(row, name, value)
            if items is not None:
                row.items = [asdict(item) for item in items]
        return row


def items_of(row: PassPlan) -> list[PlanItem]:
    """Return the items of a stored plan."""
    return [PlanItem(**item) for item in row.items]
