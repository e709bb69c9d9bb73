"""Copy a pass plan and all data that it refers to into the store of a rehearsal."""

from __future__ import annotations

from datetime import datetime
from typing import TypeVar

from sqlalchemy import inspect, select
from sqlalchemy.orm import Session

from gss.store import catalogues, passes, procedures
from gss.store.models import DerivedParameter, PassPlan, User
from gss.store.models.base import Base

Row = TypeVar("Row", bound=Base)


def copy_plan(source: Session, target: Session, plan_id: int) -> list[str]:
    """Copy a plan as a draft, with its station, orbit, procedures, catalogues and the derived parameters.
    Return the keys of the blobs that it needs. Raises NotFound if the plan or an item of it no longer exists."""
    plan = passes.get_plan(source, plan_id)
    rows: list[Base] = [passes.get_station(source, plan.station_id), *passes.newest_orbits(source, 1)]
    rows += source.scalars(select(DerivedParameter))
    blobs = set[str]()
    for item in plan.items:
        if item["procedure_id"] is not None:
            rows.append(procedures.get(source, item["procedure_id"]))
        elif item["catalogue_id"] is not None:
            catalogue = catalogues.get(source, item["catalogue_id"])
            rows.append(catalogue)
            blobs.add(catalogue.sha256)
    for row in dict.fromkeys(rows):
        target.add(_copied(row))
    target.add(_draft(plan))
    target.flush()
    return sorted(blobs)


def add_users(target: Session, names: list[str], now: datetime) -> None:
    """Add the users of a rehearsal. They have all permissions and cannot sign in."""
    for name in names:
        target.add(User(name=name, role="admin", enabled=True, password_hash="", created=now, created_by="rehearsal"))


def _copied(row: Row) -> Row:
    columns = inspect(type(row)).column_attrs
    return type(row)(**{column.key: getattr(row, column.key) for column in columns})


def _draft(plan: PassPlan) -> PassPlan:
    """Return a copy of a plan as a draft without progress."""
    row = _copied(plan)
    initial = {
        "state": "waiting",
        "started_id": None,
        "detail": "",
        "started": "",
        "finished": "",
    }
    row.items, row.state, row.reason, row.confirm = [dict(item) | initial for item in plan.items], "draft", "", []
    row.armed_by, row.armed, row.started, row.finished = "", None, None, None
    return row
