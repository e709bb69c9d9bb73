"""Audit log: records each user action with time, address and result. It is append-only. The database rejects changes and
deletions of rows. Each row contains the hash of the previous row. Each hash is also appended to a file outside the database
(``audit_anchor``), so tampering is detected."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from gss.domain.errors import StoreDown
from gss.operations.accounts.audit_anchor import Anchor, AnchorFile
from gss.operations.clock import Now, iso_z
from gss.store import audit as store
from gss.store import choices
from gss.store.audit import AuditFilter
from gss.store.engine import Database
from gss.store.models import AuditRow

Result = Literal["done", "denied", "failed", "unknown"]
"""Result of an action. ``unknown``: the server ended before it recorded the result."""
FIRST = "0" * 64
"""Value in the first row in place of the previous row's hash."""
ONCE = "milliseconds"
"""Time resolution with which older versions computed the hashes of rows. These hashes are still valid."""
TRIES = 50
HINT = "compare the log with a backup; if the database was replaced on purpose, run gss audit accept"
FIELDS = ("seq", "at", "who", "role", "action", "target", "result", "detail", "address", "previous", "hash")
FORMATS = {"jsonl": "application/x-ndjson", "csv": "text/csv"}
log = logging.getLogger("gss.audit")


@dataclass(frozen=True)
class AuditVerdict:
    """Result of verifying the log. ``problem``: "" if the log is intact. ``anchors``: the rows that the anchor file confirms.
    ``last_hash``: hash of the last row. Users should note it elsewhere, because the anchor file can be changed together with the
    database."""

    rows: int
    last_hash: str
    problem: str
    anchors: str = ""


