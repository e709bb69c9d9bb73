"""Checks that all stored data are present and intact: the database, the blobs that it references, captures, and the
audit chain."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

from gss.domain.callbacks import no_progress
from gss.domain.errors import CorruptData, GssError, NotFound, StoreDown
from gss.operations.accounts.audit import AuditService
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService, Progress
from gss.operations.line.capture_files import capture_files, capture_sizes, packed_path, plain_name
from gss.operations.line.raw_capture import read_captures
from gss.store import devices
from gss.store import upkeep as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.migration import known_schemas
from gss.store.models import Job

SHOWN = 10
ERROR, NOTE = "error", "note"


@dataclass(frozen=True)
class Finding:
    """Result of one check. ``state``: ok, note (no data are lost) or error; ``examples``: the first problems."""

    name: str
    state: str
    text: str
    examples: tuple[str, ...] = ()


@dataclass
class StoreReport:
    """Results of all checks."""

    findings: list[Finding] = field(default_factory=list)
    rows: dict[str, int] = field(default_factory=dict)

    @property
    def whole(self) -> bool:
        """True if there is no error."""
        return all(f.state != ERROR for f in self.findings)

    def add(self, name: str, problems: list[str], text: str, problem: str, level: str = ERROR) -> None:
        """Add a finding. Its text is ``text`` without problems, otherwise the number of ``problems`` and the text
        ``problem``."""
        if problems:
            self.findings.append(Finding(name, level, f"{len(problems)} {problem}", tuple(problems[:SHOWN])))
        else:
            self.findings.append(Finding(name, "ok", text))

    def plain(self) -> dict[str, object]:
        """Return JSON values."""
        return {"whole": self.whole, "rows": self.rows, "findings": [asdict(f) for f in self.findings]}


def check_store(
    database: Database, blobs: BlobStore, captures: Path, audit: AuditService, progress: Progress = no_progress
) -> StoreReport:
    """Run all checks. Every problem becomes a finding; only cancelling raises an exception."""
    report = StoreReport()
    _run_check(report, "database", lambda: _database(report, database, progress))
    _run_check(report, "bytes", lambda: _blobs(report, database, blobs, progress))
    _run_check(report, "captures", lambda: _captures(report, database, captures, progress))
    _run_check(report, "audit", lambda: _audit(report, audit))
    return report


def _run_check(report: StoreReport, name: str, check: Callable[[], None]) -> None:
    try:
        check()
    except (CorruptData, StoreDown, OSError, ValueError) as error:
        report.findings.append(Finding(name, ERROR, str(error)))


def _database(report: StoreReport, database: Database, progress: Progress) -> None:
    progress(0, 0, "Reading the database")
    with database.unit_of_work() as session:
        problems = store.integrity_problems(session)
        report.add("database", problems, "every page is intact", "damaged parts of the file")
        if problems:
            return
        schema, newest = store.schema_version(session), known_schemas()[-1]
        older = [] if schema == newest else [f"the database has schema {schema or 'none'}, this version has {newest}"]
        report.add("schema", older, f"schema {schema}", "the server migrates it at start", NOTE)
        report.add("references", store.broken_links(session), "all references are valid", "rows refer to missing rows")
        report.rows = store.row_counts(session)


def _blobs(report: StoreReport, database: Database, blobs: BlobStore, progress: Progress) -> None:
    with database.unit_of_work() as session:
        expected: dict[str, store.Reference] = {}
        for reference in store.references(session):
            expected.setdefault(reference.sha256, reference)
    missing, damaged, unequal = {}, {}, {}
    for k, (key, reference) in enumerate(expected.items()):
        progress(k, len(expected), f"Reading bytes, {k} of {len(expected)}")
        try:
            size = len(blobs.get(key))
        except NotFound:
            missing[key] = f"{reference.by}: {key[:16]}…"
            continue
        except (CorruptData, OSError):
            damaged[key] = f"{reference.by}: {key[:16]}…"
            continue
        if reference.size is not None and size != reference.size:
            unequal[key] = f"{reference.by}: {size} B instead of {reference.size}"
    orphans = [key for key in blobs.keys() if key not in expected]  # noqa: SIM118 - not a dictionary
    with database.unit_of_work() as session:  # rows can change during the check, for example by retention
        current = {reference.sha256 for reference in store.references(session)}
    for problems in (missing, damaged, unequal):
        for key in problems.keys() - current:
            del problems[key]
    orphans = [key for key in orphans if key not in current]
    report.add(
        "missing files", [*missing.values()], f"all {len(expected)} exist", "are missing: restore them from a backup"
    )
    report.add("damaged files", [*damaged.values()], "all hashes match", "are damaged: restore them from a backup")
    report.add("wrong file sizes", [*unequal.values()], "all sizes match", "do not have the recorded size")
    size = 0
    for key in orphans[:1000]:
        with contextlib.suppress(NotFound):  # removed during the check
            size += blobs.size(key)
    problem = f"are no longer referenced, {size} B in the first {min(len(orphans), 1000)}"
    report.add("unused files", orphans, "none", problem, NOTE)


def _captures(report: StoreReport, database: Database, folder: Path, progress: Progress) -> None:
    with database.unit_of_work() as session:
        contacts = [row for row, *_ in devices.list_contacts(session, 1_000_000)]
    files = {plain_name(path): path for path in capture_files(folder)}
    recorded = {str(c["file"]): c for contact in contacts for c in contact.captures or ()}
    missing = sorted(set(recorded) - set(files))
    torn: list[str] = []

    def unread(file: Path, count: int) -> None:
        torn.append(f"{file.name}: the last {count} B are an incomplete record")

    for k, path in enumerate(files.values()):
        progress(k, len(files), f"Reading captures, {k} of {len(files)}")
        try:
            for _ in read_captures([path], unread):
                pass
        except FileNotFoundError:
            if path.exists() or packed_path(path).exists():
                raise
    sizes = {file.path.name: file.bytes for file in capture_sizes(folder)}  # compressed files have other names
    short = [
        f"{name}: {sizes[name]} B, the contact had written {entry['bytes']}"
        for name, entry in recorded.items()
        if name in sizes and sizes[name] < int(str(entry["bytes"]))
    ]
    report.add(
        "removed captures", missing, "every file exists", "files are missing: retention removes the oldest", NOTE
    )
    report.add(
        "truncated captures", torn, f"{len(files)} files, all complete", "files end in an incomplete record", NOTE
    )
    report.add("short captures", short, "none is shorter than recorded", "files are shorter than recorded")


def _audit(report: StoreReport, audit: AuditService) -> None:
    verdict = audit.verify()
    if verdict.problem:
        report.findings.append(Finding("audit", ERROR, f"the audit log is not intact: {verdict.problem}"))
        return
    anchors = f"; {verdict.anchors}" if verdict.anchors else ""
    report.findings.append(
        Finding("audit", "ok", f"{verdict.rows} rows, intact and protected against changes{anchors}")
    )


class CheckStoreService:
    """Runs the store check as a job."""

    def __init__(
        self, database: Database, blobs: BlobStore, captures: Path, jobs: JobService, audit: AuditService
    ) -> None:
        self._database, self._blobs, self._captures, self._jobs = database, blobs, captures, jobs
        self._audit = audit
        jobs.register(JobKind("check-store", JobRequest, self._work))

    def start(self, *, user: str) -> Job:
        """Queue a check as a job. The result of the job is the report."""
        return self._jobs.begin("check-store", "check the store", JobRequest(user=user))

    def _work(self, _request: JobRequest, run: JobRun) -> JobResult:
        try:
            return check_store(self._database, self._blobs, self._captures, self._audit, run.progress).plain()
        except OSError as error:
            raise GssError("the store cannot be read completely", got=str(error)) from error
