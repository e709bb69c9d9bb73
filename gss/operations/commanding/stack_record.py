"""Records of stack runs. Each change is stored and published."""

from __future__ import annotations

from typing import Any

from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.store import stacks as store
from gss.store.engine import Database
from gss.store.models import Stack, StackRun

RESTARTED = "stopped: server restarted"


class RunRecord:
    """Stores the state of each run and of its steps."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now

    def end_interrupted(self) -> None:
        """Set the state ``stopped`` for all runs that a server restart interrupted."""
        with self._database.unit_of_work() as session:
            for row in store.unfinished_runs(session):
                row.state, row.reason, row.finished = "stopped", RESTARTED, self._now()

    def add(self, stack: Stack, user: str) -> StackRun:
        """Store a new run with all steps waiting, and return its row."""
        steps = [dict(step) | {"state": "waiting", "command_id": None, "detail": ""} for step in stack.steps]
        row = StackRun(
            stack_id=stack.id,
            name=stack.name,
            steps=steps,
            state="running",
            step=0,
            reason="",
            user=user,
            started=self._now(),
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
        self._bus.publish("stack_run", row)
        return row

    def get(self, run_id: int) -> StackRun:
        """Return the run with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get_run(session, run_id)

    def newest(self, limit: int) -> list[StackRun]:
        """Return the latest runs, newest first."""
        with self._database.unit_of_work() as session:
            return store.newest_runs(session, limit)

    def mark(self, run_id: int, number: int, state: str, *, command_id: int | None = None, detail: str = "") -> None:
        """Set the state of a step and make it the run's current step."""
        with self._database.unit_of_work() as session:
            row = store.get_run(session, run_id)
            steps = [dict(step) for step in row.steps]
            steps[number] |= {"state": state, "command_id": command_id, "detail": detail}
            row.steps, row.step = steps, number
        self._bus.publish("stack_run", row)

    def change(self, run_id: int, **values: Any) -> StackRun:
        """Change columns of the run's row and return it."""
        with self._database.unit_of_work() as session:
            row = store.get_run(session, run_id)
            for name, value in values.items():
                setattr(row, name, value)
        self._bus.publish("stack_run", row)
        return row