class AuditService:
    """Writes and reads the log. Several processes can write concurrently."""

    def __init__(self, database: Database, now: Now, anchors: AnchorFile) -> None:
        self._database, self._now, self._anchors = database, now, anchors

    def begin_anchors(self) -> None:
        """Create the anchor file of a log that never had one. If the file is missing later, ``verify`` reports a problem."""
        with self._database.unit_of_work() as session:
            if choices.has(session, choices.AUDIT_ANCHOR):
                return
            self._anchors.create()
            choices.write(session, choices.AUDIT_ANCHOR, {"file": str(self._anchors.path)}, self._now(), "gss")
        with self._database.unit_of_work() as session:
            last = store.last(session)
        if last is not None:  # a version without anchors wrote the rows up to this row
            self._anchor(Anchor(last.seq, last.hash, iso_z(self._now())))

    def accept(self, user: str, reason: str) -> None:
        """Accept the current log after the database was replaced on purpose: from now on, only later anchors are compared with
        it. Raises StoreDown if the anchor file cannot be created."""
        self._anchors.create()
        self.begin_anchors()
        seq = self.record(user, "audit.accept", "anchor file", "done", reason, role="shell")
        with self._database.unit_of_work() as session:
            stored = store.hashes(session, [seq])[seq]
        self._anchors.append(Anchor(seq, stored, iso_z(self._now()), f"{_fit(user, 80)}: {_fit(reason, 200)}"))

    def record(
        self, who: str, action: str, target: str, result: Result, detail: str = "", *, role: str = "", address: str = ""
    ) -> int:
        """Append a row and return its number."""
        fields = (_fit(who, 80), _fit(role, 20), _fit(action, 60), _fit(target, 200), result, _fit(detail, 2000))
        for _ in range(TRIES):
            try:
                added = self._append(*fields, _fit(address, 60))
            except store.PositionTaken:
                continue  # another process appended a row with this number, so retry with the next number
            self._anchor(added)
            return added.seq
        raise StoreDown("the audit log cannot be written", hint="check disk space and file locks")

    def _append(self, who: str, role: str, action: str, target: str, result: str, detail: str, address: str) -> Anchor:
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
            return Anchor(row.seq, row.hash, iso_z(row.at))

    def _anchor(self, anchor: Anchor) -> None:
        try:
            self._anchors.append(anchor)
        except OSError as error:  # a full disk must not prevent a change; ``compare`` reports a missing file
            log.warning("row %d, hash %s, was not appended to the anchor file: %s", anchor.seq, anchor.hash, error)

    def page(self, filters: AuditFilter, limit: int, before: int | None = None) -> list[AuditRow]:
        """Return a page of rows, newest first, with numbers below ``before``."""
        with self._database.unit_of_work() as session:
            return store.page(session, filters, limit, before)

    def export(self, kind: str, filters: AuditFilter | None = None) -> Iterator[str]:
        """Yield all matching rows, oldest first, as JSON lines or CSV."""
        if kind == "csv":
            yield _csv_line(FIELDS)
        for row in store.iterate_all(self._database, filters or AuditFilter()):
            values = row_values(row)
            if kind == "csv":
                yield _csv_line([_harmless(str(values[field])) for field in FIELDS])
            else:
                yield json.dumps(values, ensure_ascii=False) + "\n"

    def verify(self, known_hash: str = "") -> AuditVerdict:
        """Read the complete log, verify all hashes, and compare the log with the anchor file. ``known_hash``: hash that was noted
        earlier; a row with this hash must exist."""
        chain = self._verify_chain(known_hash)
        problem, anchors = self._verify_anchors()
        return replace(chain, problem=chain.problem or problem or self._verify_guards(), anchors=anchors)

    def compare(self) -> str:
        """Compare the log with its latest anchor. Return the problem, "" if there is none."""
        try:
            newest = self._anchors.newest()
        except OSError as error:
            return self._missing(error)
        return self._difference([newest]) if newest else ""

    def _verify_anchors(self) -> tuple[str, str]:
        """Return the first difference between the log and the anchor file ("" if there is none), and a text that states
        which rows the file confirms."""
        lowest, highest, problem = 0, 0, ""
        try:
            for batch in self._anchors.batches():
                problem = problem or self._difference(batch)
                numbers = [anchor.seq for anchor in batch]
                lowest, highest = min(lowest or numbers[0], *numbers), max(highest, *numbers)
            accepted = self._anchors.accepted()
        except OSError as error:
            return self._missing(error), ""
        since = f"; accepted {accepted.at} by {accepted.accepted}" if accepted else ""
        agrees = f"{self._anchors.path.name} confirms rows {lowest} to {highest}" if highest and not problem else ""
        return problem, agrees + since

    def _difference(self, anchors: list[Anchor]) -> str:
        with self._database.unit_of_work() as session:
            stored = store.hashes(session, {anchor.seq for anchor in anchors})
        for anchor in anchors:
            if anchor.seq not in stored:
                return f"row {anchor.seq}, anchored {anchor.at}, is missing: the log was truncated or replaced; {HINT}"
            if stored[anchor.seq] != anchor.hash:
                return f"row {anchor.seq} differs from its anchor of {anchor.at}: the log was rewritten or replaced; {HINT}"
        return ""

    def _missing(self, error: OSError) -> str:
        with self._database.unit_of_work() as session:
            began = choices.has(session, choices.AUDIT_ANCHOR)
        return f"the anchor file cannot be read: {error}; {HINT}" if began else ""

    def _verify_chain(self, known_hash: str) -> AuditVerdict:
        seq, previous, hash_seen = 0, FIRST, not known_hash
        try:
            for row in store.iterate_all(self._database, AuditFilter()):
                if row.seq != seq + 1:
                    return AuditVerdict(seq, previous, f"rows {seq + 1} to {row.seq - 1} are missing")
                if row.previous != previous:
                    return AuditVerdict(seq, previous, f"row {row.seq} does not follow row {seq}")
                if row.hash not in (hash_of(row), hash_of(row, ONCE)):
                    return AuditVerdict(seq, previous, f"row {row.seq} was changed")
                seq, previous = row.seq, row.hash
                hash_seen = hash_seen or row.hash == known_hash
        except ValueError as error:  # an invalid time
            return AuditVerdict(seq, previous, f"a row after row {seq} is unreadable: {error}")
        with self._database.unit_of_work() as session:
            strays = store.count_before_start(session)
        if strays:
            return AuditVerdict(seq, previous, f"{strays} rows precede the first row")
        if not hash_seen:
            return AuditVerdict(seq, previous, "no row has the noted hash: the end was truncated")
        return AuditVerdict(seq, previous, "")

    def _verify_guards(self) -> str:
        with self._database.unit_of_work() as session:
            missing = store.missing_guards(session)
        return f"the database no longer rejects changes of the audit log: {', '.join(missing)}" if missing else ""


def hash_of(row: AuditRow, timespec: str = "microseconds") -> str:
    """Return the SHA-256 of all columns of a row, including the hash of the previous row."""
    values = [str(value) for field, value in row_values(row, timespec).items() if field != "hash"]
    return hashlib.sha256(json.dumps(values, ensure_ascii=True).encode()).hexdigest()


def row_values(row: AuditRow, timespec: str = "microseconds") -> dict[str, str | int]:
    """Return a row as plain values."""
    return {field: iso_z(row.at, timespec) if field == "at" else getattr(row, field) for field in FIELDS}


def _fit(text: str, max_length: int) -> str:
    """Truncate untrusted text and replace control characters, which could forge a line in printed output."""
    return "".join(c if c.isprintable() else "�" for c in text.encode("utf-8", "replace").decode())[:max_length]


def _harmless(text: str) -> str:
    """Prefix text that a spreadsheet would evaluate as a formula."""
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text


def _csv_line(values: tuple[str, ...] | list[str]) -> str:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(values)
    return line.getvalue()
