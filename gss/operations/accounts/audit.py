"""Audit log: records every user action with time, address and result. It is append-only: the database rejects changing or
removing a row, and each row contains the hash of the previous one, so that tampering is detected."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from gss.domain.errors import StoreDown
from gss.operations.clock import Now, iso_z
from gss.store import audit as store
from gss.store.audit import AuditFilter
from gss.store.engine import Database
from gss.store.models import AuditRow

Result = Literal["done", "denied", "failed"]
FIRST = "0" * 64
"""The previous hash of the first row."""
ONCE = "milliseconds"
"""Time resolution of hashes in older rows, which are still valid."""
TRIES = 50
FIELDS = ("seq", "at", "who", "role", "action", "target", "result", "detail", "address", "previous", "hash")
FORMATS = {"jsonl": "application/x-ndjson", "csv": "text/csv"}


@dataclass(frozen=True)
class Verdict:
    """Result of verifying the log. ``problem`` is "" if it is intact; ``last_hash`` should be noted elsewhere, because a log
    truncated at its end is consistent in itself."""

    rows: int
    last_hash: str
    problem: str


class AuditService:
    """Writes and reads the log; several processes may write concurrently."""

    def __init__(self, database: Database, now: Now) -> None:
        self._database, self._now = database, now

    def record(
        self, who: str, action: str, target: str, result: Result, detail: str = "", *, role: str = "", address: str = ""
    ) -> int:
        """Append a row and return its number."""
        words = (_fit(who, 80), _fit(role, 20), _fit(action, 60), _fit(target, 200), result, _fit(detail, 2000))
        for _ in range(TRIES):
            try:
                return self._append(*words, _fit(address, 60))
            except store.PlaceTaken:
                continue  # another process appended a row meanwhile: try again after it
        raise StoreDown("the audit record cannot be written now", hint="look at disk space and locks")

    def _append(self, who: str, role: str, action: str, target: str, result: str, detail: str, address: str) -> int:
        with self._database.unit_of_work() as session:
            before = store.last(session)
            row = AuditRow(
                seq=before.seq + 1 if before else 1,
                at=self._now(),
                who=who,
                role=role,
                action=action,
                target=target,
                result=result,
                detail=detail,
                address=address,
                previous=before.hash if before else FIRST,
                hash="",
            )
            row.hash = hash_of(row)
            store.add(session, row)
            return row.seq

    def page(self, wanted: AuditFilter, limit: int, before: int | None = None) -> list[AuditRow]:
        """Return a page of rows, newest first, with numbers below ``before``."""
        with self._database.unit_of_work() as session:
            return store.page(session, wanted, limit, before)

    def export(self, kind: str, wanted: AuditFilter | None = None) -> Iterator[str]:
        """Yield all matching rows, oldest first, as JSON lines or CSV."""
        with self._database.unit_of_work() as session:
            if kind == "csv":
                yield _csv_line(FIELDS)
            for row in store.every(session, wanted or AuditFilter()):
                values = row_values(row)
                if kind == "csv":
                    yield _csv_line([_harmless(str(values[field])) for field in FIELDS])
                else:
                    yield json.dumps(values, ensure_ascii=False) + "\n"

    def verify(self, known_hash: str = "") -> Verdict:
        """Read the whole log and verify every hash. ``known_hash``: of a row noted earlier, which must be present."""
        seq, previous, seen = 0, FIRST, not known_hash
        with self._database.unit_of_work() as session:
            try:
                for row in store.every(session, AuditFilter()):
                    if row.seq != seq + 1:
                        return Verdict(seq, previous, f"rows {seq + 1} to {row.seq - 1} are missing")
                    if row.previous != previous:
                        return Verdict(seq, previous, f"row {row.seq} does not follow row {seq}")
                    if row.hash not in (hash_of(row), hash_of(row, ONCE)):
                        return Verdict(seq, previous, f"row {row.seq} was changed")
                    seq, previous = row.seq, row.hash
                    seen = seen or row.hash == known_hash
            except ValueError as error:  # an invalid time
                return Verdict(seq, previous, f"a row after row {seq} cannot be read: {error}")
            gone, strays = store.missing_guards(session), store.before_the_first(session)
        if strays:
            return Verdict(seq, previous, f"rows before the first one: {strays}")
        if not seen:
            return Verdict(seq, previous, "no row has the hash that was noted: the end was cut off")
        words = f"the database does not refuse changes of the record any more: {', '.join(gone)}"
        return Verdict(seq, previous, words if gone else "")


def hash_of(row: AuditRow, timespec: str = "microseconds") -> str:
    """Return the SHA-256 over all columns of a row, including the previous row's hash."""
    values = [str(value) for field, value in row_values(row, timespec).items() if field != "hash"]
    return hashlib.sha256(json.dumps(values, ensure_ascii=True).encode()).hexdigest()


def row_values(row: AuditRow, timespec: str = "microseconds") -> dict[str, str | int]:
    """Return a row as plain values."""
    return {field: iso_z(row.at, timespec) if field == "at" else getattr(row, field) for field in FIELDS}


def _fit(text: str, most: int) -> str:
    """Truncate text from outside and replace control characters, which could forge a line when printed."""
    return "".join(c if c.isprintable() else "�" for c in text.encode("utf-8", "replace").decode())[:most]


def _harmless(text: str) -> str:
    """Prefix text that a spreadsheet would run as a formula."""
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text


def _csv_line(values: tuple[str, ...] | list[str]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(values)
    return line.getvalue()
