"""Values and changes that the database refuses are errors of the request, on SQLite and on PostgreSQL."""

from __future__ import annotations

from datetime import timedelta

import pytest
from sqlalchemy import insert, text

from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import utc_now
from gss.operations.views.shared_views import SharedViews, ViewRequest
from gss.store.engine import Database
from gss.store.models import SharedView

VIEW = {"name": "n", "path": "/live", "note": "", "owner": "ann", "open": False, "version": 1, "user": "ann"}


def test_a_number_that_no_column_can_hold_is_bad_input(database: Database) -> None:
    """A number outside 64 bits is rejected with the reason; the database remains usable."""
    with pytest.raises(BadInput, match="the database cannot store a value"), database.unit_of_work() as session:
        session.execute(insert(SharedView).values(**VIEW | {"version": 10**30}, changed=utc_now()))
    with database.unit_of_work() as session:
        assert session.execute(text("SELECT 1")).scalar_one() == 1


@pytest.mark.postgres
@pytest.mark.parametrize("database_url", ["postgres"], indirect=True)
@pytest.mark.parametrize("values", [{"note": "a\0b"}, {"name": "x" * 81}], ids=["NUL", "long text"])
def test_a_text_that_postgresql_cannot_hold_is_bad_input(database: Database, values: dict[str, str]) -> None:
    """NUL in a text, and a text that is longer than its column, are rejected with the reason."""
    with pytest.raises(BadInput, match="the database cannot store a value"), database.unit_of_work() as session:
        session.execute(insert(SharedView).values(**VIEW | values, changed=utc_now()))


def test_a_name_that_another_request_stored_meanwhile_is_a_conflict(database: Database) -> None:
    """A view whose name another request stores between the check and the insertion is refused as a conflict."""
    request = ViewRequest(name="power", path="/telemetry")
    first = SharedViews(database, utc_now)

    def now_after_the_check():
        first.create(request, user="ann")
        return utc_now() + timedelta(seconds=1)

    with pytest.raises(Conflict, match="another request changed the same data"):
        SharedViews(database, now_after_the_check).create(request, user="bob")
    assert [row.owner for row in first.list_all()] == ["ann"]


def test_a_violated_rule_that_no_other_request_can_cause_is_a_defect(database: Database) -> None:
    """A missing value is not reported as a conflict, because repeating the request would not help."""
    with pytest.raises(Exception, match=r"(?i)not.null") as caught, database.unit_of_work() as session:
        session.execute(insert(SharedView).values(**VIEW | {"owner": None}, changed=utc_now()))
    assert not isinstance(caught.value, Conflict | BadInput)
