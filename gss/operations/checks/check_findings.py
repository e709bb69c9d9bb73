"""Results of a conformance check, by clause."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypedDict

from gss.device.clauses import CLAUSES, Clause, clause
from gss.device.session_events import HelloReceived
from gss.domain.errors import BadInput, Conflict, CorruptData
from gss.instruments.dictionary.definitions import Value

PASS, FAIL, NOT_CHECKED = "pass", "fail", "not checked"


def shown(value: Value) -> str:
    """Return a value as text; bytes as hexadecimal digits."""
    return value.hex() if isinstance(value, bytes) else str(value)


@dataclass(frozen=True)
class Case:
    """One test of a clause. ``passed`` is None if the test was skipped; ``detail`` then states the reason."""

    subject: str
    passed: bool | None
    detail: str = ""


class CaseRecord(TypedDict):
    """A case as JSON values."""

    subject: str
    passed: bool | None
    detail: str


class ClauseRecord(TypedDict):
    """A clause with its result and cases."""

    number: str
    text: str
    result: str
    cases: list[CaseRecord]


class DeviceRecord(TypedDict):
    """Identity of the checked device."""

    device_model: str
    profile: str
    firmware: str
    serial: str
    simulated: bool | None
    dictionary_hash: str


class FindingsRecord(TypedDict):
    """All findings as JSON values. ``dictionary_hash``: hash of the host's dictionary. ``passed``, ``failed`` and
    ``not_checked``: numbers of clauses. ``left``: settings of the device that could not be restored."""

    device: DeviceRecord
    dictionary_hash: str
    passed: int
    failed: int
    not_checked: int
    left: list[str]
    damaged: int
    clauses: list[ClauseRecord]


@dataclass
class Findings:
    """Cases by clause. ``not_restored``: settings of the device that could not be restored. ``damaged``: number of damaged
    packets received. The check needs an error-free line, because it cannot distinguish a lost packet from a packet that the
    device did not send."""

    cases: dict[str, list[Case]] = field(default_factory=dict)
    not_restored: list[str] = field(default_factory=list)
    damaged: int = 0

    def check(self, number: str, subject: str, passed: bool, detail: str = "") -> bool:
        """Record the result of a test and return ``passed``. The clause must exist."""
        self.cases.setdefault(clause(number).number, []).append(Case(subject, passed, detail))
        return passed

    def skip(self, number: str, subject: str, reason: str) -> None:
        """Record a skipped test."""
        self.cases.setdefault(clause(number).number, []).append(Case(subject, None, reason))

    @contextmanager
    def trying(self, number: str, subject: str) -> Iterator[None]:
        """Record a failure if the device sends an invalid answer or no answer. LinkDown is not caught and ends the check."""
        try:
            yield
        except (Conflict, CorruptData, BadInput) as error:
            self.check(number, subject, False, str(error))

    def result(self, clause: Clause) -> str:
        """Return the result of a clause: pass, fail or not checked."""
        tried = [c.passed for c in self.cases.get(clause.number, []) if c.passed is not None]
        if not tried:
            return NOT_CHECKED
        return PASS if all(tried) else FAIL

    @property
    def failed(self) -> list[Clause]:
        """Clauses that failed."""
        return [c for c in CLAUSES if self.result(c) == FAIL]

    def plain(self, hello: HelloReceived, dictionary_hash: str) -> FindingsRecord:
        """Return the findings as JSON values."""
        results = [self.result(c) for c in CLAUSES]
        return {
            "device": {
                "device_model": hello.device_model,
                "profile": hello.profile,
                "firmware": hello.firmware,
                "serial": hello.serial,
                "simulated": hello.simulated,
                "dictionary_hash": hello.dictionary_hash,
            },
            "dictionary_hash": dictionary_hash,
            "passed": results.count(PASS),
            "failed": results.count(FAIL),
            "not_checked": results.count(NOT_CHECKED),
            "left": self.not_restored,
            "damaged": self.damaged,
            "clauses": [
                {
                    "number": clause.number,
                    "text": clause.text,
                    "result": result,
                    "cases": self._cases(clause),
                }
                for clause, result in zip(CLAUSES, results, strict=True)
            ],
        }

    def _cases(self, clause: Clause) -> list[CaseRecord]:
        """Return the cases of a clause. If there are none, return one case that states the reason."""
        cases = self.cases.get(clause.number) or [
            Case("", None, clause.unchecked or "the check ended before this clause")
        ]
        return [{"subject": c.subject, "passed": c.passed, "detail": c.detail} for c in cases]
