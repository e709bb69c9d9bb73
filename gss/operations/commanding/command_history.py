"""The command history: filtered queries, and exports with the same filter."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Mapping
from typing import Any

from gss.domain.errors import BadInput
from gss.operations.clock import iso_z
from gss.store import commands as store
from gss.store.commands import Filter
from gss.store.engine import Database
from gss.store.models import Command

__all__ = ["CommandHistory", "Filter"]

FORMULA = ("=", "+", "-", "@", "\t")
COLUMNS = (
    *("id", "request_id", "created", "finished", "duration_s", "user", "source", "contact_id", "run_id", "name"),
    *("arguments", "result", "detail", "late", "attempts", "resolved_note", "values", "stages"),
)


class CommandHistory:
    """Reads recorded commands and their results."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def page(self, filters: Filter, limit: int, before: int | None = None) -> list[Command]:
        """Return a page of commands, newest first. ``before``: return only commands with a smaller id."""
        _check(filters)
        with self._database.unit_of_work() as session:
            return store.page(session, filters, limit, before)

    def facets(self) -> dict[str, list[str]]:
        """Return the distinct names, users, results and sources, for filter lists."""
        with self._database.unit_of_work() as session:
            return store.facets(session)

    def csv(self, filters: Filter) -> Iterator[str]:
        """Yield all matching commands as CSV lines, oldest first. The cells for arguments, values and stages contain JSON."""
        _check(filters)
        yield _line(COLUMNS)
        for facts in self.records(filters):
            yield _line([_cell(facts[name]) for name in COLUMNS])

    def json(self, filters: Filter) -> Iterator[str]:
        """Yield all matching commands as parts of a JSON array, oldest first."""
        opening = "[\n"
        for facts in self.records(filters):
            yield opening + json.dumps(facts, ensure_ascii=False)
            opening = ",\n"
        yield "[]\n" if opening == "[\n" else "\n]\n"

    def records(self, filters: Filter) -> Iterator[Mapping[str, object]]:
        """Yield all matching commands as plain values, oldest first."""
        _check(filters)
        for row in store.iterate_all(self._database, filters):
            yield _facts(row)


def _check(filters: Filter) -> None:
    if filters.start is not None and filters.end is not None and filters.end <= filters.start:
        raise BadInput(
            "the time span is empty", expected="a start before the end", got=f"{filters.start} … {filters.end}"
        )


def _facts(row: Command) -> Mapping[str, object]:
    facts = {name: getattr(row, name) for name in COLUMNS if name not in ("duration_s", "stages")}
    facts["created"], facts["finished"] = iso_z(row.created), iso_z(row.finished) if row.finished else None
    facts["duration_s"] = round((row.finished - row.created).total_seconds(), 3) if row.finished else None
    facts["stages"] = [{"stage": s.stage, "at": iso_z(s.at), "detail": s.detail} for s in row.stages]
    return {name: facts[name] for name in COLUMNS}


def _cell(value: Any) -> Any:
    if isinstance(value, dict | list):
        return json.dumps(value, ensure_ascii=False)
    # The leading quote prevents a spreadsheet from evaluating the text as a formula.
    return f"'{value}" if isinstance(value, str) and value[:1] in FORMULA else value


def _line(cells: Any) -> str:
    buffer = io.StringIO()
    csv.writer(buffer).writerow(cells)
    return buffer.getvalue()
