"""Results of a conformance check, by clause."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from gss.device.clauses import CLAUSES, Clause, clause
from gss.device.session_events import HelloReceived
from gss.domain.errors import BadInput, Conflict, CorruptData
from gss.instruments.dictionary.definitions import Value

PASS, FAIL, NOT_CHECKED = "pass", "fail", "not checked"


def shown(value: Value) -> str:
    """Return a value as text for one line."""
    return value.hex() if isinstance(value, bytes) else str(value)


@dataclass(frozen=True)
class Case:
    """One test of a clause. ``passed`` None: skipped, ``detail`` gives the reason."""

    subject: str
    passed: bool | None
    detail: str = ""


@dataclass
class Findings:
    """Cases by clause. ``left``: settings of the device that could not be restored. ``damaged``: packets received damaged:
    the check needs a clean line, because a lost packet looks as if the device had not sent it."""

    cases: dict[str, list[Case]] = field(default_factory=dict)
    left: list[str] = field(default_factory=list)
    damaged: int = 0

    def check(self, number: str, subject: str, passed: bool, detail: str = "") -> bool:
        """Record a test; the clause must exist. Returns ``passed``."""
        self.cases.setdefault(clause(number).number, []).append(Case(subject, passed, detail))
        return passed

    def skip(self, number: str, subject: str, why: str) -> None:
        """Record a skipped test."""
        self.cases.setdefault(clause(number).number, []).append(Case(subject, None, why))

    @contextmanager
    def trying(self, number: str, subject: str) -> Iterator[None]:
        """Record a failure if the device answers invalidly or not at all; a lost line ends the check."""
        try:
            yield
        except (Conflict, CorruptData, BadInput) as error:
            self.check(number, subject, False, str(error))

    def result(self, clause: Clause) -> str:
        """Return pass, fail or not checked."""
        tried = [c.passed for c in self.cases.get(clause.number, []) if c.passed is not None]
        if not tried:
            return NOT_CHECKED
        return PASS if all(tried) else FAIL

    @property
    def failed(self) -> list[Clause]:
        """Clauses that failed."""
        return [c for c in CLAUSES if self.result(c) == FAIL]

    def plain(self, hello: HelloReceived, dictionary_hash: str) -> dict[str, Any]:
        """Return plain values for JSON."""
        results = [self.result(c) for c in CLAUSES]
        names = ("device_model", "profile", "firmware", "serial", "simulated", "dictionary_hash")
        return {
            "device": {name: getattr(hello, name) for name in names},
            "dictionary_hash": dictionary_hash,
            "passed": results.count(PASS),
            "failed": results.count(FAIL),
            "not_checked": results.count(NOT_CHECKED),
            "left": self.left,
            "damaged": self.damaged,
            "clauses": [
                {
                    "number": clause.number,
                    "text": clause.text,
                    "result": result,
                    "cases": [vars(c) for c in self.cases.get(clause.number, [])] or self._why_not(clause),
                }
                for clause, result in zip(CLAUSES, results, strict=True)
            ],
        }

    @staticmethod
    def _why_not(clause: Clause) -> list[dict[str, Any]]:
        return [{"subject": "", "passed": None, "detail": clause.unchecked or "the check ended before"}]
